from __future__ import annotations

import pytest

from hexwire.drivers.base import JointProbe, ProbeReport, RobotDriver, Signal, StopMode, check_reply
from hexwire.errors import CommandRefusedError, StoppedError
from hexwire.session.events import Reply
from hexwire.wire.command_frame import Command, Status


def reply(status: int) -> Reply:
    return Reply(1, Command.TORQUE, status, b"", None, 0.0, 1)


def test_check_reply_lets_ok_and_what_was_accepted_through() -> None:
    assert check_reply(reply(0)).status == 0
    assert check_reply(reply(Status.SERVO_SILENT), Status.SERVO_SILENT).status == Status.SERVO_SILENT


@pytest.mark.parametrize("status", [s for s in Status if s])
def test_check_reply_turns_every_other_status_into_an_error_that_says_what_to_do(status: Status) -> None:
    with pytest.raises(CommandRefusedError, match="the board refused TORQUE: ") as info:
        check_reply(reply(status))
    assert info.value.status == status
    assert isinstance(info.value, StoppedError) == (status == Status.STOPPED)
    assert "\n" not in str(info.value)


@pytest.mark.parametrize(
    ("cmd", "words"),
    [
        (Command.TRANSACT, r"`maintenance\(True\)`"),
        (Command.MAINTENANCE, "`hexwire torque off` first"),
        (Command.JOINT_MOVE, r"`maintenance\(False\)` ends that"),
        (Command.TORQUE, r"`maintenance\(False\)` ends that"),
    ],
)
def test_what_the_gate_forbids_says_what_to_do(cmd: Command, words: str) -> None:
    with pytest.raises(CommandRefusedError, match=words):
        check_reply(reply(Status.FORBIDDEN)._replace(cmd=cmd))


def test_missing_joints_of_a_probe() -> None:
    joints = (JointProbe("J1", 0, "hls", True), JointProbe("J2", 1, "hls", False))
    assert ProbeReport("a", "b", 2, "", None, (), False, joints, {}).missing == ("J2",)


def test_the_numbers_that_programs_rely_on() -> None:
    assert [(s.name, s.value) for s in Signal] == [
        ("STOP", 1),
        ("STOP_TORQUE_OFF", 2),
        ("RESUME", 3),
        ("TORQUE_ON", 4),
        ("TORQUE_OFF", 5),
    ]
    assert (StopMode.HOLD, StopMode.TORQUE_OFF) == (0, 1)


def test_a_driver_must_supply_the_chapters_verbs() -> None:
    verbs = {"attach", "detach", "probe", "read", "write", "ioctl", "torque", "stop", "resume", "from_url"}
    assert verbs <= RobotDriver.__abstractmethods__
    assert "signal" not in RobotDriver.__abstractmethods__
