"""A shared arm: no target without a live lease, and a stop gets through whatever hangs. In simulated time."""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from tests.control.arm_bench import Service, order
from tests.control.shared_bench import SharedBench
from tests.motion.arms import HOME

from hexwire.control.sharing import shared as module
from hexwire.control.sharing.lease import Lease
from hexwire.drivers.values import StopMode
from hexwire.errors import HexwireError, LeaseError, LimitError, LinkLostError, StoppedError, UsageError
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.state import JointTarget
from hexwire.wire.command_frame import Command
from hexwire.wire.commands import MoveRequest, MoveRow

AWAY = 0.4
STILL = 0.004
"""Radians: two counts and a bit."""
FAR = 0.03
"""Radians that a joint on its way covers in a second, at least."""


def test_an_order_of_the_holder_moves_the_arm_and_nobody_elses_does() -> None:
    bench = SharedBench()
    with pytest.raises(LeaseError, match="holds no lease"):
        bench.move(12345, J1=AWAY)
    key = bench.take()
    assert bench.shared.holder is not None
    assert bench.shared.holder.watchdog == 0.0
    with pytest.raises(LeaseError, match="Ann holds the lease"):
        bench.move(key + 1, J1=AWAY)
    assert not bench.sent
    bench.move(key, J1=AWAY)
    bench.keep(key, 1.0)
    assert bench.travel("J1", 0.3) > 0.005
    assert bench.shared.refusals()["lease_without_lease"] == 2


def test_set_points_that_are_too_old_or_out_of_order_do_not_reach_the_robot() -> None:
    bench = SharedBench()
    key = bench.take()
    target = JointTarget.of({"J1": bench.where("J1")}, 0.1)
    early = bench.order(key, age=0.0)
    with pytest.raises(LeaseError, match="300 ms old"):
        bench.shared.write(bench.order(key, age=0.3), target)
    with pytest.raises(LeaseError, match="came after"):
        bench.shared.write(early, target)
    with pytest.raises(LeaseError, match="not known"):
        bench.shared.write(bench.order(key, age=100.0, doubt=100.0), target)
    assert not bench.sent


def test_waiting_for_another_target_makes_a_set_point_older() -> None:
    bench = SharedBench()
    key = bench.take()
    waiting = bench.order(key, age=0.0)
    with bench.owner.deciding():
        service = Service(lambda: bench.shared.write(waiting, JointTarget.of({"J1": HOME["J1"]}, 0.1)))
        bench.clock.time += 0.3
    with pytest.raises(LeaseError, match="300 ms old"):
        service.answer()
    assert not bench.sent


@pytest.mark.parametrize(("slower", "seconds"), [(1.0, 0.05), (50.0, 0.05), (0.02, 1.0)])
def test_the_path_of_a_target_that_takes_long_is_checked_whether_or_not_it_is_meant_to(
    slower: float, seconds: float
) -> None:
    """It takes as long as the slowest joint needs, or as it is meant to."""
    bench = SharedBench(check_table=True)
    joints = tuple(replace(joint, max_speed=joint.max_speed / slower) for joint in HEX7BOT.joints)
    bench.robot.model = replace(HEX7BOT, joints=joints)
    key = bench.take()
    start, state = HOME | {"J2": 0.6, "J3": 1.3, "J5": -1.4}, bench.owner.newest()
    there = replace(state, position=tuple(start[name] for name in state.names))
    bench.owner.newest = lambda: there  # type: ignore[method-assign]
    through = JointTarget.of({"J5": 1.4}, seconds)
    with pytest.raises(LimitError, match="% of the path"):
        bench.shared.write(bench.order(key, age=0.0), through)
    assert not bench.sent


# -- the end of a lease -------------------------------------------------------------------------------------


