"""The list of recordings, and what is done with them."""

from __future__ import annotations

import errno
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.studio.asking import answer_of
from tests.studio.fake_camera import JPEG, FakeCamera
from tests.studio.gate import GatedClient
from tests.studio.running import until
from tests.studio.test_recordings import record
from tests.waits import eventually

from hexwire.studio.access import WATCHING_ONLY, Access, Right
from hexwire.studio.app import Studio
from hexwire.studio.files import make_routes


class Client(GatedClient):
    def __init__(self, studio: Studio) -> None:
        super().__init__(studio, make_routes(lambda: studio))
        self._tabs = {right: studio.tabs.open("session", right) for right in Right}

    def list(self) -> dict[str, Any]:
        return dict(self.ask("recordings"))

    def do(self, what: str, /, **args: Any) -> Any:
        return self.ask(f"recordings.{what}", **args)

    def ask(self, name: str, /, **args: Any) -> Any:
        """The value of the answer to a call."""
        answer = self.answer(name, **args)
        assert "value" in answer, answer
        return answer["value"]

    def refusal(self, name: str, /, **args: Any) -> str:
        """The error of the answer to a call."""
        return str(self.answer(name, **args)["error"])

    def answer(self, name: str, /, **args: Any) -> dict[str, Any]:
        return answer_of(self.studio, self._tabs[self.right], name, args)


@pytest.fixture
def client(tmp_path: Path) -> Iterator[Client]:
    studio = Studio(Access(frozenset()), tmp_path / "recordings")
    try:
        yield Client(studio)
    finally:
        studio.close()


