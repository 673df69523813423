"""What every link must do, whatever it is made of.

Owns the questions that `hexwire.link.base` answers in its documentation, and helpers for them. Must not know any
particular link. A link inherits all of it with a few lines::

    class TestMemory(LinkConformance):
        def make_pair(self, tmp_path):
            return memory_pair()

`make_pair` builds two ends, neither open; `far` is opened first. The class attributes below say what the line
can do by its nature.
"""

from __future__ import annotations

import contextlib
import select
import threading
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

from hexwire.errors import (
    LinkBusyError,
    LinkClosedError,
    LinkError,
    LinkLostError,
    LinkTimeoutError,
    UsageError,
)
from hexwire.link.base import Link, LinkKind

# Long enough for a machine that stalls; nothing waits for it unless it fails.
PATIENCE = 30.0
ALL_BYTES = bytes(range(256))
_DESCRIPTORS = Path("/proc/self/fd")


def soon() -> float:
    """A deadline that is far enough for a machine that stalls."""
    return time.monotonic() + PATIENCE


def in_a_moment() -> float:
    """A deadline for what should not happen."""
    return time.monotonic() + 0.05


def read_bytes(link: Link, count: int) -> bytes:
    """Read exactly `count` bytes of a stream, or fail."""
    data = b""
    deadline = soon()
    while len(data) < count:
        piece = link.read(deadline)
        assert piece, f"{len(data)} of {count} bytes arrived"
        data += piece
    return data


class Background:
    """A call in a thread of its own, whose outcome is asked for later."""

    def __init__(self, call: Callable[[], object]) -> None:
        self._call = call
        self.result: object = None
        self.error: BaseException | None = None
        self._begun = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        self._begun.set()
        try:
            self.result = self._call()
        except Exception as error:  # noqa: BLE001 (handed to the thread that asks)
            self.error = error

    def outcome(self) -> object:
        self._thread.join(PATIENCE)
        assert not self._thread.is_alive(), "the call still waits"
        if self.error is not None:
            raise self.error
        return self.result

    def let_it_block(self) -> None:
        """Give the thread the time to get into its wait; if it does not, the test is easier, not wrong."""
        self._begun.wait(PATIENCE)
        self._thread.join(0.05)
        assert self._thread.is_alive(), "the call did not wait"


@contextlib.contextmanager
def refused(kind: type[LinkError], link: Link) -> Iterator[None]:
    """The call fails with an error that names the link."""
    with pytest.raises(kind) as caught:
        yield
    assert caught.value.url == link.url


def descriptors() -> frozenset[tuple[str, str]]:
    """Open descriptors of this program and what they lead to; none on a system that does not list them.

    Not their number: what was open before, of other tests or libraries, may be closed at any moment.
    """
    found = set()
    for path in _DESCRIPTORS.iterdir() if _DESCRIPTORS.is_dir() else ():
        # That of the listing is closed again.
        with contextlib.suppress(OSError):
            found.add((path.name, str(path.readlink())))
    return frozenset(found)


