"""However a path that the board follows ends, a program and the controllers of a node are told the same."""

from __future__ import annotations

import re
from collections.abc import Callable

import pytest
from tests.control.arm_bench import order
from tests.control.test_onboard_execution import Timed as Node
from tests.control.test_timed_motion import Timed as Program
from tests.drivers.arms import Arm

JOINT = 3
"""J4, which the motions of both turn."""


def silent(arm: Arm) -> None:
    """Its servo does not answer any more."""
    answer = arm.board.faults.bus_answer

    def bus_answer(who: int, said: bytes | None) -> tuple[bytes, float]:
        return answer(who, None if who == JOINT else said)

    arm.board.faults.bus_answer = bus_answer  # type: ignore[method-assign,assignment]  # a fault that begins in mid-run


def another_path(arm: Arm) -> None:
    board = arm.board.trajectory
    board.number = (board.number + 1) & 0xFF


ENDS: dict[str, tuple[Callable[[Arm], object], str]] = {
    "a stop from elsewhere that is over": (lambda arm: arm.board.trajectory.stop(), "stop command"),
    "the watchdog": (lambda arm: arm.wait(1.6), "watchdog tripped"),
    "another program's path": (another_path, "another program began another path"),
    "a reset": (lambda arm: arm.board.reset(arm.clock.time), "the board was reset"),
    "a silent joint": (silent, "J4 has not answered for"),
}


def by_program(end: Callable[[Arm], object]) -> tuple[Arm, str]:
    bench = Program()
    result = bench.run(bench.way(seconds=4.0), bench.after(0.7, lambda: end(bench.arm)))
    assert (result.arrived, result.timed) == (False, True)
    return bench.arm, result.why


def by_node(end: Callable[[Arm], object]) -> tuple[Arm, str]:
    bench = Node()
    here = bench.owner.newest().positions
    told = bench.command(order((4.0, {"J4": here["J4"] + 0.5}), still=True))
    bench.turn(0.7)
    end(bench.emulated)
    bench.until(lambda: told.ends)
    return bench.emulated, told.text


@pytest.mark.parametrize("how", ENDS)
def test_a_program_and_a_node_are_told_the_same_and_nothing_goes_on(how: str) -> None:
    end, says = ENDS[how]
    words = []
    for front in (by_program, by_node):
        arm, said = front(end)
        assert says in said
        words.append(re.sub(r"\d+\.\d+", "N", said))
        place = arm.shaft(JOINT)
        arm.wait(3.0)
        # The other path is the same one under another number here.
        assert arm.shaft(JOINT) == pytest.approx(place, abs=2) or end is another_path
    # Who owns a port sees by itself that the board was reset.
    assert words[0] == words[1] or how == "a reset"
