"""The settings of an arm take effect in its motion and at its start and end, in simulated time."""

from __future__ import annotations

from typing import Any

import pytest
from tests.control.arm_bench import SUCCEEDED, make_bench, order
from tests.drivers.arms import Arm as EmulatedArm
from tests.motion.arms import HOME

from hexwire.control.requests.controlled_arm import ControlledArm
from hexwire.control.requests.setting import Faults
from hexwire.control.requests.settings_reader import read_settings
from hexwire.errors import LinkLostError, UsageError
from hexwire.model.state import JointTarget

J1 = HOME["J1"]


@pytest.mark.slow
@pytest.mark.parametrize("timeout", [0.5, 2.0, 0.0])
def test_joints_hold_when_no_set_point_has_arrived_for_the_command_timeout(timeout: float) -> None:
    bench = make_bench(command_timeout=timeout)
    for _ in range(5):
        bench.arm.set_points({"J1": J1 + 1.0, "J4": 0.1})
        bench.turn(0.05)
    words = []
    for _ in range(8):
        words.append(bench.arm.facts().controllers[""])
        bench.turn(0.4)
    following = words.index("hold") if "hold" in words else len(words)
    assert set(words[:following]) == {"stream"}
    assert following == {0.5: 2, 2.0: 5, 0.0: 8}[timeout]
    assert bench.arm.facts().counters["set_points_lost"] == (timeout > 0.0)


def test_targets_are_sent_at_the_command_rate_and_the_watchdog_is_that_of_the_settings() -> None:
    bench = make_bench(command_rate=5.0, watchdog=2.5, host_timed=True)
    durations = []
    write = bench.owner.robot.write

    def noted(target: JointTarget) -> Any:
        durations.append(target.duration)
        return write(target)

    bench.owner.robot.write = noted  # type: ignore[method-assign]  # it watches
    told = bench.command(order((3.0, {"J1": J1 + 0.3})))
    bench.turn(0.1)
    assert bench.board.state.watchdog_timeout == bench.arm.facts().watchdog == 2.5
    bench.until(lambda: told.ends)
    assert told.outcome == SUCCEEDED
    assert {round(duration, 6) for duration in durations} == {0.3}
    assert len(durations) == pytest.approx(16, abs=1)


@pytest.mark.slow
def test_a_pose_is_approached_at_the_pose_speed() -> None:
    seconds = []
    for speed in (0.1, 0.4):
        bench = make_bench(pose_speed=speed)
        begin = bench.clock.time
        assert bench.ask(lambda: bench.arm.go_to("side")) == "at side"  # noqa: B023  # called in this round
        seconds.append(bench.clock.time - begin)
    assert seconds[0] > 2.0 * seconds[1]


@pytest.mark.parametrize("off", [False, True])
def test_torque_is_switched_off_at_the_end_only_if_that_is_set(off: bool) -> None:
    bench = make_bench(torque_off_at_exit=off)
    bench.arm.shutdown()
    assert bench.torques() == [not off] * 7


@pytest.mark.parametrize("timeout", [0.0, 3.0])
def test_a_robot_that_does_not_answer_is_waited_for_as_long_as_is_set(timeout: float) -> None:
    emulated = EmulatedArm(2, attach=False)
    emulated.link.lost = True
    settings, _ = read_settings({"port": "/dev/null", "connect_timeout": timeout}, Faults())
    arm = ControlledArm(emulated.driver, settings, clock=emulated.clock, sleep=emulated.clock.sleep)
    begin = emulated.clock.time
    with pytest.raises(LinkLostError):
        arm.connect()
    assert emulated.clock.time - begin == pytest.approx(timeout, abs=0.5)
    arm.shutdown()


@pytest.mark.slow
def test_a_pose_that_a_joint_does_not_reach_is_given_up_with_its_name() -> None:
    bench = make_bench(poses={"near": {"J1": J1 + 0.1}}, constraints={"J1": {"goal": 0.02}})
    bench.jam("J1")
    begin = bench.clock.time
    with pytest.raises(UsageError, match=r"^J1 is .* off its goal, tolerance 0\.02 rad"):
        bench.ask(lambda: bench.arm.go_to("near"))
    assert 10.0 < bench.clock.time - begin < 15.0
