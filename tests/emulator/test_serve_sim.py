"""`sim://hex7bot`: an emulated arm inside the program."""

from __future__ import annotations

import threading
import time

import pytest

from hexwire.drivers.registry import connect
from hexwire.emulator.serve_sim import SimLink
from hexwire.errors import LinkBusyError, LinkClosedError, UsageError
from hexwire.link.open import make_link
from hexwire.model.state import JointTarget

PATIENCE = 10.0


class Echo:
    """A device that sends back what it receives, and something of its own at a time."""

    def __init__(self, due: float | None = None) -> None:
        self.due, self.out = due, b""
        self.seen: list[str] = []

    def receive(self, data: bytes, now: float) -> None:
        self.seen.append("receive")
        self.out += data

    def step(self, now: float) -> None:
        self.seen.append("step")
        if self.due is not None and now >= self.due:
            self.due, self.out = None, self.out + b"due"

    def data_to_send(self) -> bytes:
        out, self.out = self.out, b""
        return out

    def next_event_time(self) -> float | None:
        return self.due

    def reset(self, now: float) -> None:
        raise NotImplementedError


def test_it_answers_and_sends_by_itself_when_something_is_due() -> None:
    device = Echo()
    with SimLink("sim://hex7bot", device) as link:
        link.write(b"hello")
        assert link.read(time.monotonic() + PATIENCE) == b"hello"
        assert link.read(time.monotonic()) == b""
        device.due = time.monotonic() + 0.02
        assert link.read(time.monotonic() + PATIENCE) == b"due"


def test_what_was_due_before_a_write_is_done_before_it() -> None:
    # Otherwise the write would feed a watchdog that has expired.
    device = Echo()
    with SimLink("sim://hex7bot", device) as link:
        device.seen.clear()
        link.write(b"x")
        assert device.seen == ["step", "receive"]


def test_it_opens_once_and_forgets_what_was_sent_while_it_was_closed() -> None:
    link = SimLink("sim://hex7bot", Echo())
    with pytest.raises(LinkClosedError, match="closed"):
        link.read(0.0)
    link.open()
    with pytest.raises(LinkBusyError):
        link.open()
    link.write(b"old")
    link.close()
    with pytest.raises(LinkClosedError):
        link.write(b"x")
    with link:
        assert link.read(time.monotonic()) == b""
        link.write(b"new")
        assert link.flush_input() == 3


@pytest.mark.parametrize("end", ["wake", "close"])
def test_another_thread_ends_a_wait(end: str) -> None:
    link = SimLink("sim://hex7bot", Echo())
    link.open()
    result: list[object] = []

    def wait() -> None:
        try:
            result.append(link.read(None))
        except LinkClosedError as error:
            result.append(error)

    thread = threading.Thread(target=wait)
    thread.start()
    getattr(link, end)()
    thread.join(PATIENCE)
    assert not thread.is_alive()
    assert isinstance(result[0], LinkClosedError) if end == "close" else result == [b""]


@pytest.mark.parametrize(
    "url", ["sim://puma260", "sim://", "sim://hex7bot/x", "sim://hex7bot?speed=2", "sim://hex7bot?dialect=3"]
)
def test_what_is_not_emulated_is_refused(url: str) -> None:
    with pytest.raises(UsageError):
        make_link(url)


def test_a_driver_moves_it_and_finds_it_where_it_left_it() -> None:
    with connect("sim://hex7bot") as robot:
        robot.torque(True)
        robot.write(JointTarget.of({"J1": 0.5}, 0.1))
        deadline = time.monotonic() + PATIENCE
        while abs(robot.read().positions["J1"] - 0.5) > 0.02:
            assert time.monotonic() < deadline
        robot.detach()
        robot.attach()
        assert robot.read().positions["J1"] == pytest.approx(0.5, abs=0.02)
