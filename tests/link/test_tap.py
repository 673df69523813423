"""The tap sees what passes, in order, and changes nothing."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest
from far_ends import Recorder

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
        assert far.read(time.monotonic() + 30) == b"question"
        far.write(b"answer")
        assert tap.read(time.monotonic() + 30) == b"answer"
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
        assert tap.read(time.monotonic() + 30) == b""
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


def test_an_observers_exception_is_counted_and_not_passed_on() -> None:
    def observer(passed: Passed) -> None:
        raise ValueError(passed.data.decode())

    near, far = memory_pair()
    with TapLink(near, observer) as tap, far:
        tap.write(b"question")
        assert far.read(time.monotonic() + 30) == b"question"
        far.write(b"answer")
        assert tap.read(time.monotonic() + 30) == b"answer"
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


def test_every_call_is_passed_on_as_it_is() -> None:
    link, seen = Recorder(), list[Passed]()
    link.clock = lambda: 42.0  # type: ignore[attr-defined]  # as links in simulated time have one
    tap = TapLink(link, seen.append)
    tap.open()
    tap.write(b"w", 1.5)
    tap.write(b"v")
    assert tap.read(2.5) == b""
    link.answer = b"r"
    assert tap.read(None) == b"r"
    assert tap.flush_input() == 7
    tap.wake()
    tap.confirm()
    tap.close()
    assert link.calls == [
        "open", ("write", b"w", 1.5), ("write", b"v", None), ("read", 2.5), ("read", None), "flush", "wake",
        "confirm", "close",
    ]  # fmt: skip
    assert seen == [
        Passed(Direction.SENT, b"w", 42.0, link.url),
        Passed(Direction.SENT, b"v", 42.0, link.url),
        Passed(Direction.RECEIVED, b"r", 42.0, link.url),
    ]


def test_the_clock_is_the_links_own_if_it_has_one() -> None:
    link = Recorder()
    assert TapLink(link, lambda _: None).clock is time.monotonic
    link.clock = lambda: 5.0  # type: ignore[attr-defined]  # as links in simulated time have one
    assert TapLink(link, lambda _: None).clock() == 5.0


def test_wrappers_in_wrappers_are_applied_from_the_outside_in() -> None:
    names: list[str] = []

    def named(name: str) -> Callable[[Link], Link]:
        return lambda link: names.append(name) or TapLink(link, lambda _: None)  # type: ignore[func-returns-value]

    link = Recorder()
    with wrap_new_links(named("outer")):
        with wrap_new_links(named("inner")):
            wrapped = tapped(link)
        assert names == ["outer", "inner"]
        assert isinstance(wrapped, TapLink)
        assert isinstance(wrapped.link, TapLink)
        assert wrapped.link.link is link
        tapped(link)
    assert names == ["outer", "inner", "outer"]
    assert tapped(link) is link


def test_the_first_failure_is_kept_without_what_it_held() -> None:
    missed = Missed()
    for text in ("first", "second"):
        try:
            raise ValueError(text)
        except ValueError as error:
            missed.add(error)
    assert (missed.count, str(missed.first)) == (2, "first")
    assert missed.first is not None
    assert missed.first.__traceback__ is None
