"""What the wire page asks for: who may ask, how much may come in, and that a wrong question is an answer."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from typing import Any, SupportsIndex

import pytest
from tests.studio.asking import Asker, answer_of

from hexwire.link.tap import Passed
from hexwire.studio.access import Access, Right
from hexwire.studio.app import Studio
from hexwire.studio.tabs import Tab
from hexwire.studio.wire_api import wire_routes
from hexwire.studio.wire_view import LARGEST_FILE
from hexwire.trace.sources import read_traffic

PING = b"FF FF 04 02 01 F8"


class Desk:
    """A studio with a tab, and who asks for it."""

    def __init__(self) -> None:
        self.studio = Studio(Access(frozenset()))
        session = self.studio.access.admit(Right.OPERATE, 0.0)
        self.operators = self.studio.tabs.open(session.key, Right.OPERATE)
        self.operate = Asker(wire_routes(lambda: self.studio), session)
        self.session = self.studio.access.admit(Right.WATCH, 0.0)
        self.viewers = self.studio.tabs.open(self.session.key, Right.WATCH)
        self.tab = self.viewers.key
        self.ask = Asker(wire_routes(lambda: self.studio), self.session)

    def call(self, name: str, tab: Tab | None = None, **args: object) -> Any:
        """The value of the answer to a call; its error in words if it has none."""
        found = answer_of(self.studio, tab or self.viewers, f"wire.{name}", args)
        return found["value"] if "value" in found else found["error"]


@pytest.fixture
def desk() -> Iterator[Desk]:
    made = Desk()
    yield made
    made.studio.close()


def test_a_viewer_opens_a_file_and_sees_its_frames(desk: Desk) -> None:
    opened = desk.ask("/wire/open", "POST", [PING[:7], PING[7:]], tab=desk.tab, name="a.txt")
    assert opened == {"opened": "a.txt"}
    page = desk.call("rows")
    assert (page["view"], page["name"], [row[5] for row in page["rows"]]) == ("file", "a.txt", ["ping 4"])
    assert desk.call("frame", number=1)["hex"] == "ffff040201f8"
    assert desk.call("rows", filter="bad")["rows"] == []
    assert "servo needs a number" in desk.call("rows", filter="servo")
    status, saved = desk.ask.raw("/wire/save", tab=desk.tab, form="pcapng")
    (passed,) = read_traffic(saved)
    assert status == 200
    assert isinstance(passed, Passed)
    assert passed.data == bytes.fromhex(PING.decode())
    assert desk.call("series", series="scs") is None
    assert desk.call("rows")["series"] == "scs"
    # It is of this tab only.
    assert desk.call("rows", desk.operators)["view"] == "live"
    assert desk.call("line") is None
    assert desk.call("rows")["view"] == "live"


def test_of_a_file_that_is_gone_the_line_is_shown_again(desk: Desk) -> None:
    desk.ask("/wire/open", "POST", [PING], tab=desk.tab, name="a.txt")
    process = desk.studio.files[Right.WATCH].pid
    assert process is not None
    os.kill(process, signal.SIGKILL)
    # The first call may meet the process on its way out, and is told so.
    found = [desk.call("rows") for _ in range(3)]
    assert isinstance(found[0], dict) or "has ended with status -9; try again" in found[0]
    assert [rows["view"] for rows in found[1:]] == ["live"] * 2
    assert not desk.viewers.file


@pytest.mark.parametrize(
    ("name", "args", "words"),
    [
        ("rows", {"since": "x"}, "Expected `int`, got `str`"),
        ("rows", {"since": 2**53}, "Expected `int` <= 9007199254740991"),
        ("rows", {"since": -1}, "Expected `int` >= 0"),
        ("rows", {"filter": "servo"}, "servo needs a number"),
        ("rows", {"filter": "x" * 300}, "at most 200"),
        ("frame", {"number": 5}, "no longer kept"),
        ("series", {"series": "../x"}, "there is no servo series"),
    ],
)
def test_a_wrong_question_is_answered_in_one_line(
    desk: Desk, name: str, args: dict[str, object], words: str
) -> None:
    assert words in desk.call(name, **args)


def test_what_cannot_be_saved_is_said_in_one_line(desk: Desk) -> None:
    for form, words in (("exe", "mcap or pcapng"), ("mcap", "no traffic to save yet")):
        assert words in desk.ask("/wire/save", tab=desk.tab, form=form)["refused"]


def test_only_the_tabs_of_a_session_are_answered(desk: Desk) -> None:
    other = desk.studio.tabs.open("another session", Right.OPERATE).key
    for tab in ("", "x", other):
        assert "no longer known" in desk.ask("/wire/save", tab=tab)["refused"]
        assert "no longer known" in desk.ask("/wire/open", "POST", [PING], tab=tab)["refused"]


def test_what_changes_something_is_no_link(desk: Desk) -> None:
    assert desk.ask.raw("/wire/open", tab=desk.tab)[0] == 405


def test_a_file_that_never_ends_is_refused_on_the_way(desk: Desk) -> None:
    pieces = [bytes(1 << 20)] * (LARGEST_FILE // (1 << 20) + 9)
    assert "larger than 16 MiB" in desk.ask("/wire/open", "POST", pieces, tab=desk.tab)["refused"]
    assert len(pieces) == 8
    assert desk.call("rows")["view"] == "live"


class _Meanwhile(list[bytes]):
    """A body while which others come, each one before the end of the former."""

    def __init__(
        self, desk: Desk, others: int, answers: list[dict[str, str]], last: Callable[[], object] = lambda: None
    ) -> None:
        super().__init__([PING])
        self._desk, self._others, self._answers, self._last = desk, others, answers, last

    def pop(self, at: SupportsIndex = -1) -> bytes:
        if not self._others:
            self._last()
        else:
            body = _Meanwhile(self._desk, self._others - 1, self._answers, self._last)

            def ask() -> None:
                self._answers.append(self._desk.ask("/wire/open", "POST", body, tab=self._desk.tab, name="a.txt"))

            thread = threading.Thread(target=ask)
            thread.start()
            thread.join()
        return super().pop(at)


def test_whoever_only_watches_hinders_no_file_of_an_operators(desk: Desk) -> None:
    mine: list[dict[str, str]] = []

    def operate() -> None:
        def ask() -> None:
            mine.append(desk.operate("/wire/open", "POST", [PING], tab=desk.operators.key, name="mine.txt"))

        thread = threading.Thread(target=ask)
        thread.start()
        thread.join()

    answers: list[dict[str, str]] = []
    # As many as may be are under way when it comes.
    desk.ask("/wire/open", "POST", _Meanwhile(desk, 3, answers, operate), tab=desk.tab, name="a.txt")
    assert (len(answers), mine) == (3, [{"opened": "mine.txt"}])
    for _ in range(6):
        tab = desk.studio.tabs.open(desk.session.key, Right.WATCH).key
        assert desk.ask("/wire/open", "POST", [PING], tab=tab, name="a.txt") == {"opened": "a.txt"}
    assert desk.call("rows", desk.operators)["name"] == "mine.txt"
    # Of their own, the oldest are closed.
    assert desk.call("rows")["view"] == "live"
