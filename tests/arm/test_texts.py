"""What a program is told names methods and arguments, where a command would be told of options."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from tests.arm.arms import connected

from hexwire import Arm, HexwireError, JointFlag, ServoError, UsageError, connect
from hexwire.arm.handle import told
from hexwire.drivers.tools import Gripper
from hexwire.errors import LinkLostError, WrongDeviceError
from hexwire.ipc.mistaken import is_puma, is_servo_bus
from hexwire.model.arms.puma260.kinematics import PUMA260

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
    "a lost line": (LinkLostError("u was lost"), "u was lost (connect() again once it is there)"),
    "a detached arm": (UsageError("the driver is not attached; call attach() first"), "this arm is detached"),
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


ASKED: dict[str, Callable[[Arm], object]] = {
    "read": Arm.read,
    "newest": Arm.newest,
    "states": lambda arm: next(arm.states()),
    "tip": lambda arm: arm.tip,
    "opening": lambda arm: arm.opening,
    "stop": Arm.stop,
    "resume": Arm.resume,
    "torque": Arm.torque,
    "home": Arm.home,
}


@pytest.mark.parametrize("verb", ASKED)
def test_a_detached_arm_says_so(verb: str) -> None:
    arm = connect("sim://hex7bot")
    arm.detach()
    with pytest.raises(UsageError, match=r"^this arm is detached, .*: connect\(\) again$"):
        ASKED[verb](arm)


def test_a_joint_that_is_silent_is_named_by_the_tip(tmp_path: Path) -> None:
    with connected("bus", tmp_path) as arm:
        silent = replace(arm.read(), flags=(JointFlag.SILENT,) * 6, position=(math.nan,) * 6)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(arm.driver, "read", lambda: silent)
            with pytest.raises(ServoError, match=r"^the position of shoulder_pan, .* is unknown"):
                _ = arm.tip


def test_a_pose_that_is_not_there_is_told_with_those_that_are(tmp_path: Path) -> None:
    with connected("bus", tmp_path) as arm:
        with pytest.raises(KeyError, match=r"^no pose 'rst' of so101; there are home$"):
            _ = arm.poses["rst"]
        with pytest.raises(UsageError, match="no pose 'rst'"):
            del arm.poses["rst"]
        assert arm.poses.get("rst") is None
