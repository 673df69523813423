"""What a program passes to a driver's verbs: any form of the same value sends the same bytes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from tests.drivers.arms import Arm
from tests.motion.arms import rest_to_rest

from hexwire.control.motion.motions import check_path
from hexwire.drivers.values import Signal, StopMode
from hexwire.errors import UsageError
from hexwire.model.state import JointTarget
from hexwire.wire.command_frame import Command, parse_frame

Form = Callable[[Any], Any]

TRUTHS: list[Form] = [bool, int, np.bool_, np.int64, np.uint8, np.asarray]
NUMBERS: list[Form] = [int, np.int16, np.int64, np.uint16, np.asarray]
REALS: list[Form] = [float, np.float64, np.asarray]
NAMES: list[Form] = [list, tuple, iter, dict.fromkeys, np.array, lambda names: (name for name in names), reversed]
BYTES: list[Form] = [bytes, bytearray, memoryview, lambda data: np.frombuffer(data, np.uint8)]
PAIRS: list[Form] = [
    tuple,
    list,
    iter,
    lambda pairs: dict(pairs).items(),
    lambda pairs: zip(*zip(*pairs, strict=True), strict=True),
    lambda pairs: [np.array(pair, dtype=object) for pair in pairs],
]


def calls(truth: Form, number: Form, real: Form, names: Form, data: Form, pairs: Form) -> tuple[Form, ...]:
    some, goals = ["J2", "J2"], (("J1", 0.1), ("J3", -0.2))
    return (
        lambda robot: robot.torque(truth(False), names(some)),
        lambda robot: robot.torque(on=truth(True), joints=names(some)),
        lambda robot: robot.torque(truth(True)),
        lambda robot: robot.ioctl(number(Command.STATS)),
        lambda robot: robot.ioctl(sub_cmd=number(Command.TORQUE), data=data(b"\1\x7f\0")),
        lambda robot: robot.write(JointTarget(pairs(goals), real(2.0))),
        lambda robot: robot.write(target=JointTarget.of({"J1": real(0.25)}, duration=number(2))),
        lambda robot: robot.watchdog(real(1.0)),
        lambda robot: robot.ping(number(3)),
        lambda robot: robot.read_table("J1", number(0), number(8)),
        lambda robot: robot.path(names(["J3"]), brake=real(0.2)),
        lambda robot: robot.clear_path(joints=names(some)),
        lambda robot: robot.stop(StopMode(int(number(1)))),
        lambda robot: robot.signal(number(Signal.RESUME)),
    )


def sent(forms: tuple[Form, ...]) -> list[list[tuple[int, bytes]]]:
    """The commands and bodies that each call sends."""
    arm, found = Arm(), []
    # The number of a path is drawn by chance.
    drawn = {Command.TRAJECTORY_BEGIN: 1}
    for call in calls(*forms):
        before = len(arm.link.written)
        call(arm.driver)
        frames = map(parse_frame, arm.link.written[before:])
        found.append([(frame.cmd, frame.body[drawn.get(Command(frame.cmd), 0) :]) for frame in frames])
    return found


def test_every_form_of_an_argument_sends_the_same() -> None:
    plain = sent((bool, int, float, list, bytes, tuple))
    kinds = (TRUTHS, NUMBERS, REALS, NAMES, BYTES, PAIRS)
    for at in range(max(map(len, kinds))):
        assert sent(tuple(kind[at % len(kind)] for kind in kinds)) == plain, at


def test_the_legs_of_a_motion_come_from_any_iterable() -> None:
    arm = Arm()
    names = arm.driver.model.names
    there = [0.02] * len(names)
    where = [arm.driver.read()[name].position for name in names]
    legs = [rest_to_rest(names, where, there, 5.0), rest_to_rest(names, there, where, 5.0)]
    assert check_path(arm.driver, iter(legs)).legs == tuple(legs)  # type: ignore[arg-type]  # as a program may


class Bad:
    """Has neither a truth value nor a length of its own."""


WRONG_TRUTHS = ("off", "", b"", None, [], {}, ["J1"], (), Bad(), np.array([True, False]), len)
WRONG_TARGETS = (5, 5.0, None, ("J1",), "J1", {"J1": 1.0}, [("J1", 1.0, 2.0)], [5], ["ab"], np.float64(5))
WRONG_COMMANDS = (("27", b""), (2.5, b""), (27, "x"), (27, 3), (27, [1]), (None, b""), (27, np.array([1, 2])))


def test_what_is_no_value_of_the_kind_is_told_what_is_wanted_and_sends_nothing() -> None:
    arm: Any = Arm()
    before = len(arm.link.written)
    for on in WRONG_TRUTHS:
        with pytest.raises(UsageError, match="takes True or False"):
            arm.driver.torque(on)
    for given in WRONG_COMMANDS:
        with pytest.raises(UsageError, match=r"a whole number|takes bytes"):
            arm.driver.ioctl(*given)
    for positions in WRONG_TARGETS:
        with pytest.raises(UsageError, match="takes a mapping"):
            JointTarget(positions)  # type: ignore[arg-type]  # the test
    for joints in ("J1", b"J1", 1, 1.0):
        with pytest.raises(UsageError, match="several names"):
            arm.driver.torque(True, joints)
    assert len(arm.link.written) == before
