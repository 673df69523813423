from __future__ import annotations

import math
from typing import Any

import pytest
from tests.drivers.arms import Arm

from hexwire.drivers.board2 import Board2
from hexwire.drivers.timed_path import TimedPoint
from hexwire.errors import CommandRefusedError, NotSupportedError, ServoError, StoppedError, UsageError
from hexwire.model.arm import ArmModel, JointModel
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.state import JointTarget
from hexwire.session.events import Reply
from hexwire.wire import servo_packet as sp
from hexwire.wire.board_trajectory import PathState, PathStatus
from hexwire.wire.command_frame import Command, Frame, Status, parse_frame
from hexwire.wire.commands import ALL_FIELDS, Identity
from hexwire.wire.tables import CAPABILITY_MAINTENANCE, CAPABILITY_SERVO_TABLE


def board_of(arm: Arm) -> Board2:
    board = arm.driver._board
    assert isinstance(board, Board2)
    return board


def joint_state(board: Board2) -> tuple[bytes, Frame]:
    reply = board._session.request(Command.JOINT_STATE, bytes((ALL_FIELDS,)), repeatable=True)
    assert reply.frame is not None
    return reply.body, reply.frame


def test_only_the_fields_that_were_asked_for_the_rest_nan() -> None:
    board = board_of(Arm(2))
    bare = board.read(0)
    for column in (bare.velocity, bare.load, bare.current, bare.voltage, bare.temperature):
        assert all(map(math.isnan, column))
    assert board.read(ALL_FIELDS).position == bare.position


def test_a_model_with_another_order_sign_and_offset() -> None:
    arm = Arm(2)
    joints = (
        JointModel("elbow", 4, "hls", 2000, -1, 0.5, 0.001, -3, 3, 5),
        JointModel("base", 0, "seven_bot", 2047, 1, 0.0, 0.002, -3, 3, 5),
    )
    board = Board2(arm.driver.session, ArmModel("odd", joints), board_of(arm).identity)
    state = board.read()
    assert state.names == ("elbow", "base")
    assert state.position == pytest.approx((0.5 - 0.083, 0.012))
    assert board.torque(True, None) == ("base", "elbow")
    assert arm.torques() == [True, False, False, False, True, False, False]
    sent = board.move(JointTarget.of({"elbow": 0.3}, 0.5), {})
    assert sent.positions == (("elbow", pytest.approx(0.3)),)
    arm.wait(1)
    assert arm.shaft(4) == pytest.approx(2200, abs=2)


def test_a_board_without_one_of_the_models_servos() -> None:
    arm = Arm(2)
    model = ArmModel("big", (*HEX7BOT.joints, JointModel("J8", 30, "hls", 0, 1, 0, 1, -1, 1, 1)))
    with pytest.raises(ServoError, match=r"no servo for J8; it has the ids 0, 1, 2, 3, 4, 5, 6"):
        Board2(arm.driver.session, model, board_of(arm).identity)


def test_a_board_that_changed_its_joints_is_noticed() -> None:
    arm = Arm(2)
    identity = board_of(arm).identity
    assert isinstance(identity, Identity)
    board = board_of(arm)
    report = arm.board.state.report(0, arm.clock.time)
    fewer = report._replace(position=report.position[:5], status=report.status[:5])
    reply = arm.driver.session.request(Command.JOINT_STATE, b"\0")
    assert isinstance(reply, Reply)
    assert reply.frame is not None
    with pytest.raises(ServoError, match="attach again"):
        board.decode_state(fewer.serialize(), reply.frame, 0.0)


def test_the_clock_of_the_last_answer() -> None:
    arm = Arm(2)
    board = board_of(arm)
    assert math.isnan(board.clock)
    arm.wait(7.5)
    board.stats()
    assert board.clock == pytest.approx(7.5, abs=0.001)


def test_an_age_never_is_infinite() -> None:
    state = board_of(Arm(2, 0, ("silent:6",))).read()
    assert state["J7"].age == math.inf
    assert state.silent == ("J7",)