@pytest.mark.parametrize("by", ["the owner's turn", "the supervision"])
def test_a_lost_lease_holds_the_arm_and_says_why_until_somebody_takes_it(by: str) -> None:
    bench = SharedBench()
    key = bench.take()
    bench.move(key, J1=AWAY)
    bench.keep(key, 1.0)
    bench.turn(0.4)
    if by == "the supervision":
        bench.clock.time += 0.2
        assert bench.shared.check() == 0.5
    else:
        bench.turn(0.2)
    bench.turn(0.3)
    assert bench.travel("J1", 1.0) < STILL
    assert abs(bench.where("J1") - HOME["J1"]) < AWAY - 0.1
    assert bench.shared.held == "Ann lost the lease after 0.5 s of silence"
    assert bench.shared.holder is None
    assert bench.owner.group.reason is None, "a hold is no stop"
    with pytest.raises(LeaseError, match="Ann lost the lease"):
        bench.move(key, J1=AWAY)
    again = bench.take("Bob")
    assert bench.shared.held == ""
    assert bench.travel("J1", 0.3) < STILL
    bench.move(again, J1=0.1, seconds=1.0)
    assert bench.shared.refusals()["lease_lost"] == 1


def test_only_joints_that_were_moving_hold() -> None:
    bench = SharedBench()
    key = bench.take()
    bench.move(key, J1=AWAY, J2=0.2)
    bench.keep(key, 0.3)
    # A short target of one of them does not end the motion of the other.
    bench.move(key, J1=0.01, seconds=0.1)
    del bench.sent[:]
    bench.turn(0.7)
    (held,) = bench.sent
    assert [name for name, _ in held.positions] == ["J2"], "J1 has arrived"
    assert bench.travel("J2", 2.0) < STILL


def test_joints_without_torque_do_not_hold() -> None:
    bench = SharedBench()
    key = bench.take()
    bench.move(key, J1=AWAY, J2=0.2)
    bench.keep(key, 0.3)
    bench.ask(lambda: bench.shared.torque(bench.order(key), False, ["J2"]))
    del bench.sent[:]
    bench.turn(0.7)
    (held,) = bench.sent
    assert [name for name, _ in held.positions] == ["J1"]


def special(bench: SharedBench, key: int, **by: float) -> None:
    """Move joints over 10 s by a command that only the board understands."""
    rows = []
    for name, way in by.items():
        model = HEX7BOT.joint(name)
        rows.append(MoveRow(model.servo_id, model.angle_to_counts(bench.where(name) + way)))
    body = MoveRequest(10_000, tuple(rows)).serialize()
    bench.ask(lambda: bench.shared.ioctl(bench.order(key), Command.JOINT_MOVE, body))


@pytest.mark.parametrize("end", ["lost", "taken", "given back"])
def test_the_motion_of_a_special_command_ends_with_the_lease(end: str) -> None:
    bench = SharedBench()
    key = bench.take(rank=2)
    special(bench, key, J1=AWAY, J3=0.1)
    bench.keep(key, 0.5)
    assert bench.travel("J1", 0.3) > 0.005
    if end == "taken":
        bench.take("Bob", rank=2, force=True)
    elif end == "given back":
        bench.shared.leave(key, finish=False)
    bench.turn(0.5)
    (held,) = bench.sent
    assert {name for name, _ in held.positions} == set(bench.robot.model.names)
    assert bench.travel("J1", 1.0) < STILL
    assert bench.travel("J3", 1.0) < STILL
    assert not bench.board.state.stopped, "a hold is no stop"


def test_an_arm_that_cannot_hold_after_a_special_command_is_stopped() -> None:
    bench = SharedBench()
    key = bench.take(rank=2)
    special(bench, key, J1=AWAY)
    bench.keep(key, 0.5)
    bench.bench.silence("J2")
    bench.turn(1.5)
    assert bench.board.state.stopped
    assert bench.travel("J1", 1.0) < STILL


def test_the_end_of_the_server_stops_the_motion_of_a_special_command() -> None:
    bench = SharedBench()
    key = bench.take(rank=2)
    special(bench, key, J1=AWAY)
    bench.keep(key, 0.5)
    bench.shared.shutdown()
    assert bench.board.state.stopped


