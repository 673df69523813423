from __future__ import annotations

import pytest

from hexwire.drivers.replies import check_reply, torque_flag
from hexwire.errors import CommandRefusedError, StoppedError
from hexwire.model.state import JointFlag
from hexwire.session.events import Reply
from hexwire.wire.command_frame import Command, Status


def reply(status: int) -> Reply:
    return Reply(1, Command.TORQUE, status, b"", None, 0.0, 1)


def test_check_reply_lets_ok_and_what_was_accepted_through() -> None:
    assert check_reply(reply(0)).status == 0
    assert check_reply(reply(Status.SERVO_SILENT), Status.SERVO_SILENT).status == Status.SERVO_SILENT


@pytest.mark.parametrize("status", [s for s in Status if s])
def test_check_reply_turns_every_other_status_into_an_error_that_says_what_to_do(status: Status) -> None:
    words = "the arm is stopped; `hexwire resume`" if status == Status.STOPPED else "the board refused TORQUE: "
    with pytest.raises(CommandRefusedError, match=words) as info:
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


def test_the_flag_of_torque() -> None:
    flags = [torque_flag(torque) for torque in (True, False, None)]
    assert flags == [JointFlag.TORQUE_ON, 0, JointFlag.TORQUE_UNKNOWN]
