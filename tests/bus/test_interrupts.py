"""Ctrl-C at any line of a transaction: what was asked may be answered later, and passes for no other answer."""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import FrameType
from typing import Any

import pytest

from hexwire.bus.servo_bus import ServoBus
from hexwire.link.base import Link, LinkKind
from hexwire.wire import servo_packet as packets

_FIRST_WINDOW = 0.061
_IDS = (1, 2)


class LateLine(Link):
    """Servos that answer after the first window, in fake time; from `deaf` on they receive nothing more."""

    kind = LinkKind.STREAM
    url = "memory://late"
    baud = 1_000_000
    is_open = True

    def __init__(self) -> None:
        self.time, self.deaf = 1000.0, False
        self._coming: list[tuple[float, bytes]] = []

    def clock(self) -> float:
        return self.time

    def open(self) -> None: ...
    def close(self) -> None: ...
    def wake(self) -> None: ...

    def flush_input(self) -> int:
        return 0

    def write(self, data: bytes, deadline: float | None = None) -> None:
        packet = packets.parse_packet(data)
        if self.deaf:
            return
        params = packet.params
        if packet.instruction == packets.Instruction.SYNC_READ:
            answer = b"".join(packets.make_status(i, 0, bytes([7] * params[1])) for i in params[2:])
        elif packet.instruction == packets.Instruction.READ:
            answer = packets.make_status(packet.servo_id, 0, bytes([7] * params[1]))
        else:
            answer = packets.make_status(packet.servo_id, 0)
        self._coming.append((self.time + _FIRST_WINDOW + 0.01, answer))

    def read(self, deadline: float | None) -> bytes:
        assert deadline is not None
        if self._coming and self._coming[0][0] <= max(deadline, self.time):
            at, data = self._coming.pop(0)
            self.time = max(self.time, at)
            return data
        self.time = max(self.time, deadline)
        return b""


def _interrupted_at(step: int, call: Callable[[], object]) -> str:
    """Call something and raise KeyboardInterrupt before that many lines of `hexwire.bus`; where, or nothing."""
    steps, place = [step], [""]

    def trace(frame: FrameType, event: str, _: Any) -> Any:
        if "/hexwire/bus/" not in frame.f_code.co_filename:
            return None
        if event == "line":
            steps[0] -= 1
            if not steps[0]:
                place[0] = f"{frame.f_code.co_filename}:{frame.f_lineno}"
                raise KeyboardInterrupt
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        call()
    except KeyboardInterrupt:
        pass
    finally:
        sys.settrace(before)
    return place[0]


_READS: dict[str, Callable[[ServoBus], object]] = {
    "read": lambda bus: bus.read(1, "present_position"),
    "sync_read": lambda bus: bus.sync_read("present_position", _IDS),
    "sync_read_blocks": lambda bus: bus.sync_read_blocks(56, 2, _IDS),
    "read_block": lambda bus: bus.read_block(1, 56, 2),
    "ask": lambda bus: bus.ask(packets.make_read(1, 56, 2), 1, 2),
}
_ORDERS: dict[str, Callable[[ServoBus], object]] = {
    "ping": lambda bus: bus.ping(1),
    "write": lambda bus: bus.write_raw(1, "acceleration", 7),
    "action": lambda bus: bus.action(1),
}


def _answered(call: Callable[[ServoBus], object], ask: Callable[[ServoBus], bool]) -> list[str]:
    """Where Ctrl-C in a call lets its late answer pass for the answer to a later request, which was lost."""
    wrong = []
    for step in range(1, 5000):
        line = LateLine()
        bus = ServoBus(line, retries=0)
        bus.open()
        place = _interrupted_at(step, lambda bus=bus: call(bus))  # type: ignore[misc]  # bound in this turn
        line.deaf = True
        if ask(bus):
            wrong.append(place)
        if not place:
            return wrong
    raise AssertionError("the call never ends")


@pytest.mark.parametrize("name", _READS)
def test_ctrl_c_at_any_line_of_a_read_leaves_no_answer_for_another(name: str) -> None:
    assert _answered(_READS[name], lambda bus: bus.read(1, "present_load").raw is not None) == []


@pytest.mark.parametrize("name", _ORDERS)
def test_ctrl_c_at_any_line_of_an_order_leaves_no_acknowledgement_for_another(name: str) -> None:
    assert _answered(_ORDERS[name], lambda bus: bus.write_raw(1, "torque_limit", 321).confirmed) == []
