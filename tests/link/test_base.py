from __future__ import annotations

import time

import pytest

from hexwire.errors import LinkTimeoutError
from hexwire.link.base import WRITE_TIME, Link, LinkKind


class PlainLink(Link):
    """The least that a link is."""

    kind = LinkKind.STREAM

    def __init__(self) -> None:
        self.url = "plain://"
        self.opened = False
        self.calls: list[tuple[object, ...]] = []

    @property
    def is_open(self) -> bool:
        return self.opened

    def open(self) -> None:
        self.opened = True

    def close(self) -> None:
        self.opened = False

    def read(self, deadline: float | None) -> bytes:
        self.calls.append(("read", deadline))
        return b"answer"

    def write(self, data: bytes, deadline: float | None = None) -> None:
        self.calls.append((data, deadline))

    def flush_input(self) -> int:
        return 0

    def wake(self) -> None:
        pass


def test_the_contract_alone_is_no_link() -> None:
    with pytest.raises(TypeError):
        Link()  # type: ignore[abstract]  # that is the point


def test_a_link_is_a_context_manager_and_says_what_it_is() -> None:
    link = PlainLink()
    assert repr(link) == "<PlainLink plain:// closed>"
    with link as same:
        assert same is link
        assert repr(link) == "<PlainLink plain:// open>"
    assert not link.is_open
    assert link.max_message is None
    with pytest.raises(LinkTimeoutError), link:
        raise LinkTimeoutError("what happens inside passes")
    assert not link.is_open


def test_an_exchange_is_a_write_and_a_read_each_with_its_deadline() -> None:
    link = PlainLink()
    before = time.monotonic()
    assert link.exchange(b"request", 5.0) == b"answer"
    after = time.monotonic()
    (data, write_deadline), (_, read_deadline) = link.calls
    assert data == b"request"
    assert isinstance(write_deadline, float)
    assert isinstance(read_deadline, float)
    assert before + WRITE_TIME <= write_deadline <= after + WRITE_TIME
    assert before + 5.0 <= read_deadline <= after + 5.0


def test_an_exchange_reads_until_all_has_arrived() -> None:
    link = PlainLink()
    link.clock = lambda: 100.0  # type: ignore[attr-defined]  # as links in simulated time have
    waits = {b"answer": 2.0, b"answeranswer": 0.0}
    assert link.exchange(b"request", 5.0, waits.__getitem__) == b"answeranswer"
    assert [call[1] for call in link.calls] == [100.0 + WRITE_TIME, 105.0, 102.0]


def test_an_exchange_in_simulated_time_uses_the_links_clock() -> None:
    link = PlainLink()
    link.clock = lambda: 100.0  # type: ignore[attr-defined]  # as links in simulated time have
    link.exchange(b"request", 5.0)
    assert link.calls == [(b"request", 100.0 + WRITE_TIME), ("read", 105.0)]
