"""The life cycle of an emulated arm, in simulated time."""

from __future__ import annotations

import pytest
from tests.control.arm_bench import Bench

from hexwire.errors import UsageError
from hexwire.ros2.arm_lifecycle import carry_out, state_of
from zenoh_ros2.lifecycle import Change, State


@pytest.fixture
def bench() -> Bench:
    return Bench(check_table=False)


def test_an_arm_is_unconfigured_inactive_or_active(bench: Bench) -> None:
    assert state_of(bench.arm) is State.INACTIVE
    bench.ask(lambda: carry_out(bench.arm, Change.ACTIVATE))
    assert state_of(bench.arm) is State.ACTIVE
    bench.owner.connected = False
    assert state_of(bench.arm) is State.UNCONFIGURED


def test_deactivate_stops_and_keeps_the_torque_and_activate_clears_no_stop_of_others(bench: Bench) -> None:
    bench.ask(lambda: carry_out(bench.arm, Change.ACTIVATE))
    carry_out(bench.arm, Change.DEACTIVATE)
    bench.turn(0.5)
    assert state_of(bench.arm) is State.INACTIVE
    assert all(bench.torques())
    bench.ask(lambda: carry_out(bench.arm, Change.ACTIVATE))
    assert state_of(bench.arm) is State.ACTIVE
    carry_out(bench.arm, Change.DEACTIVATE)
    bench.arm.stop("somebody")
    with pytest.raises(UsageError, match="reset it first"):
        bench.ask(lambda: carry_out(bench.arm, Change.ACTIVATE))
    assert state_of(bench.arm) is State.INACTIVE


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (Change.CONFIGURE, "connects by itself"),
        (Change.CLEANUP, "keeps its connection"),
        (Change.UNCONFIGURED_SHUTDOWN, "end the node"),
        (Change.INACTIVE_SHUTDOWN, "end the node"),
        (Change.ACTIVE_SHUTDOWN, "torque_off_at_exit"),
    ],
)
def test_what_could_let_the_arm_fall_or_lose_it_is_refused(bench: Bench, change: Change, why: str) -> None:
    bench.ask(lambda: carry_out(bench.arm, Change.ACTIVATE))
    with pytest.raises(UsageError, match=why):
        carry_out(bench.arm, change)
    bench.turn(0.5)
    assert state_of(bench.arm) is State.ACTIVE
    assert all(bench.torques())