def test_after_a_special_command_that_moves_nothing_no_joint_gets_a_target() -> None:
    bench = SharedBench()
    key = bench.take(rank=2)
    for command, body in ((Command.STATS, b""), (Command.IO, b"\1\1"), (Command.LIMITS, b"")):
        bench.ask(lambda command=command, body=body: bench.shared.ioctl(bench.order(key), command, body))
    bench.turn(1.0)
    assert bench.shared.held
    assert not bench.sent


@pytest.mark.parametrize("by", ["a hold", "targets", "a stop"])
def test_what_ends_the_motion_of_a_special_command_ends_it_for_good(by: str) -> None:
    bench = SharedBench()
    key = bench.take(rank=2)
    special(bench, key, J1=AWAY)
    if by == "a hold":
        bench.turn(1.0)
        key = bench.take(rank=2)
    elif by == "targets":
        bench.move(key, seconds=0.1, **dict.fromkeys(bench.robot.model.names, 0.0))
    else:
        bench.shared.stop("a test")
        bench.ask(lambda: bench.shared.resume(bench.order(key)))
    bench.keep(key, 1.0)
    del bench.sent[:]
    bench.turn(1.0)
    assert bench.shared.held
    assert not bench.sent


def test_the_lease_is_free_after_its_holder_leaves_a_special_command_running() -> None:
    bench = SharedBench()
    key = bench.take(rank=2)
    special(bench, key, J1=AWAY)
    bench.shared.leave(key, finish=True)
    bench.turn(0.5)
    assert not bench.sent
    assert bench.shared.holder is None
    # Whoever has it next answers for it.
    key = bench.take("Bob")
    bench.turn(0.6)
    assert bench.sent


def test_an_arm_at_rest_gets_no_target_when_the_lease_ends() -> None:
    bench = SharedBench()
    key = bench.take()
    bench.move(key, J1=0.01, seconds=0.1)
    bench.keep(key, 1.0)
    del bench.sent[:]
    bench.turn(1.0)
    assert bench.shared.held
    assert not bench.sent


def test_the_lease_is_checked_again_right_before_the_bytes_leave() -> None:
    bench = SharedBench()
    key = bench.take()
    write = bench._write

    def late(target: JointTarget) -> Any:
        # The line was busy, or this program was halted.
        bench.clock.time += 0.6
        return write(target)

    bench._write = late  # type: ignore[method-assign]
    with pytest.raises(LeaseError, match="was lost after"):
        bench.move(key, J1=AWAY)
    assert not bench.sent
    assert bench.travel("J1") < STILL


@pytest.mark.parametrize("dialect", [2, 1])
def test_a_set_point_that_waited_for_the_line_is_refused_and_counted(dialect: int) -> None:
    bench = SharedBench(dialect=dialect)
    key, session = bench.take(), bench.robot.session
    order = bench.order(key, age=0.1)
    # Something else has the line, such as a probe of an arm with silent servos.
    session._turn.begin(None)
    service = Service(lambda: bench.shared.write(order, JointTarget.of({"J1": HOME["J1"] + 0.1}, 1.0)))
    while not bench.shared.rules.holder.sequence:  # type: ignore[union-attr]
        service.thread.join(0.001)
    service.thread.join(0.05)
    bench.clock.time += 0.3
    session._turn.end()
    with pytest.raises(LeaseError, match="400 ms old"):
        service.answer()
    assert bench.shared.refusals()["lease_too_old"] == 1
    assert bench.shared.holder is not None, "only this order was refused"
    bench.shared.beat(key, 0.0)
    assert bench.travel("J1", 0.3) < STILL
    bench.move(key, J1=AWAY)


