"""The suite for links finds a link that breaks its contract. Each kind of link has its own test with the suite."""

from __future__ import annotations

import inspect
import os
import threading
from pathlib import Path

import pytest

import hexwire.testing.link
from hexwire.errors import LinkClosedError, LinkTimeoutError
from hexwire.link.base import LinkKind
from hexwire.link.memory import memory_pair
from hexwire.testing import LinkConformance
from hexwire.testing.link import Background, descriptors, read_bytes, refused

# These ask what a call does that has no limit.
WITHOUT_LIMIT = {
    "test_a_read_without_deadline_waits",
    "test_closing_ends_a_waiting_read",
    "test_closing_ends_a_waiting_write",
    "test_wake_before_a_read_is_not_lost",
    "test_wake_ends_a_waiting_read",
}


class Memory(LinkConformance):
    def make_pair(self, tmp_path: Path):
        return memory_pair()


@pytest.fixture
def ends():
    near, far = memory_pair()
    far.open()
    near.open()
    yield near, far
    near.close()
    far.close()


def test_a_link_that_changes_a_byte_is_found(ends, monkeypatch: pytest.MonkeyPatch) -> None:
    near, _ = ends
    Memory().test_every_byte_value_passes_both_ways(ends)
    write = near.write
    monkeypatch.setattr(near, "write", lambda data, deadline=None: write(data.replace(b"\x0d", b"\x0a"), deadline))
    with pytest.raises(AssertionError):
        Memory().test_every_byte_value_passes_both_ways(ends)


def test_a_read_that_ends_early_is_found(ends, monkeypatch: pytest.MonkeyPatch) -> None:
    near, _ = ends
    monkeypatch.setattr(near, "read", lambda deadline: b"")
    with pytest.raises(AssertionError):
        Memory().test_a_read_does_not_end_before_its_deadline(ends)


def test_an_exchange_that_ends_early_is_found(ends, monkeypatch: pytest.MonkeyPatch) -> None:
    near, _ = ends
    exchange = near.exchange

    def give_up(data: bytes, window: float) -> bytes:
        return exchange(data, 0.0 if window < 1.0 else window)

    monkeypatch.setattr(near, "exchange", give_up)
    with pytest.raises(AssertionError):
        Memory().test_an_exchange_sends_a_request_and_takes_the_answer(ends)


def test_an_answer_may_come_in_pieces(ends, monkeypatch: pytest.MonkeyPatch) -> None:
    near, _ = ends
    exchange, read = near.exchange, near.read
    rest = bytearray()

    def begin(data: bytes, window: float) -> bytes:
        answer = exchange(data, window)
        rest.extend(answer[3:])
        return answer[:3]

    def go_on(deadline: float | None) -> bytes:
        piece = bytes(rest[:2])
        del rest[:2]
        return piece or read(deadline)

    monkeypatch.setattr(near, "exchange", begin)
    monkeypatch.setattr(near, "read", go_on)
    Memory().test_an_exchange_sends_a_request_and_takes_the_answer(ends)


def test_a_writer_that_waits_where_the_line_drops_what_nobody_reads_is_found(
    ends, monkeypatch: pytest.MonkeyPatch
) -> None:
    suite, (near, _) = Memory(), ends
    suite.back_pressure = False
    taken: list[bytes] = []
    monkeypatch.setattr(near, "write", lambda data, deadline=None: taken.append(data))
    suite.test_a_writer_waits_for_a_reader(ends)
    assert sum(map(len, taken)) > 1_000_000, "more than a line holds"
    monkeypatch.undo()
    monkeypatch.setattr(hexwire.testing.link, "PATIENCE", 0.01)
    with pytest.raises(LinkTimeoutError):
        suite.test_a_writer_waits_for_a_reader(ends)


@pytest.mark.parametrize("kind", LinkKind)
def test_a_link_that_does_nothing_more_keeps_no_question_for_ever(
    kind: LinkKind, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All that a link is asked has a limit, except where the question is what happens without one."""
    suite = Memory()
    unlimited: list[str] = []
    for name, question in inspect.getmembers(suite, inspect.ismethod):
        if (
            not name.startswith("test_")
            or name in WITHOUT_LIMIT
            or "ends" not in inspect.signature(question).parameters
        ):
            continue
        near, far = memory_pair(kind, max_message=2000)
        for link in (near, far):
            for way in ("read", "write"):
                call = getattr(link, way)

                def limited(*data: bytes | float | None, call=call, name=name) -> bytes | None:
                    if not isinstance(data[-1], float):
                        unlimited.append(name)
                        raise LinkClosedError("without a limit", url="")
                    return call(*data)

                monkeypatch.setattr(link, way, limited)
        try:
            suite.open_pair(near, far)
            question((near, far))
        except LinkClosedError:
            assert name in unlimited
        finally:
            near.close()
            far.close()
    assert unlimited == []


def test_a_link_that_never_has_anything_to_read_is_found(ends, monkeypatch: pytest.MonkeyPatch) -> None:
    near, _ = ends
    monkeypatch.setattr(hexwire.testing.link, "PATIENCE", 0.01)
    reading, writing = os.pipe()
    try:
        monkeypatch.setattr(near, "fileno", lambda: reading)
        with pytest.raises(AssertionError):
            Memory().wait_readable(near)
        os.write(writing, b"x")
        Memory().wait_readable(near)
    finally:
        os.close(reading)
        os.close(writing)


def test_the_suite_of_a_link_needs_its_pair(tmp_path: Path) -> None:
    with pytest.raises(NotImplementedError):
        LinkConformance().make_pair(tmp_path)


def test_a_call_in_the_background_gives_its_result_or_its_error() -> None:
    assert Background(lambda: 7).outcome() == 7
    with pytest.raises(ZeroDivisionError):
        Background(lambda: 1 // 0).outcome()
    released = threading.Event()
    waiting = Background(released.wait)
    waiting.let_it_block()
    released.set()
    assert waiting.outcome() is True


def test_the_helpers(ends) -> None:
    near, far = ends
    far.write(b"ab")
    far.write(b"c")
    assert read_bytes(near, 3) == b"abc"
    near.close()
    with refused(LinkClosedError, near):
        near.read(0.0)
    before = descriptors()
    with Path(__file__).open() as file:
        assert descriptors() - before == {(str(file.fileno()), __file__)}
    assert descriptors() <= before
