"""What the wire page asks for: who may ask, how much may come in, and that a wrong question is an answer."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import SupportsIndex

import pytest
from tests.studio.asking import Asker

from hexwire.link.tap import Passed
from hexwire.studio.access import Access, Right
from hexwire.studio.app import Studio
from hexwire.studio.wire_api import wire_routes
from hexwire.studio.wire_view import LARGEST_FILE
from hexwire.trace.sources import read_traffic

PING = b"FF FF 04 02 01 F8"


class Desk:
    """A studio with a tab, and who asks for it."""

    def __init__(self) -> None:
        self.studio = Studio(Access(frozenset()))
        session = self.studio.access.admit(Right.OPERATE, 0.0)
        self.operators = self.studio.tabs.open(session.key, Right.OPERATE).key
        self.operate = Asker(wire_routes(lambda: self.studio), session)
        self.session = self.studio.access.admit(Right.WATCH, 0.0)
        self.tab = self.studio.tabs.open(self.session.key, Right.WATCH).key
        self.ask = Asker(wire_routes(lambda: self.studio), self.session)


@pytest.fixture
def desk() -> Iterator[Desk]:
    made = Desk()
    yield made
    made.studio.close()


def test_a_viewer_opens_a_file_and_sees_its_frames(desk: Desk) -> None:
    opened = desk.ask("/wire/open", "POST", [PING[:7], PING[7:]], tab=desk.tab, name="a.txt")
    assert opened == {"opened": "a.txt"}
    page = desk.ask("/wire/rows", tab=desk.tab, since=0)
    assert (page["view"], page["name"], [row[5] for row in page["rows"]]) == ("file", "a.txt", ["ping 4"])
    assert desk.ask("/wire/frame", tab=desk.tab, number=1)["hex"] == "ffff040201f8"
    assert desk.ask("/wire/rows", tab=desk.tab, since=0, filter="bad")["rows"] == []
    status, saved = desk.ask.raw("/wire/save", tab=desk.tab, form="pcapng")
    (passed,) = read_traffic(saved)
    assert status == 200
    assert isinstance(passed, Passed)
    assert passed.data == bytes.fromhex(PING.decode())
    assert desk.ask("/wire/series", "POST", tab=desk.tab, series="scs") == {"series": "scs"}
    assert desk.ask("/wire/live", "POST", tab=desk.tab) == {"view": "live"}
    assert desk.ask("/wire/rows", tab=desk.tab, since=0)["view"] == "live"


@pytest.mark.parametrize(
    ("path", "query", "words"),
    [
        ("rows", {"since": "x"}, "since is not a number"),
        ("rows", {"since": "9" * 17}, "since is not a number"),
        ("rows", {"filter": "servo"}, "servo needs a number"),
        ("rows", {"filter": "x" * 300}, "at most 200"),
        ("frame", {"number": 5}, "no longer kept"),
        ("save", {"form": "exe"}, "mcap or pcapng"),
        ("save", {"form": "mcap"}, "no traffic to save yet"),
    ],
)
def test_a_wrong_question_is_answered_in_one_line(
    desk: Desk, path: str, query: dict[str, object], words: str
) -> None:
    assert words in desk.ask(f"/wire/{path}", tab=desk.tab, **query)["refused"]


def test_only_the_tabs_of_a_session_are_answered(desk: Desk) -> None:
    other = desk.studio.tabs.open("another session", Right.OPERATE).key
    for path in ("rows", "frame", "save"):
        for tab in ("", "x", other):
            assert "no longer known" in desk.ask(f"/wire/{path}", tab=tab)["refused"]
    for path in ("open", "live", "series"):
        assert "no longer known" in desk.ask(f"/wire/{path}", "POST", [PING], tab=other)["refused"]


def test_what_changes_something_is_no_link(desk: Desk) -> None:
    for path in ("open", "live", "series"):
        assert desk.ask.raw(f"/wire/{path}", tab=desk.tab)[0] == 405


def test_a_file_that_never_ends_is_refused_on_the_way(desk: Desk) -> None:
    pieces = [bytes(1 << 20)] * (LARGEST_FILE // (1 << 20) + 9)
    assert "larger than 16 MiB" in desk.ask("/wire/open", "POST", pieces, tab=desk.tab)["refused"]
    assert len(pieces) == 8
    assert desk.ask("/wire/rows", tab=desk.tab)["view"] == "live"


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
            mine.append(desk.operate("/wire/open", "POST", [PING], tab=desk.operators, name="mine.txt"))

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
    assert desk.operate("/wire/rows", tab=desk.operators)["name"] == "mine.txt"
    # Of their own, the oldest are closed.
    assert desk.ask("/wire/rows", tab=desk.tab)["view"] == "live"