def test_after_a_halt_of_the_program_nothing_that_waited_is_done_or_revives_the_lease() -> None:
    bench = SharedBench()
    key = bench.take()
    bench.move(key, J1=AWAY)
    bench.keep(key, 0.5)
    waiting = bench.order(key, age=0.0)
    del bench.sent[:]
    bench.clock.time += 3.0
    with pytest.raises(LeaseError):
        bench.shared.beat(key, 0.0)
    with pytest.raises(LeaseError):
        bench.shared.write(waiting, JointTarget.of({"J1": HOME["J1"]}, 1.0))
    assert not bench.sent
    bench.turn(0.3)
    assert [name for name, _ in bench.sent[0].positions] == ["J1"]
    assert len(bench.sent) == 1, "the hold"
    assert bench.shared.held


def test_a_target_after_a_trajectory_is_not_taken_for_an_error_of_its_joint() -> None:
    bench = SharedBench(lease=Lease(timeout=100.0))
    key = bench.take()
    bench.shared.follow(bench.order(key), "", order((0.5, {"J1": HOME["J1"] + 0.1})), None)
    bench.turn(1.5)
    bench.ask(lambda: bench.move(key, 1.0, J1=0.6))
    bench.turn(2.0)
    assert bench.owner.group.reason is None
    assert bench.where("J1") == pytest.approx(HOME["J1"] + 0.7, abs=0.02)


def test_after_a_halt_the_owner_sends_nothing_more_of_a_trajectory() -> None:
    bench = SharedBench(host_timed=True)
    key = bench.take()
    way = order((5.0, {"J1": HOME["J1"] + AWAY}))
    bench.shared.follow(bench.order(key), "", way, None)
    bench.keep(key, 1.0)
    assert len(bench.sent) > 10
    del bench.sent[:]
    here = bench.where("J1")
    bench.clock.time += 3.0
    bench.turn(1.0)
    assert len(bench.sent) <= 1, "the hold"
    assert abs(bench.where("J1") - here) < 0.03
    assert not bench.owner.group.busy


def test_a_trajectory_whose_lease_is_lost_during_its_check_does_not_begin() -> None:
    bench = SharedBench()
    key = bench.take()
    controller = bench.bench.controller
    check = controller.check_path

    def slow(*args: Any, **options: Any) -> None:
        check(*args, **options)
        bench.clock.time += 1.0

    controller.check_path = slow  # type: ignore[method-assign]
    with pytest.raises(LeaseError, match="the lease was lost"):
        bench.shared.follow(bench.order(key), "", order((5.0, {"J1": HOME["J1"] + AWAY})), None)
    assert not bench.owner.group.busy
    bench.turn(1.0)
    assert not bench.sent


def test_an_order_that_waits_for_the_owner_is_void_when_the_lease_is_taken() -> None:
    bench = SharedBench(on=False)
    key = bench.take()
    service = bench.bench.begin(lambda: bench.shared.torque(bench.order(key), True, None))
    while not bench.owner._calls._waiting:
        service.thread.join(0.001)
    bench.take("Eve", force=True)
    bench.settle(service)
    with pytest.raises(LeaseError, match="Eve holds the lease"):
        service.answer()
    assert not any(bench.bench.torques())


def test_a_holder_that_cannot_be_held_is_stopped() -> None:
    bench = SharedBench()
    key = bench.take()
    bench.move(key, J1=AWAY)
    bench.keep(key, 0.5)
    bench.bench.silence("J1")
    bench.turn(3.0)
    assert bench.board.state.stopped


def test_a_hold_does_not_wait_for_a_target_that_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = SharedBench()
    key = bench.take()
    bench.move(key, J1=AWAY)
    monkeypatch.setattr(module, "_BUSY", 0.01)
    held, release = threading.Event(), threading.Event()

    def hang() -> None:
        with bench.owner.deciding():
            held.set()
            release.wait(30)

    thread = threading.Thread(target=hang)
    thread.start()
    held.wait(30)
    bench.clock.time += 0.6
    bench.shared.check()
    assert bench.board.state.stopped
    assert bench.shared.holder is None
    release.set()
    thread.join(30)