def test_a_servo_never_sampled_has_no_position() -> None:
    arm = Arm(2, 0, ("silent:6",))
    joint = board_of(arm).read()["J7"]
    values = (joint.position, joint.velocity, joint.load, joint.current, joint.voltage, joint.temperature)
    assert all(map(math.isnan, values))
    sent = arm.driver.write(JointTarget.of({"J7": 0.1}, duration=1.0))
    assert sent.silent == ("J7",)


def test_maintenance_lets_settings_be_written_and_nothing_move() -> None:
    arm = Arm(2, 115200)
    driver = arm.driver
    mode = sp.make_write(4, 0x21, b"\1")
    with pytest.raises(CommandRefusedError, match=r"`maintenance\(True\)`"):
        driver.transact(mode, 6)
    driver.torque(True)
    with pytest.raises(CommandRefusedError, match="a joint has torque; `hexwire torque off` first"):
        driver.maintenance(True)
    driver.torque(False)
    driver.maintenance(True)
    assert driver.read().maintenance
    assert driver.probe().maintenance
    driver.transact(mode, 6)
    with pytest.raises(CommandRefusedError, match=r"the board is in maintenance; `maintenance\(False\)` ends that"):
        driver.torque(True)
    driver.transact(sp.make_write(4, 0x21, b"\0"), 6)
    driver.maintenance(False)
    assert not driver.read().maintenance
    assert len(driver.torque(True)) == 7


def test_firmware_without_maintenance_is_reported() -> None:
    with pytest.raises(NotSupportedError, match="MAINTENANCE needs a board with dialect 2"):
        Arm(1).driver.maintenance(True)
    board = board_of(Arm(2))
    can = board.identity.capabilities & ~CAPABILITY_MAINTENANCE
    board.identity = board.identity._replace(capabilities=can, firmware=(2, 0, 1))
    with pytest.raises(NotSupportedError, match=r"firmware 2\.0\.1 has no maintenance"):
        board.maintenance(True)


def spin(arm: Arm, servo_id: int) -> None:
    servo = arm.board.wire[servo_id]
    servo.registers.put_stored("mode", 1)
    servo.registers.put("goal_speed", 20)
    servo.registers.put("torque_enable", 1)
    servo._watch()


def test_a_stop_names_the_joints_that_did_not_hold(caplog: pytest.LogCaptureFixture) -> None:
    arm = Arm(2, 115200)
    arm.driver.torque(True)
    spin(arm, 5)
    assert len(arm.driver.stop()) == 7
    assert "a joint did not hold and its torque is off; joints without torque: J6" in caplog.text
    assert not arm.torques()[5]
    caplog.clear()
    arm.driver.resume()
    assert arm.driver.torque(True) == ("J1", "J2", "J3", "J4", "J5", "J7")
    assert "no torque on J6: a servo is not in position mode" in caplog.text


def test_a_stop_names_the_joints_that_are_silent(caplog: pytest.LogCaptureFixture) -> None:
    arm = Arm(2, 115200, ("silent:3",))
    arm.driver.torque(True)
    assert arm.driver.stop() == ("J1", "J2", "J3", "J5", "J6", "J7")
    assert "the stop is not confirmed by J4" in caplog.text


def test_a_stop_that_was_lost_is_said_again_soon_and_one_that_takes_long_is_waited_for() -> None:
    arm = Arm(2, 115200)
    arm.driver.torque(True)
    board = arm.board
    receive, lost = board.receive, []

    def deaf(data: bytes, now: float) -> None:
        if len(lost) < 3:
            lost.append(now)
        else:
            receive(data, now)

    board.receive = deaf  # type: ignore[method-assign]  # the first three frames never arrive
    begun = arm.clock.time
    assert len(arm.driver.stop()) == 7
    assert arm.clock.time - begun < 0.6
    # A servo that is never still: the board looks for 0.4 s, and then takes its torque.
    arm.driver.resume()
    board.wire[4].noise = 50.0
    assert "J5" in arm.driver.stop()
    assert not arm.torques()[4]


