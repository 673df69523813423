"""Files of traffic: each is shown to its tab, within bounds."""

from __future__ import annotations

from pathlib import Path

import pytest

from hexwire.errors import UsageError
from hexwire.studio.wire_files import WireFiles
from hexwire.studio.wire_view import LARGEST_FILE
from hexwire.wire.servo_packet import make_ping

CAPTURES = Path(__file__).parents[2] / "vectors" / "captures"


@pytest.mark.parametrize("name", ["cooked-port.log", "cut-frame.pcapng", "wrong-id.txt"])
def test_a_file_is_shown_to_its_tab_only(name: str) -> None:
    files = WireFiles()
    files.open("b", (CAPTURES / name).read_bytes(), name)
    view = files.view("b")
    assert view is not None
    shown = view.rows(0)
    assert (shown["view"], shown["name"]) == ("file", name)
    assert any(row[6] for row in shown["rows"]) or name == "wrong-id.txt"
    assert files.view("a") is None
    files.close("b")
    assert files.view("b") is None


def test_a_file_that_is_too_large_or_no_traffic_is_refused() -> None:
    files = WireFiles()
    with pytest.raises(UsageError, match="larger than 16 MiB"):
        files.open("a", bytes(LARGEST_FILE + 1), "x")
    with pytest.raises(UsageError, match="x has no traffic"):
        files.open("a", b"hello\nworld\n", "x")
    with pytest.raises(UsageError, match="x has no frame or packet"):
        files.open("a", b"\x89PNG\r\n\x1a\n" + bytes(range(256)) * 100, "x")
    assert files.view("a") is None


def test_the_files_of_many_tabs_are_bounded() -> None:
    files = WireFiles()
    for i in range(20):
        files.open(str(i), b"FF FF 01 02 01 FB", "x")
    assert [files.view(str(i)) is not None for i in range(20)] == [False] * 16 + [True] * 4
    files.open("19", b"FF FF 01 02 01 FB", "y")
    assert files.view("16") is not None, "a second file of a tab takes the place of its first"


@pytest.mark.slow
def test_a_small_file_with_millions_of_frames_is_read_up_to_a_bound() -> None:
    files, many = WireFiles(), make_ping(4) * 100_000
    for name, data, most in (("raw.bin", many, 31_000), ("x.txt", b"> FF\n" * 201_000, 200_001)):
        files.open("a", data, name)
        view = files.view("a")
        assert view is not None
        page = view.rows(0)
        assert page["newest"] <= most
        assert "only the first" in page["note"]
        assert len(page["rows"]) <= 1000
    assert files.set_series("a", "scs")
    view = files.view("a")
    assert view is not None
    assert "only the first" in view.rows(0)["note"]


def test_the_series_decides_the_names_of_registers() -> None:
    files = WireFiles()

    def shown() -> str:
        view = files.view("a")
        assert view is not None
        return str(view.rows(0)["rows"][0][5])

    files.open("a", b"FF FF 01 04 02 2A 02 CC", "x", "sts_sms")
    assert "goal_position" in shown()
    assert files.set_series("a", "seven_bot")
    assert "target_position" in shown()
    assert not files.set_series("b", "seven_bot")
    with pytest.raises(UsageError, match="no servo series"):
        files.set_series("a", "other")