# -- taking and leaving ---------------------------------------------------------------------------------------


def test_pre_emption_ends_the_former_holders_right_then_holds_then_grants() -> None:
    bench = SharedBench()
    key = bench.take()
    bench.move(key, J1=AWAY)
    bench.keep(key, 1.0)
    seen: list[object] = []
    write = bench._write

    def holding(target: JointTarget) -> Any:
        seen.append((bench.shared.holder, bench.shared.holder_name))
        return write(target)

    bench._write = holding  # type: ignore[method-assign]
    eve = bench.take("Eve", force=True)
    assert seen == [(None, "Eve")], "nobody holds it while the arm is made to hold, and it is known who will"
    assert bench.shared.holder_name == "Eve"
    bench.shared.leave(eve, finish=False)
    assert bench.shared.holder_name == ""
    eve = bench.take("Eve", force=True)
    assert bench.shared.holder is not None
    assert bench.shared.holder.key == eve
    bench.turn(0.3)
    bench.shared.beat(eve, 0.0)
    assert bench.travel("J1", 0.4) < STILL
    with pytest.raises(LeaseError, match="Eve holds the lease"):
        bench.move(key, J1=AWAY)
    assert bench.shared.refusals()["lease_preempted"] == 1


@pytest.mark.parametrize("force", [False, True])
def test_the_holder_may_take_the_lease_again_and_its_motion_continues(force: bool) -> None:
    bench = SharedBench()
    key = bench.take()
    bench.move(key, J1=AWAY)
    bench.keep(key, 1.0)
    waiting = bench.order(key)
    del bench.sent[:]
    assert bench.take(key=key, force=force, watchdog=5.0) == key
    assert bench.shared.holder is not None
    assert bench.shared.holder.watchdog == 5.0
    assert bench.travel("J1", 0.3) > 0.005
    assert not bench.sent, "no hold"
    assert not bench.shared.held
    # An order from before is as good as before.
    bench.shared.write(waiting, JointTarget.of({"J1": bench.where("J1")}, 0.1))
    with pytest.raises(LeaseError, match="Ann holds the lease"):
        bench.take("Eve", key=key ^ 1)


def test_a_rank_below_does_not_pre_empt_and_moves_nothing() -> None:
    bench = SharedBench()
    key = bench.take(rank=2)
    bench.move(key, J1=AWAY)
    bench.keep(key, 0.5)
    with pytest.raises(LeaseError, match="your role may not"):
        bench.take("Bob", 1, force=True)
    bench.shared.beat(key, 0.0)
    assert bench.travel("J1", 0.4) > 0.005, "the motion goes on"


def test_who_takes_a_lease_whose_time_is_over_finds_the_arm_holding() -> None:
    bench = SharedBench()
    key = bench.take()
    bench.move(key, J1=AWAY)
    bench.keep(key, 0.5)
    bench.clock.time += 1.0
    bench.take("Bob")
    assert bench.shared.refusals()["lease_lost"] == 1
    assert len(bench.sent) == 2, "the motion, and the hold"
    bench.turn(0.3)
    assert bench.travel("J1", 0.1) < STILL


def test_who_leaves_lets_the_motion_finish_and_is_not_in_the_way() -> None:
    bench = SharedBench()
    key = bench.take()
    bench.move(key, J1=0.2, seconds=2.0)
    bench.shared.leave(key, finish=True)
    bench.turn(3.0)
    assert bench.where("J1") == pytest.approx(HOME["J1"] + 0.2, abs=0.02)
    assert bench.shared.holder is None
    assert (bench.shared.held, bench.shared.refusals()["lease_lost"]) == ("", 0)