def test_after_a_trip_of_the_watchdog_a_refusal_says_that() -> None:
    arm = Arm()
    arm.driver.torque(True)
    arm.driver.watchdog(0.5)
    arm.wait(1.0)
    target = JointTarget.of({"J1": 0.2}, 1.0)
    for act in (lambda: arm.driver.write(target), lambda: arm.driver.torque(True)):
        with pytest.raises(StoppedError, match="watchdog stopped the arm because the host fell silent"):
            act()
    arm.driver.resume()
    arm.driver.stop()
    with pytest.raises(StoppedError, match="the arm is stopped; `hexwire resume` ends that"):
        arm.driver.write(target)


def sent_commands(arm: Arm) -> list[int]:
    """Commands of the frames that the host has sent."""
    return [parse_frame(data).cmd for data in arm.link.written]


@pytest.mark.parametrize(("joint", "servo"), [("J2", 1), ("J6", 5)])
def test_a_whole_table_is_one_request(joint: str, servo: int) -> None:
    arm = Arm(2)
    before = len(arm.link.written)
    table = arm.driver.read_table(joint)
    assert len(table) == 256
    assert table[:40] == arm.board.wire[servo].registers.read(0, 40)
    # And the confirmation that the fragments of the answer have come.
    assert sent_commands(arm)[before:] == [Command.SERVO_TABLE, Command.FRAGMENT_MISSING]
    assert arm.driver.read_table(joint, 5, 2) == table[5:7]


def test_firmware_without_tables_is_reported_with_its_version() -> None:
    arm = Arm(2)
    board = board_of(arm)
    can = board.identity.capabilities & ~CAPABILITY_SERVO_TABLE
    board.identity = board.identity._replace(capabilities=can, firmware=(2, 0, 1))
    with pytest.raises(NotSupportedError, match=r"firmware 2\.0\.1 reads no register tables"):
        arm.driver.read_table("J2")


def test_settings_are_written_where_they_differ() -> None:
    arm = Arm(2)
    with pytest.raises(CommandRefusedError, match="maintenance"):
        arm.driver.write_table("J6", 21, b"\x21")
    arm.driver.maintenance(True)
    table = bytearray(arm.driver.read_table("J6", 9, 31))
    table[21 - 9] = 99
    arm.driver.write_table("J6", 9, bytes(table))
    assert arm.driver.read_table("J6", 9, 31) == bytes(table)
    assert arm.board.wire[5].registers.read(21, 1) == b"\x63"
    with pytest.raises(ServoError, match="does not keep"):
        # A register of the present state cannot be written.
        arm.driver.write_table("J6", 66, b"\x55")


def test_a_long_table_is_written_in_fragments() -> None:
    arm = Arm(2)
    arm.driver.maintenance(True)
    # From a register that nobody has to the end: nothing differs, and nothing may be written there.
    nothing = arm.driver.read_table("J6", 90, 150)
    before = len(arm.link.written)
    with pytest.raises(CommandRefusedError):
        arm.driver.write_table("J6", 0, arm.driver.read_table("J6"))
    assert Command.FRAGMENT in sent_commands(arm)[before:]
    arm.driver.write_table("J6", 90, nothing)


def test_tables_are_checked_before_anything_is_sent() -> None:
    arm = Arm(2)
    before = len(arm.link.written)
    for first, count in ((-1, 2), (0, 257), (255, 2), (0, 0)):
        with pytest.raises(UsageError, match="registers"):
            arm.driver.read_table("J1", first, count)
    board = board_of(arm)
    board.identity = board.identity._replace(capabilities=0)
    with pytest.raises(NotSupportedError, match="flash"):
        arm.driver.read_table("J1")
    assert len(arm.link.written) == before
    with pytest.raises(NotSupportedError, match="dialect-1"):
        Arm(1).driver.read_table("J1")
    with pytest.raises(NotSupportedError, match="dialect-1"):
        Arm(1).driver.write_table("J1", 0, b"x")


# --- a path that outlives its program --------------------------------------------------------------------------


def left(arm: Arm, *joints: str, seconds: float = 3.0, outlives: bool = True) -> dict[str, float]:
    """Have the board follow a path; returns the goals."""
    robot = arm.driver
    robot.torque(True)
    here = robot.read().positions
    path = robot.path(joints, outlives=outlives)
    rest = (0.0,) * len(joints)
    start = tuple(here[name] for name in path.joints)
    goal = tuple(angle + 0.3 for angle in start)
    path.send([TimedPoint(0.0, start, rest), TimedPoint(seconds, goal, rest)], last=True)
    path.start()
    arm.wait(0.6)
    return dict(zip(path.joints, goal, strict=True))


