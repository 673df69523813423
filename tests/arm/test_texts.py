"""What a program is told names methods and arguments, where a command would be told of options."""

from __future__ import annotations

import pytest

from hexwire import HexwireError, UsageError
from hexwire.arm.handle import told
from hexwire.drivers.tools import Gripper
from hexwire.errors import WrongDeviceError
from hexwire.ipc.mistaken import is_puma, is_servo_bus
from hexwire.model.puma260 import PUMA260

SAID = {
    "a servo bus": (is_servo_bus("u", [1]), "name its robot, as in robot='so101', or try `hexwire bus scan`"),
    "a slow servo bus": (
        is_servo_bus("u", [1], baud=57600),
        "as in robot='so101' and ?baud=57600 after the port, or try `hexwire bus scan --baud 57600`",
    ),
    "a PUMA": (is_puma("u", "a hex7bot"), "use robot='puma260'"),
    "a robot unknown": (WrongDeviceError("check power, cable, and --robot if"), "cable, and robot= if"),
    "several ports": (UsageError("several likely boards: a, b; name one with --port"), "name one in connect()"),
    "no port": (UsageError("emulated arm: --port sim://hex7bot"), "emulated arm: connect('sim://hex7bot')"),
    "a file": (UsageError("a.mcap already exists; --force overwrites it"), "force=True overwrites it"),
}


@pytest.mark.parametrize("what", SAID)
def test_a_program_is_told_of_arguments(what: str) -> None:
    error, wanted = SAID[what]
    with pytest.raises(HexwireError) as caught, told():
        raise error
    assert caught.value is error
    assert wanted in str(error)


def test_an_arm_without_a_gripper_is_moved_by_name() -> None:
    class Robot:
        model = PUMA260

    with pytest.raises(UsageError, match=r"as in move\(NAME=deg\(10\)\)"), told():
        Gripper(Robot())  # type: ignore[arg-type]  # only its model is asked for