def test_a_motion_of_a_holder_who_left_holds_when_the_next_one_is_lost() -> None:
    bench = SharedBench()
    key = bench.take()
    bench.move(key, J1=AWAY)
    bench.shared.leave(key, finish=True)
    bob = bench.take("Bob", 0)
    bench.keep(bob, 0.5)
    assert bench.shared.holder is not None
    bench.turn(0.9)
    assert "Bob lost" in bench.shared.held
    assert bench.travel("J1", 2.0) < STILL


def test_who_gives_it_back_without_finishing_leaves_the_arm_holding() -> None:
    bench = SharedBench()
    key = bench.take()
    bench.move(key, J1=AWAY)
    bench.keep(key, 0.5)
    bench.shared.leave(key, finish=False)
    assert bench.shared.holder is None
    bench.turn(0.3)
    assert bench.travel("J1") < STILL
    changes = bench.changes
    bench.shared.leave(key, finish=False)
    assert bench.changes == changes, "a former holder changes nothing"


def test_the_supervision_of_a_finishing_motion_waits() -> None:
    bench = SharedBench()
    key = bench.take(watchdog=0.1)
    bench.move(key, J1=0.2, seconds=5.0)
    bench.shared.leave(key, finish=True)
    bench.turn(1.0)
    assert bench.shared.check() == 0.5, "it is not called again at once, whatever the watchdog was"
    assert not bench.shared.tripped


# -- stops ----------------------------------------------------------------------------------------------------


def test_a_stop_voids_what_arrived_before_it_though_it_is_resumed_meanwhile() -> None:
    bench = SharedBench()
    key = bench.take()
    delayed = [bench.order(key, age=0.0) for _ in range(4)]
    assert bench.shared.stop("Bob stopped it") == bench.robot.model.names
    bench.ask(lambda: bench.owner.reset())
    for call in (
        lambda: bench.shared.write(delayed[0], JointTarget.of({"J1": HOME["J1"] + 0.1}, 1.0)),
        lambda: bench.shared.torque(delayed[1], True, None),
        lambda: bench.shared.ioctl(delayed[2], 1, b""),
        lambda: bench.shared.resume(delayed[3]),
    ):
        with pytest.raises((StoppedError, UsageError), match="stop"):
            bench.ask(call)
    assert not bench.sent
    bench.shared.beat(key, 0.0)
    bench.move(key, J1=0.1, seconds=1.0)
    assert len(bench.sent) == 1


def test_a_stop_needs_no_lease_and_waits_for_nobody() -> None:
    bench = SharedBench()
    key = bench.take()
    inside, release = threading.Event(), threading.Event()

    def hang(target: JointTarget) -> Any:
        inside.set()
        release.wait(30)
        raise StoppedError.unsent("a target", 0, "the test ends")

    bench._write = hang  # type: ignore[method-assign]
    # A target hangs on the line, a request for the lease waits for it, and a torque call waits for the owner.
    writing = Service(lambda: bench.move(key, J1=AWAY))
    assert inside.wait(30)
    taking = Service(lambda: bench.take("Eve", force=True))
    torque = Service(lambda: bench.shared.torque(bench.order(key), True, None))
    beating = Service(lambda: bench.shared.beat(key, 0.0))
    beating.answer()
    stopping = Service(lambda: bench.shared.stop("Bob stopped it"))
    assert stopping.answer() == bench.robot.model.names
    assert bench.board.state.stopped
    assert str(bench.owner.group.reason) == "Bob stopped it"
    release.set()
    with pytest.raises(StoppedError):
        writing.answer()
    taking.answer()
    bench.settle(torque)
    with pytest.raises(HexwireError):
        torque.answer()


def test_a_stop_is_confirmed_only_by_the_board() -> None:
    bench = SharedBench()
    key = bench.take()
    bench.move(key, J1=AWAY)
    bench.keep(key, 0.3)
    bench.bench.link.lost = True
    with pytest.raises(HexwireError):
        bench.shared.stop("Bob stopped it")
    assert bench.owner.group.reason is not None
    with pytest.raises((StoppedError, LinkLostError)):
        bench.move(key, J1=AWAY)