def test_its_joints_are_known_to_every_later_program_until_it_is_over() -> None:
    arm = Arm(2)
    left(arm, "J4", "J7", seconds=2.0)
    arm.driver.detach()
    arm.driver.attach()
    assert arm.driver.left_path() == ("J4", "J7")
    arm.wait(2.0)
    assert arm.driver.left_path() == ()
    assert not arm.driver.clear_path()


def test_it_is_brought_to_rest_for_those_who_move_all_its_joints() -> None:
    arm = Arm(2)
    goal = left(arm, "J4", "J5")
    assert not arm.driver.clear_path(["J1"])
    with pytest.raises(
        UsageError, match=r"^still moving: J5, as a program has told the board; .*; nothing was sent$"
    ):
        arm.driver.clear_path(["j4"])
    assert arm.board.trajectory.state is PathState.RUNNING
    assert arm.driver.clear_path(["J5", "J4", "J1"])
    assert arm.board.trajectory.state is PathState.ABORTED
    place = arm.driver.read().positions
    arm.wait(3.0)
    assert arm.driver.read().positions == pytest.approx(place, abs=0.01)
    assert place["J4"] < goal["J4"] - 0.1


def test_a_target_and_torque_on_replace_it() -> None:
    arm = Arm(2)
    left(arm, "J4", "J5")
    with pytest.raises(UsageError, match="still moving: J5"):
        arm.driver.write(JointTarget.of({"J4": 0.0}, 1.0))
    assert arm.driver.write(JointTarget.of({"J1": 0.0}, 0.5)).positions, "beside it"
    arm.driver.write(JointTarget.of({"J4": 0.0, "J5": 0.0}, 0.5))
    arm.wait(1.0)
    assert arm.driver.read()["J4"].position == pytest.approx(0.0, abs=0.01)
    left(arm, "J4")
    arm.driver.torque(True)
    place = arm.driver.read()["J4"].position
    arm.wait(3.0)
    assert arm.driver.read()["J4"].position == pytest.approx(place, abs=0.02)


def test_a_path_that_needs_its_program_is_left_alone() -> None:
    arm = Arm(2)
    left(arm, "J4", outlives=False)
    assert arm.driver.left_path() == ()
    assert not arm.driver.clear_path()
    with pytest.raises(CommandRefusedError, match="busy"):
        arm.driver.write(JointTarget.of({"J4": 0.0}, 1.0))
    assert arm.board.trajectory.state is PathState.RUNNING


def test_one_that_ends_at_that_moment_is_no_obstacle(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = Arm(2)
    left(arm, "J4", seconds=1.0)
    board = board_of(arm)
    ask = board._ask

    def late(cmd: int, *given: Any, **rest: Any) -> Reply:
        reply = ask(cmd, *given, **rest)
        if reply.status == Status.BUSY:
            arm.wait(1.0)
        return reply

    monkeypatch.setattr(board, "_ask", late)
    assert arm.driver.write(JointTarget.of({"J4": 0.0}, 0.5)).positions


def test_a_board_without_paths_and_one_of_dialect_1_have_none() -> None:
    arm = Arm(2)
    board = board_of(arm)
    board.identity = board.identity._replace(capabilities=0)
    before = len(arm.link.written)
    assert (board.left_path(), board.clear_path(None)) == ((), False)
    assert len(arm.link.written) == before
    arm = Arm(1)
    assert (arm.driver.left_path(), arm.driver.clear_path()) == ((), False)


def test_where_the_id_does_not_tell_the_joints_it_may_be_any() -> None:
    arm = Arm(2)
    board = board_of(arm)
    status = PathStatus(0x80, PathState.RUNNING, 0, 0, 0, 0, 0)
    assert board._joints_on(status) == HEX7BOT.names
    assert board._joints_on(status._replace(id=0x88)) == ("J4",)
