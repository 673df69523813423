"""The tap sees what passes, in order, and changes nothing."""

from __future__ import annotations

import time

import pytest

from hexwire.errors import LinkClosedError
from hexwire.link.base import Link
from hexwire.link.memory import memory_pair
from hexwire.link.open import make_link
from hexwire.link.tap import Direction, Missed, Passed, TapLink, tapped, wrap_new_links


def test_everything_that_passes_is_told_in_order() -> None:
    near, far = memory_pair()
    seen: list[Passed] = []
    with TapLink(near, seen.append) as tap, far:
        tap.write(b"question")
        assert far.read(time.monotonic() + 5) == b"question"
        far.write(b"answer")
        assert tap.read(time.monotonic() + 5) == b"answer"
        assert tap.exchange(b"again", 0.0) == b""
        tap.write(b"")
    assert [(p.direction, p.data) for p in seen] == [
        (Direction.SENT, b"question"),
        (Direction.RECEIVED, b"answer"),
        (Direction.SENT, b"again"),
    ]
    assert seen[0].time <= seen[1].time <= seen[2].time
    assert seen[0].url == near.url


def test_it_is_the_link_it_wraps() -> None:
    near, far = memory_pair()
    tap = TapLink(near, lambda _: None)
    assert (tap.url, tap.kind, tap.max_message, tap.is_open) == (near.url, near.kind, near.max_message, False)
    with tap, far:
        assert tap.is_open
        assert near.is_open
        far.write(b"old")
        assert tap.flush_input() == 3
        tap.wake()
        assert tap.read(time.monotonic() + 5) == b""
    with pytest.raises(LinkClosedError):
        tap.read(None)


def test_new_links_are_wrapped_only_while_asked_for() -> None:
    made: list[Link] = []

    def wrap(link: Link) -> Link:
        made.append(link)
        return TapLink(link, lambda _: None)

    assert not isinstance(make_link("serial:///dev/nothing"), TapLink)
    with wrap_new_links(wrap):
        assert isinstance(make_link("serial:///dev/nothing"), TapLink)
    assert len(made) == 1
    near, _ = memory_pair()
    assert tapped(near) is near


def test_what_an_observer_raises_is_counted_and_goes_no_further() -> None:
    def observer(passed: Passed) -> None:
        raise ValueError(passed.data.decode())

    near, far = memory_pair()
    with TapLink(near, observer) as tap, far:
        tap.write(b"question")
        assert far.read(time.monotonic() + 5) == b"question"
        far.write(b"answer")
        assert tap.read(time.monotonic() + 5) == b"answer"
    assert (tap.missed.count, str(tap.missed.first)) == (2, "question")


def test_an_interruption_is_no_failure_of_an_observer() -> None:
    def observer() -> None:
        raise KeyboardInterrupt

    missed = Missed()
    with pytest.raises(KeyboardInterrupt):
        missed.guard(observer)()
    assert missed.count == 0


def test_what_only_some_links_have_is_still_there() -> None:
    link = make_link("serial:///dev/nothing?baud=57600")
    tap = TapLink(link, lambda _: None)
    assert tap.baud == 57600
    assert tap.set_baud == link.set_baud  # type: ignore[attr-defined]  # a serial port has it
    assert not hasattr(TapLink(memory_pair()[0], lambda _: None), "set_baud")