def test_only_the_holder_ends_a_stop() -> None:
    bench = SharedBench()
    key = bench.take()
    bench.shared.stop("Bob stopped it")
    with pytest.raises(LeaseError):
        bench.shared.resume(bench.order(key + 1))
    assert bench.board.state.stopped
    with pytest.raises(StoppedError, match=r"the arm is stopped \(Bob stopped it\); resume first"):
        bench.move(key, J1=AWAY)
    bench.ask(lambda: bench.shared.resume(bench.order(key)))
    assert not bench.board.state.stopped
    assert bench.owner.group.reason is None
    assert not bench.sent


def test_a_stop_with_torque_off_leaves_no_torque() -> None:
    bench = SharedBench()
    bench.shared.stop("Bob stopped it", StopMode.TORQUE_OFF)
    bench.turn(0.2)
    assert not any(bench.bench.torques())


# -- the watchdog of the lease ----------------------------------------------------------------------------------


def test_silence_of_the_holders_program_stops_the_arm_though_its_heartbeat_goes_on() -> None:
    bench = SharedBench()
    key = bench.take(watchdog=0.5)
    bench.move(key, J1=AWAY)
    for _ in range(6):
        bench.turn(0.1)
        grant = bench.shared.beat(key, bench.clock.time - bench.shared.holder.active)  # type: ignore[union-attr]
        bench.shared.check()
    assert bench.shared.tripped
    assert bench.board.state.stopped
    assert "made no call for 0.5 s" in str(bench.owner.group.reason)
    assert grant is bench.shared.holder, "the lease is still theirs"
    bench.ask(lambda: bench.shared.resume(bench.order(key)))
    assert not bench.shared.tripped
    bench.shared.watchdog(bench.order(key), 0.0)
    bench.keep(key, 1.0)
    bench.shared.check()
    assert not bench.shared.tripped


def test_a_program_that_keeps_calling_is_not_stopped() -> None:
    bench = SharedBench()
    key = bench.take(watchdog=0.3)
    for _ in range(10):
        bench.turn(0.1)
        bench.shared.beat(key, 0.05)
        bench.shared.check()
    assert not bench.shared.tripped


@pytest.mark.parametrize("timeout", [float("nan"), float("inf"), -1.0, 0.01, 61.0, -float("inf"), 1e300])
def test_a_watchdog_that_is_none_is_refused(timeout: float) -> None:
    bench = SharedBench(on=False)
    with pytest.raises(UsageError, match="outside"):
        bench.take(watchdog=timeout)
    assert bench.shared.holder is None
    key = bench.take(watchdog=0.5)
    with pytest.raises(UsageError, match="outside"):
        bench.shared.watchdog(bench.order(key), timeout)
    assert bench.shared.holder is not None
    assert bench.shared.holder.watchdog == 0.5


# -- loss of the robot ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("watchdog", [0.0, 1.0])
def test_a_robot_that_comes_back_moves_only_after_a_resume_of_the_holder(watchdog: float) -> None:
    bench = SharedBench(watchdog=watchdog)
    key = bench.take()
    bench.move(key, J1=AWAY, seconds=20.0)
    bench.keep(key, 0.5)
    bench.bench.link.lost = True
    bench.bench.until(lambda: not bench.owner.connected)
    for call in (lambda: bench.move(key, J1=AWAY), lambda: bench.shared.resume(bench.order(key))):
        bench.shared.beat(key, 0.0)
        with pytest.raises(LinkLostError):
            call()
    bench.bench.link.lost = False
    bench.bench.until(lambda: bench.owner.connected)
    bench.turn(0.3)
    assert bench.travel("J1", 2.0) < STILL, "its last target was far away"
    bench.take("Ann", force=True)
    key = bench.take("Ann", force=True)
    with pytest.raises(StoppedError, match="resume first"):
        bench.move(key, J1=0.1)
    bench.ask(lambda: bench.shared.resume(bench.order(key)))
    assert bench.travel("J1", 0.4) < STILL
    key = bench.take("Ann", force=True)
    bench.move(key, J1=-0.1, seconds=1.0)
    bench.keep(key, 0.4)


