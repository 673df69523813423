"""What pages fetch and send as files."""

from __future__ import annotations

import csv
import errno
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.studio.gate import GatedClient
from tests.studio.running import fill_history, until
from tests.studio.test_columns import parsed
from tests.studio.test_recordings import record

from hexwire.control.requests.history import BLOCK
from hexwire.studio.access import Access, Right
from hexwire.studio.app import Studio
from hexwire.studio.files import make_routes
from hexwire.trace.recording import read_joint_states


class Client(GatedClient):
    def __init__(self, studio: Studio) -> None:
        super().__init__(studio, make_routes(lambda: studio))

    def get(self, address: str, **query: Any) -> Any:
        return self.http.get(address, params=query)


@pytest.fixture
def client(tmp_path: Path) -> Iterator[Client]:
    studio = Studio(Access(frozenset()), tmp_path / "recordings")
    try:
        yield Client(studio)
    finally:
        studio.close()


@pytest.fixture
def arm(client: Client) -> Any:
    arm = client.studio.source.open("sim://hex7bot?name=files")
    until(lambda: len(arm.history.rows()) > 10, "states")
    return arm


def test_the_history_comes_as_columns_and_then_only_what_is_new(client: Client, arm: Any) -> None:
    head, times, columns = parsed(client.get("/data/history").content)
    assert len(times) > 10
    assert "J7.position" in columns
    assert 1e9 < times[-1] + head["offset"] < 1e10
    _, newer, _ = parsed(client.get("/data/history", after=times[-1]).content)
    assert all(at > times[-1] for at in newer)


def test_without_an_arm_the_reason_is_told(client: Client) -> None:
    answer = client.get("/data/history")
    assert answer.status_code == 200
    assert "no arm is open" in answer.json()["refused"]
    assert client.get("/data/twin").json() == {"refused": "the twin has not moved yet"}


def test_a_number_that_is_none_is_refused(client: Client, arm: Any) -> None:
    for text in ("x", "nan"):
        assert client.get("/data/history", after=text).json() == {"refused": "after must be a number"}


def test_what_is_shown_is_saved_as_csv(client: Client, arm: Any) -> None:
    _, times, columns = parsed(client.get("/data/history").content)
    query = {"from": times[2], "to": times[6], "columns": "J2.position,rate"}
    answer = client.http.get("/data/history.csv", params=query)
    assert "hex7bot.csv" in answer.headers["content-disposition"]
    head, *rows = csv.reader(io.StringIO(answer.text))
    assert head == ["time", "J2.position", "rate"]
    assert len(rows) == 5
    assert float(rows[0][1]) == pytest.approx(columns["J2.position"][2], abs=1e-6)


def test_it_is_saved_as_a_recording_that_can_be_played(client: Client, arm: Any, tmp_path: Path) -> None:
    _, times, _ = parsed(client.get("/data/history").content)
    answer = client.http.get("/data/history.mcap", params={"from": times[2], "to": times[6]})
    (tmp_path / "a.mcap").write_bytes(answer.content)
    states = list(read_joint_states(tmp_path / "a.mcap", whole=True))
    assert len(states) == 5
    assert states[0].names == arm.settings.model.names
    assert "nothing is known" in client.get("/data/history.mcap", to=0).json()["refused"]


def test_a_recording_is_read_compared_and_downloaded(client: Client) -> None:
    folder = client.studio.recordings.library.folder
    record(folder, "a.mcap")
    record(folder, "b.mcap", 0.5)
    head, times, _ = parsed(client.get("/data/recording", name="a.mcap").content)
    assert (head["names"], len(times)) == (["J1", "J2"], 300)
    head, _, _ = parsed(client.get("/data/compare", a="a.mcap", b="b.mcap", align="best").content)
    assert head["lag"] == pytest.approx(0.5, abs=0.01)
    answer = client.get("/data/recording.mcap", name="a.mcap")
    assert answer.content == (folder / "a.mcap").read_bytes()


@pytest.mark.parametrize("name", ["../secret.mcap", "/etc/passwd", "nothing.mcap", "", "a" * 400])
@pytest.mark.parametrize("address", ["/data/recording", "/data/recording.mcap"])
def test_nothing_outside_of_the_folder_is_given(client: Client, address: str, name: str) -> None:
    record(client.studio.recordings.library.folder.parent, "secret.mcap")
    answer = client.get(address, name=name)
    assert answer.status_code == 200
    assert answer.json()["refused"]


def test_a_file_is_taken_if_it_is_a_recording(client: Client, tmp_path: Path) -> None:
    record(tmp_path, "x.mcap")
    content = (tmp_path / "x.mcap").read_bytes()
    answer = client.http.post("/data/recording", params={"name": "my arm.mcap"}, content=content)
    assert answer.json() == {"name": "my arm.mcap", "problem": ""}
    answer = client.http.post("/data/recording", params={"name": "page.mcap"}, content=b"<html>")
    assert answer.status_code == 200
    assert "nothing was kept" in answer.json()["refused"]
    assert [entry.name for entry in client.studio.recordings.library.entries()] == ["my arm.mcap"]


def test_a_full_disk_is_told(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    async def full(write: object, data: bytes) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("hexwire.studio.sent_files.run_in_threadpool", full)
    answer = client.http.post("/data/recording?name=a.mcap", content=b"x")
    assert answer.status_code == 200
    assert answer.json()["refused"] == "the file cannot be written or read: No space left on device"


def test_who_only_watches_may_send_nothing(client: Client) -> None:
    client.right = Right.WATCH
    assert client.http.post("/data/recording", params={"name": "a.mcap"}, content=b"x").status_code == 403
    assert client.studio.recordings.library.entries() == []


def test_a_file_that_is_too_large_is_refused_however_long_it_claims_to_be(client: Client) -> None:
    client.studio.recordings.library.largest = 1 << 20

    def parts() -> Iterator[bytes]:
        for _ in range(40):
            yield bytes(64 << 10)

    answer = client.http.post("/data/recording", params={"name": "a.mcap"}, content=parts())
    assert answer.status_code == 413
    assert client.studio.recordings.library.entries() == []


def test_whatever_is_made_for_a_page_is_made_in_turn(
    client: Client, arm: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    turns: list[object] = []
    ask = client.studio.ask_files

    async def counted(right: Any, call: Any) -> Any:
        turns.append(right)
        return await ask(right, call)

    monkeypatch.setattr(client.studio, "ask_files", counted)
    # What a page asks for again and again is made at once; of more, another process makes it.
    fill_history(arm, 2 * BLOCK)
    for route in make_routes(lambda: client.studio):
        # A recording is given as it is.
        if "GET" not in (route.methods or ()) or route.path in ("/data/twin", "/data/recording.mcap"):
            continue
        turns.clear()
        client.http.get(
            route.path, params={"name": "a.mcap", "a": "a.mcap", "b": "a.mcap", "topic": "/a", "at": "1"}
        )
        assert turns == [client.right], route.path