def test_it_lists_recordings_and_whether_the_open_arm_can_play_them(client: Client) -> None:
    folder = client.studio.recordings.library.folder
    record(folder, "mine.mcap")
    record(folder, "other.mcap", joints=("K1",))
    content = (folder / "mine.mcap").read_bytes()
    (folder / "cut.mcap").write_bytes(content[: len(content) // 2])
    rows = {row["name"]: row for row in client.list()["entries"]}
    assert not rows["mine.mcap"]["fits"]
    client.studio.source.open("sim://hex7bot?name=recordings")
    rows = {row["name"]: row for row in client.list()["entries"]}
    assert [rows[name]["fits"] for name in ("mine.mcap", "other.mcap")] == [True, False]
    assert [rows[name]["twin"] for name in ("mine.mcap", "other.mcap")] == ["hex7bot", ""]
    assert "truncated" in rows["cut.mcap"]["problem"]
    assert client.list()["robot"] == "hex7bot"


def test_the_session_is_recorded_until_its_end_or_until_the_arm_is_closed(client: Client) -> None:
    assert "no arm is open" in client.refusal("recordings.record")
    studio = client.studio
    studio.source.open("sim://hex7bot?name=recordings")
    name = client.do("record")
    until(lambda: client.list()["recorder"]["states"] > 3, "states")
    # It is no damaged recording while it is being written.
    assert client.list()["entries"] == []
    assert client.do("end").startswith(name)
    assert [row["name"] for row in client.list()["entries"]] == [name]
    second = client.do("record")
    until(lambda: client.list()["recorder"]["states"] > 3, "states")
    studio.source.close()
    until(lambda: client.list()["recorder"]["name"] == "", "the end of the recording")
    rows = {row["name"]: row for row in client.list()["entries"]}
    assert rows[second]["problem"] == ""


def test_cameras_are_recorded_if_that_is_asked_for_and_their_pictures_are_found_by_time(client: Client) -> None:
    fake, studio = FakeCamera(streams=True), client.studio
    studio.cameras.rows["video0"] = fake.camera
    studio.source.open("sim://hex7bot?name=recordings")
    assert client.list()["cameras"] == ["video0"]
    client.do("record")
    until(lambda: studio.recordings.recorder.state.states > 3, "states")
    client.do("end")
    assert fake.opened == 0
    name = client.do("record", cameras=True)
    until(lambda: studio.recordings.recorder.state.pictures > 3, "pictures")
    client.do("end")
    (row,) = (row for row in client.list()["entries"] if row["name"] == name)
    assert row["cameras"] == ["/camera/video0"]
    # Whoever only watches sees them, too.
    client.right = Right.WATCH
    query = {"name": name, "topic": "/camera/video0", "at": row["begin"] + row["duration"]}
    found = client.http.get("/data/picture", params=query)
    assert (found.content, found.headers["content-type"]) == (JPEG, "image/jpeg")
    for changed in ({"topic": "/camera/video1"}, {"at": "x"}, {"name": "../a.mcap"}, {"at": "nan"}, {"topic": ""}):
        assert "refused" in client.http.get("/data/picture", params=query | changed).json(), changed


def test_a_damaged_recording_is_recovered_and_one_is_removed(client: Client) -> None:
    folder = client.studio.recordings.library.folder
    record(folder, "a.mcap")
    content = (folder / "a.mcap").read_bytes()
    (folder / "a.mcap").write_bytes(content[:-40])
    assert client.do("recover", name="a.mcap") == "a recovered.mcap"
    client.do("remove", name="a.mcap")
    assert [row["name"] for row in client.list()["entries"]] == ["a recovered.mcap"]


@pytest.mark.slow
def test_the_twin_plays_a_part(client: Client) -> None:
    record(client.studio.recordings.library.folder, "a.mcap")
    client.do("twin", name="a.mcap", part={"begin": 1.0, "end": 2.0, "factor": 2.0})
    assert client.list()["twin"]["robot"] == "hex7bot"
    until(lambda: not client.list()["twin"]["busy"], "the end")
    assert client.list()["twin"]["arrived"]
    # Slowly, so that it is not over before a busy machine stops it.
    client.do("twin", name="a.mcap", part={"factor": 0.1})
    assert "the twin is moving" in client.refusal("recordings.twin", name="a.mcap")
    client.do("end_twin")
    assert client.list()["twin"]["ended"] == "stopped"


def test_what_playing_on_the_arm_would_be_is_told_without_moving(client: Client) -> None:
    record(client.studio.recordings.library.folder, "a.mcap")
    arm = client.studio.source.open("sim://hex7bot?name=recordings")
    until(lambda: arm.arm.owner.state is not None, "a state")
    plan = eventually(
        # On a busy machine an arm has not answered for a moment, and nothing can be planned.
        lambda: client.answer("arm.preview", motion={"what": "play", "recording": "a.mcap"}).get("value")
    )
    assert plan["duration"] > plan["lead_in"] > 0
    assert plan["refusal"] or plan["unready"]
    assert not arm.arm.owner.group.moving


WRONG_ORDERS: list[tuple[str, dict[str, Any], str]] = [
    ("recordings.twin", {"name": "a.mcap", "part": {"factor": 99}}, "0.1 to 4 times"),
    ("recordings.twin", {"name": "a.mcap", "part": {"begin": 5, "end": 2}}, "nothing is left between 5 and 2 s"),
    ("recordings.twin", {"name": "a.mcap", "part": {"begin": "x"}}, "begin must be a number, not the text 'x'"),
    ("recordings.twin", {"name": "a.mcap", "part": {"begin": float("nan")}}, "begin must be a finite number"),
    ("recordings.twin", {"name": "a.mcap", "part": {"what": "joints", "goals": {}}}, "goals is an unknown key"),
    ("recordings.twin", {"name": "../a.mcap"}, "there is no recording"),
    ("recordings.recover", {"name": "../a.mcap"}, "cannot be the name"),
    ("recordings.remove", {"name": "../a.mcap"}, "cannot be the name"),
    ("recordings.remove", {}, "missing required field `name`"),
    ("recordings.remove", {"name": 5}, "Expected `str`, got `int`"),
    ("recordings.remove", {"name": "a.mcap", "folder": "/"}, "unknown field `folder`"),
    ("recordings.geometry", {"robot": "../x"}, "not known"),
    ("arm.preview", {"motion": {"what": "play", "recording": "../a.mcap"}}, "cannot be the name"),
    ("recordings.format", {}, "there is no call"),
]


def test_a_wrong_order_is_refused(client: Client) -> None:
    folder = client.studio.recordings.library.folder
    record(folder, "a.mcap")
    record(folder.parent, "a.mcap")
    client.studio.source.open("sim://hex7bot?name=recordings")
    for name, args, why in WRONG_ORDERS:
        assert why in client.refusal(name, **args), (name, args)
    assert [path.parent for path in folder.parent.rglob("*.mcap")] == [folder.parent, folder]


def test_a_folder_that_fails_is_told(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = client.studio.recordings.library.folder
    record(folder, "a.mcap")
    (folder / "a#1.mcap").write_bytes(b"x")
    assert client.list()["remark"].startswith("1 file is not listed")

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(client.studio.recordings.recorder, "start", full)
    client.studio.source.open("sim://hex7bot?name=recordings")
    assert "No space left on device" in client.refusal("recordings.record")
    shutil.rmtree(folder)
    folder.write_text("no folder")
    assert "Not a directory" in client.refusal("recordings")


def test_who_only_watches_changes_nothing(client: Client) -> None:
    client.right = Right.WATCH
    record(client.studio.recordings.library.folder, "a.mcap")
    for what in ("record", "end", "recover", "remove", "twin", "end_twin"):
        assert WATCHING_ONLY in client.refusal(f"recordings.{what}", name="a.mcap")
    client.studio.source.open("sim://hex7bot?name=recordings")
    assert WATCHING_ONLY in client.refusal("arm.preview", motion={"what": "play", "recording": "a.mcap"})
    assert len(client.list()["entries"]) == 1


def test_the_shapes_of_the_arm_of_a_recording_are_given(client: Client) -> None:
    found = client.do("geometry", robot="so101")["geometry"]
    assert found["name"] == "so101"
    assert found["links"]