def test_a_lease_that_is_lost_while_the_robot_is_away_ends_all_the_same() -> None:
    bench = SharedBench()
    key = bench.take()
    bench.move(key, J1=AWAY)
    bench.bench.link.lost = True
    bench.bench.until(lambda: not bench.owner.connected)
    bench.turn(2.0)
    bench.shared.check()
    assert bench.shared.holder is None
    assert "Ann lost" in bench.shared.held


# -- start and end ------------------------------------------------------------------------------------------------


def test_a_shutdown_ends_the_lease_and_stops_a_motion() -> None:
    bench = SharedBench()
    key = bench.take()
    bench.move(key, J1=AWAY)
    bench.keep(key, 0.3)
    bench.shared.shutdown()
    with pytest.raises(LeaseError):
        bench.move(key, J1=AWAY)
    with pytest.raises(LeaseError, match="no longer shared"):
        bench.take("Bob")
    bench.owner.shutdown()
    assert bench.board.state.stopped


def test_the_supervision_survives_its_own_failure_and_stops_the_arm(caplog: pytest.LogCaptureFixture) -> None:
    bench = SharedBench()
    failed = threading.Event()
    check = bench.shared.check

    def once() -> float:
        if not failed.is_set():
            failed.set()
            raise RuntimeError("a mistake in this program")
        return check()

    bench.shared.check = once  # type: ignore[method-assign]
    bench.take()
    with caplog.at_level(logging.CRITICAL, "hexwire"):
        bench.shared.start()
        failed.wait(30)
        while not bench.board.state.stopped:
            threading.Event().wait(0.001)
    assert bench.shared.holder is None
    assert bench.shared._supervisor.is_alive()
    assert bench.shared._supervisor.daemon, "a program that does not shut it down ends all the same"
    bench.shared.shutdown()
    assert not bench.shared._supervisor.is_alive()


@pytest.mark.parametrize(
    ("positions", "error"),
    [
        ({"J9": 0.0}, UsageError),
        ({"J1": 50.0}, LimitError),
        ({f"J{i}": 0.0 for i in range(64)}, UsageError),
        ({"": 0.0}, UsageError),
    ],
)
def test_a_target_that_cannot_be_is_refused_and_leaves_no_lock_held(
    positions: dict[str, float], error: type[Exception]
) -> None:
    bench = SharedBench()
    key = bench.take()
    with pytest.raises(error):
        bench.shared.write(bench.order(key, age=0.0), JointTarget.of(positions, 1.0))
    assert not bench.sent
    # In another thread, since these locks are re-entrant.
    Service(lambda: bench.move(key, J1=0.01)).answer()


def test_locks_are_taken_in_one_order_whoever_calls() -> None:
    """Many threads do everything at once; none of them hangs, and every stop is confirmed."""
    bench = SharedBench()
    calls: list[Callable[[], object]] = [
        lambda: bench.take("Ann", force=True),
        lambda: bench.move(bench.take("Bob", force=True), J1=0.01, seconds=0.1),
        lambda: bench.shared.leave(bench.take("Eve", force=True), finish=False),
        lambda: bench.shared.stop("Tom stopped it"),
        bench.shared.check,
        lambda: bench.shared.resume(bench.order(bench.take("Joe", force=True))),
        lambda: bench.shared.follow(
            bench.order(bench.take("Sue", force=True)), "", order((0.5, {"J1": HOME["J1"]})), None
        ),
    ]
    services = []
    for _ in range(4):
        services += [Service(_quiet(call)) for call in calls]
        for service in services:
            bench.settle(service)
            service.answer()


def _quiet(call: Callable[[], object]) -> Callable[[], None]:
    def run() -> None:
        with contextlib.suppress(HexwireError):
            call()

    return run