class LinkConformance:
    """Inherit, give `make_pair`, and say what the line cannot do."""

    detects_loss = True
    """The line notices when the other end goes."""
    back_pressure = True
    """A writer waits when the other end does not read; a line without drops."""

    @pytest.fixture(autouse=True)
    def nothing_left(self) -> Iterator[None]:
        """No descriptor and no thread is left when the test is over."""
        before, threads = descriptors(), set(threading.enumerate())
        yield
        assert descriptors() <= before, "a descriptor was left open"
        assert threads.issuperset(threading.enumerate()), "a thread was left running"

    def make_pair(self, tmp_path: Path) -> tuple[Link, Link]:
        """Two ends of one line: the link under test, and what talks to it."""
        raise NotImplementedError

    def second_owner(self, near: Link) -> Link | None:
        """Another link to what `near` owns alone, or None where a line may have many owners."""
        return None

    def open_pair(self, near: Link, far: Link) -> None:
        far.open()
        near.open()
        self.greet(near, far)

    def greet(self, near: Link, far: Link) -> None:
        near.write(b"hello", soon())
        assert self.take(far, 5) == b"hello"
        far.write(b"there", soon())
        assert self.take(near, 5) == b"there"

    def take(self, link: Link, count: int) -> bytes:
        if link.kind is LinkKind.STREAM:
            return read_bytes(link, count)
        return link.read(soon())

    @pytest.fixture
    def ends(self, nothing_left: None, tmp_path: Path) -> Iterator[tuple[Link, Link]]:
        near, far = self.make_pair(tmp_path)
        try:
            self.open_pair(near, far)
            yield near, far
        finally:
            near.close()
            far.close()

    # --- bytes ------------------------------------------------------------------------------------

    def test_every_byte_value_passes_both_ways(self, ends: tuple[Link, Link]) -> None:
        near, far = ends
        near.write(ALL_BYTES, soon())
        assert self.take(far, 256) == ALL_BYTES
        far.write(ALL_BYTES[::-1], soon())
        assert self.take(near, 256) == ALL_BYTES[::-1]

    def test_order_and_boundaries(self, ends: tuple[Link, Link]) -> None:
        near, far = ends
        messages = [bytes([n]) * (n + 1) for n in range(8)]
        for source, sink in ((near, far), (far, near)):
            for message in messages:
                source.write(message, soon())
            if sink.kind is LinkKind.STREAM:
                assert read_bytes(sink, sum(map(len, messages))) == b"".join(messages)
            else:
                assert [sink.read(soon()) for _ in messages] == messages

    def test_a_large_amount_passes_while_it_is_read(self, ends: tuple[Link, Link]) -> None:
        near, far = ends
        size = near.max_message or 300_000
        data = (ALL_BYTES * (size // 256 + 1))[:size]
        for source, sink in ((near, far), (far, near)):
            reader = Background(partial(self.take, sink, size))
            source.write(data, soon())
            assert reader.outcome() == data

    def test_writing_nothing_does_nothing(self, ends: tuple[Link, Link]) -> None:
        near, far = ends
        near.write(b"", soon())
        assert far.read(in_a_moment()) == b""
        near.write(b"x", soon())
        assert far.read(soon()) == b"x"

    def test_what_is_too_long_is_refused_whole(self, ends: tuple[Link, Link]) -> None:
        near, far = ends
        if near.max_message is None:
            assert near.kind is LinkKind.STREAM, "a datagram link says how much it carries"
        else:
            with pytest.raises(UsageError, match=str(near.max_message)):
                near.write(bytes(near.max_message + 1), soon())
            assert far.read(in_a_moment()) == b""
        near.write(b"x", soon())
        assert far.read(soon()) == b"x"

    def test_flush_input_drops_what_waits_and_counts_it(self, ends: tuple[Link, Link]) -> None:
        near, far = ends
        far.write(b"stale", soon())
        self.wait_readable(near)
        assert near.flush_input() == 5
        assert near.read(in_a_moment()) == b""
        far.write(b"fresh", soon())
        assert self.take(near, 5) == b"fresh"

    def wait_readable(self, link: Link) -> None:
        fileno = getattr(link, "fileno", None)
        if fileno is not None:
            assert select.select([fileno()], [], [], PATIENCE)[0]

    # --- time -------------------------------------------------------------------------------------

    def test_a_read_does_not_end_before_its_deadline(self, ends: tuple[Link, Link]) -> None:
        near, _ = ends
        for wait in (0.0, 0.0004, 0.0031, 0.05):
            deadline = time.monotonic() + wait
            assert near.read(deadline) == b""
            assert time.monotonic() >= deadline

    def test_a_read_past_its_deadline_takes_what_is_there(self, ends: tuple[Link, Link]) -> None:
        near, far = ends
        assert near.read(0.0) == b""
        far.write(b"x", soon())
        self.wait_readable(near)
        assert near.read(0.0) == b"x"

    def test_a_read_without_deadline_waits(self, ends: tuple[Link, Link]) -> None:
        near, far = ends
        reader = Background(lambda: near.read(None))
        reader.let_it_block()
        far.write(b"x", soon())
        assert reader.outcome() == b"x"

    def test_a_very_late_deadline_is_no_overflow(self, ends: tuple[Link, Link]) -> None:
        near, far = ends
        far.write(b"x", soon())
        assert near.read(float("inf")) == b"x"
        near.write(b"y", float("inf"))
        assert far.read(time.monotonic() + 1e12) == b"y"

    def test_an_exchange_sends_a_request_and_takes_the_answer(self, ends: tuple[Link, Link]) -> None:
        near, far = ends
        answerer = Background(lambda: far.write(self.take(far, 7)[::-1], soon()))
        data = near.exchange(b"request", PATIENCE)
        answerer.outcome()
        while len(data) < 7:
            data += near.read(soon())
        assert data == b"tseuqer"
        start = time.monotonic()
        assert near.exchange(b"request", 0.05) == b""
        assert time.monotonic() >= start + 0.05
        assert self.take(far, 7) == b"request"

    # --- waking and closing -----------------------------------------------------------------------

    def test_wake_ends_a_waiting_read(self, ends: tuple[Link, Link]) -> None:
        near, far = ends
        reader = Background(lambda: near.read(None))
        reader.let_it_block()
        near.wake()
        assert reader.outcome() == b""
        far.write(b"x", soon())
        assert near.read(soon()) == b"x"

    def test_wake_before_a_read_is_not_lost(self, ends: tuple[Link, Link]) -> None:
        near, _ = ends
        near.wake()
        assert near.read(None) == b""
        assert near.read(in_a_moment()) == b""

    def test_wake_loses_no_bytes(self, ends: tuple[Link, Link]) -> None:
        near, far = ends
        far.write(b"x", soon())
        self.wait_readable(near)
        near.wake()
        assert near.read(soon()) or near.read(soon()) == b"x"

    def test_closing_ends_a_waiting_read(self, ends: tuple[Link, Link]) -> None:
        near, _ = ends
        reader = Background(lambda: near.read(None))
        reader.let_it_block()
        near.close()
        with pytest.raises(LinkClosedError):
            reader.outcome()
        assert not near.is_open

    def test_closing_ends_a_waiting_write(self, ends: tuple[Link, Link]) -> None:
        near, _ = ends
        if not self.back_pressure:
            return
        size = near.max_message or 100_000

        def write_for_ever() -> None:
            while True:
                near.write(bytes(size), None)

        writer = Background(write_for_ever)
        writer.let_it_block()
        near.close()
        with pytest.raises(LinkClosedError):
            writer.outcome()

    def test_a_link_that_is_not_open_says_so(self, tmp_path: Path) -> None:
        near, _ = self.make_pair(tmp_path)
        assert not near.is_open
        near.close()
        near.wake()
        for use in (lambda: near.read(0.0), lambda: near.write(b"x", 0.0), near.flush_input):
            with pytest.raises(LinkClosedError):
                use()

    def test_a_closed_link_says_so_and_opens_again(self, ends: tuple[Link, Link]) -> None:
        near, far = ends
        near.close()
        near.close()
        assert not near.is_open
        with refused(LinkClosedError, near):
            near.read(soon())
        with refused(LinkClosedError, near):
            near.write(b"x", soon())
        far.close()
        self.open_pair(near, far)
        assert near.is_open

    def test_it_opens_and_closes_many_times(self, tmp_path: Path) -> None:
        near, far = self.make_pair(tmp_path)
        for _ in range(20):
            try:
                self.open_pair(near, far)
            finally:
                near.close()
                far.close()

    def test_it_is_a_context_manager(self, tmp_path: Path) -> None:
        near, far = self.make_pair(tmp_path)
        with far, near:
            assert near.is_open
            assert near.url in repr(near)
        assert not near.is_open

    # --- the other end ----------------------------------------------------------------------------

    def test_the_other_end_goes_while_a_read_waits(self, ends: tuple[Link, Link]) -> None:
        near, far = ends
        reader = Background(lambda: near.read(soon() if self.detects_loss else None))
        reader.let_it_block()
        far.close()
        if not self.detects_loss:
            reader.let_it_block()
            near.wake()
            assert reader.outcome() == b""
            return
        with pytest.raises(LinkLostError):
            reader.outcome()
        assert not near.is_open
        with refused(LinkLostError, near):
            near.read(soon())
        with refused(LinkLostError, near):
            near.write(b"x", soon())

    def test_the_other_end_goes_while_nobody_looks(self, ends: tuple[Link, Link]) -> None:
        near, far = ends
        far.close()
        if self.detects_loss:
            with refused(LinkLostError, near):
                near.read(soon())
        else:
            assert near.read(in_a_moment()) == b""
            assert near.is_open

    def test_the_other_end_comes_back(self, ends: tuple[Link, Link]) -> None:
        near, far = ends
        far.close()
        if self.detects_loss:
            with pytest.raises(LinkLostError):
                near.read(soon())
            self.open_pair(near, far)
        else:
            far.open()
            with contextlib.suppress(LinkError):
                near.read(in_a_moment())
            self.greet(near, far)

    def test_a_writer_waits_for_a_reader(self, ends: tuple[Link, Link]) -> None:
        near, far = ends
        piece = ALL_BYTES * 8 if near.max_message is None else ALL_BYTES[: near.max_message]
        taken = 0
        if not self.back_pressure:
            for _ in range(2000):
                near.write(piece, soon())
            return
        error = None
        while error is None:
            try:
                near.write(piece, in_a_moment())
                taken += len(piece)
            except LinkTimeoutError as caught:
                error = caught
            assert taken < 100_000_000, "the line takes bytes without end"
        assert isinstance(error, TimeoutError)
        assert error.url == near.url
        assert near.is_open
        assert taken > 0
        if near.kind is LinkKind.STREAM:
            # A part of the last piece may have gone as well.
            data = read_bytes(far, taken)
            data += far.read(in_a_moment())
            assert data == (piece * (len(data) // len(piece) + 1))[: len(data)]
        else:
            for _ in range(taken // len(piece)):
                assert far.read(soon()) == piece
        far.flush_input()
        near.write(b"again", soon())
        # What the line had taken of the last piece goes out before it.
        data = far.read(soon())
        while near.kind is LinkKind.STREAM and not data.endswith(b"again"):
            data += far.read(soon())
            assert len(data) < 100_000
        assert data.endswith(b"again")

    # --- owners -----------------------------------------------------------------------------------

    def test_one_object_opens_once(self, ends: tuple[Link, Link]) -> None:
        near, far = ends
        with refused(LinkBusyError, near):
            near.open()
        self.greet(near, far)

    def test_two_owners_are_refused(self, ends: tuple[Link, Link]) -> None:
        near, far = ends
        second = self.second_owner(near)
        if second is None:
            return
        with refused(LinkBusyError, second):
            second.open()
        assert not second.is_open
        self.greet(near, far)

    def test_writes_of_two_threads_do_not_mix(self, ends: tuple[Link, Link]) -> None:
        near, far = ends
        rounds, size = 50, 64

        def write(mark: int) -> None:
            for _ in range(rounds):
                near.write(bytes([mark]) * size, soon())

        writers = [Background(partial(write, mark)) for mark in (1, 2, 3)]
        if far.kind is LinkKind.STREAM:
            data = read_bytes(far, 3 * rounds * size)
            whole = [data[at : at + size] for at in range(0, len(data), size)]
        else:
            whole = [far.read(soon()) for _ in range(3 * rounds)]
        for writer in writers:
            writer.outcome()
        assert all(len(set(message)) == 1 and len(message) == size for message in whole)
        assert sorted(message[0] for message in whole) == [1] * rounds + [2] * rounds + [3] * rounds
