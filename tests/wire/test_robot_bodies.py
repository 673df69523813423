"""Bodies of the robot commands: bytes built by hand, values that must be refused, and any noise."""

from __future__ import annotations

import contextlib
import math
import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.errors import RemoteProtocolError, UsageError
from hexwire.wire.robot_bodies import (
    COMMAND_ARRAYS,
    EncoderRow,
    EncoderStates,
    JointCommands,
    JoystickState,
    RobotStatus,
    TrajectoryPoints,
)

NUMBERS = st.floats(allow_nan=False, allow_infinity=False)
NAMES = st.text(st.characters(codec="utf-8"), min_size=1, max_size=20)


@st.composite
def joint_commands(draw: st.DrawFn) -> JointCommands:
    names = tuple(draw(st.lists(NAMES, min_size=1, max_size=8, unique=True)))
    row = st.lists(NUMBERS, min_size=len(names), max_size=len(names)).map(tuple)
    return JointCommands(names, **{array: draw(st.just(()) | row) for array in COMMAND_ARRAYS})


@st.composite
def trajectories(draw: st.DrawFn) -> TrajectoryPoints:
    joints = draw(st.integers(1, 8))
    steps = draw(st.lists(st.floats(0.001, 100), min_size=1, max_size=20))
    times = tuple(sum(steps[: i + 1]) for i in range(len(steps)))
    row = st.lists(NUMBERS, min_size=joints, max_size=joints).map(tuple)
    rows = st.lists(row, min_size=len(times), max_size=len(times)).map(tuple)
    return TrajectoryPoints(times, draw(rows), draw(st.just(()) | rows))


@given(joint_commands() | trajectories())
def test_what_is_written_reads_back(value: JointCommands | TrajectoryPoints) -> None:
    assert type(value).parse(value.serialize()) == value


@given(st.lists(st.floats(-1, 1), max_size=32), st.integers(0, 0xFFFFFFFF))
def test_a_joystick_comes_back_within_a_step(axes: list[float], buttons: int) -> None:
    state = JoystickState.parse(JoystickState(tuple(axes), buttons).serialize())
    assert state.buttons == buttons
    assert state.axes == pytest.approx(axes, abs=1 / 32767)
    assert all(-1 <= axis <= 1 for axis in state.axes)


def test_bytes_by_hand() -> None:
    assert RobotStatus(0x01020304, 1, 2, 6).serialize() == bytes.fromhex("04 03 02 01 01 02 06 00")
    states = EncoderStates(258, 3, (EncoderRow(-2, 1, -1), EncoderRow(1, -1, 1000)))
    assert states.serialize() == bytes.fromhex("02 01 00 00 03 02 FE FF FF FF 01 00 00 00 FF FF") + bytes.fromhex(
        "01 00 00 00 FF FF FF FF E8 03"
    )
    assert EncoderStates.parse(states.serialize()) == states
    commands = JointCommands(("J1", "é"), velocity=(1.0, 2.0), i_effort_max=(3.0, 4.0))
    hand = bytes.fromhex("02 02 01 02") + b"J1" + b"\x02\xc3\xa9" + struct.pack("<4d", 1, 2, 3, 4)
    assert commands.serialize() == hand
    path = TrajectoryPoints((0.5, 1.0), ((1.0,), (2.0,)), ((3.0,), (0.0,)))
    assert path.serialize() == bytes.fromhex("01 01 02 00") + struct.pack("<6d", 0.5, 1, 3, 1.0, 2, 0)
    stick = JoystickState((1.0, -1.0, 0.0), 0b101)
    assert stick.serialize() == bytes.fromhex("03 05 00 00 00 FF 7F 01 80 00 00")
    assert JoystickState.parse(b"\x01\0\0\0\0\x00\x80").axes == (-1.0,)  # -32768 is full left as well
    assert [stick.pressed(i) for i in range(3)] == [True, False, True]


@pytest.mark.parametrize(
    "make",
    [
        lambda: JointCommands(()),
        lambda: JointCommands(("J1", "J1")),
        lambda: JointCommands(tuple(f"J{i}" for i in range(33))),
        lambda: JointCommands(("",)),
        lambda: JointCommands(("x" * 256,)),
        lambda: JointCommands(("J1",), position=(1.0, 2.0)),
        lambda: JointCommands(("J1",), kp_position=(math.nan,)),
        lambda: TrajectoryPoints((), ()),
        lambda: TrajectoryPoints((1.0,), ((),)),
        lambda: TrajectoryPoints((1.0, 1.0), ((0.0,), (0.0,))),
        lambda: TrajectoryPoints((-1.0,), ((0.0,),)),
        lambda: TrajectoryPoints((math.nan,), ((0.0,),)),
        lambda: TrajectoryPoints((1.0, math.inf), ((0.0,), (0.0,))),
        lambda: TrajectoryPoints((1.0,), ((math.inf,),)),
        lambda: TrajectoryPoints((1.0,), ((0.0,),), ((0.0, 0.0),)),
        lambda: TrajectoryPoints((1.0, 2.0), ((0.0,), (0.0, 1.0))),
        lambda: TrajectoryPoints((1.0,), (tuple([0.0] * 33),)),
        lambda: JoystickState((1.1,), 0),
        lambda: JoystickState((math.nan,), 0),
        lambda: JoystickState((0.0,) * 33, 0),
        lambda: JoystickState((-1.1,), 0),
        lambda: JoystickState((), 1 << 32),
        lambda: JoystickState((), -1),
        lambda: JointCommands(("J1", "")),
        lambda: JointCommands(("é" * 128,)),
        lambda: JointCommands(("J1", "J2"), i_effort_max=(1.0,)),
        lambda: TrajectoryPoints((1.0,), ()),
        lambda: TrajectoryPoints((1.0, 2.0), ((0.0,),)),
        lambda: TrajectoryPoints((1.0,), ((0.0,), (0.0,))),
        lambda: TrajectoryPoints((1.0, 2.0), ((0.0,), (0.0,)), ((0.0,),)),
        lambda: TrajectoryPoints((1.0, 0.5), ((0.0,), (0.0,))),
        lambda: TrajectoryPoints((1.0, 2.0, 2.0), ((0.0,),) * 3),
        lambda: TrajectoryPoints((1.0,), ((0.0,),), ((math.nan,),)),
        lambda: TrajectoryPoints(tuple(range(1 << 16)), ((0.0,),) * (1 << 16)),
    ],
)
def test_values_that_make_no_sense_are_refused(make: Any) -> None:
    with pytest.raises(UsageError):
        make()


def test_the_largest_values_that_still_fit() -> None:
    names = tuple(f"{i:03d}" + "x" * 252 for i in range(32))
    for value in (
        JointCommands(names, kp_velocity=(1.0,) * 32),
        TrajectoryPoints((0.0,), (tuple(map(float, range(32))),)),
        TrajectoryPoints(tuple(map(float, range(0xFFFF))), ((0.5,),) * 0xFFFF),
        JoystickState((-1.0,) * 16 + (1.0,) * 16, 0xFFFFFFFF),
    ):
        assert type(value).parse(value.serialize()) == value
    assert EncoderStates.parse(EncoderStates(0xFFFFFFFF, 255, ()).serialize()).time_us == 0xFFFFFFFF
    assert EncoderStates((1 << 32) + 5, 0, ()).serialize()[:4] == b"\5\0\0\0"
    assert EncoderStates((1 << 32) - 1, 0, ()).serialize()[:4] == b"\xff" * 4


BODIES = [
    (RobotStatus(1, 0, 0, 6), "ROBOT_PROBE reply"),
    (EncoderStates(1, 2, (EncoderRow(1, 2, 3),) * 2), "JOINT_STATES"),
    (JointCommands(("J1", "J2"), (1.0, 2.0), kp_velocity=(1.0, 2.0)), "JOINT_COMMANDS"),
    (JointCommands(("J1",)), "JOINT_COMMANDS"),
    (TrajectoryPoints((1.0, 2.0), ((1.0, 2.0),) * 2, ((0.0, 0.0),) * 2), "JOINT_TRAJECTORY"),
    (JoystickState((0.5, 0.5), 3), "JOYSTICK"),
]


@pytest.mark.parametrize(("value", "name"), BODIES)
def test_a_body_that_is_cut_is_refused_by_name(value: Any, name: str) -> None:
    data = value.serialize()
    for body in (data[:n] for n in range(len(data))):
        with pytest.raises(RemoteProtocolError, match=f"^{name}: {len(body)} bytes"):
            type(value).parse(body)


@pytest.mark.parametrize(("value", "name"), BODIES[1:])
def test_a_body_that_is_too_long_is_refused_by_name(value: Any, name: str) -> None:
    data = value.serialize() + b"\0"
    with pytest.raises(RemoteProtocolError, match=f"^{name}: {len(data)} bytes"):
        type(value).parse(data)


def test_a_newer_controller_may_say_more_of_itself() -> None:
    status = RobotStatus(1, 0, 0, 6)
    assert RobotStatus.parse(status.serialize() + b"new") == status


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        (struct.pack("<BH", 1, 1 << 9) + b"\2J1", "do not hold"),  # an array that nobody knows
        (struct.pack("<BH", 1, 0) + b"\1\xff", "JOINT_COMMANDS: a joint name is not UTF-8"),
        (struct.pack("<BH", 2, 0) + b"\1J\1J", "JOINT_COMMANDS: joint commands for 2 joints"),
    ],
)
def test_joint_commands_that_make_no_sense_are_refused(body: bytes, reason: str) -> None:
    with pytest.raises(RemoteProtocolError, match=reason):
        JointCommands.parse(body)


@pytest.mark.parametrize("values", [(math.nan, 1.0), (-1.0, 1.0), (1.0, math.inf)])
def test_a_trajectory_that_makes_no_sense_is_refused(values: tuple[float, float]) -> None:
    with pytest.raises(RemoteProtocolError, match="JOINT_TRAJECTORY: "):
        TrajectoryPoints.parse(struct.pack("<BBH2d", 1, 0, 1, *values))


@pytest.mark.parametrize("kind", [RobotStatus, EncoderStates, JointCommands, TrajectoryPoints, JoystickState])
@given(data=st.data())
def test_any_bytes_are_a_value_or_a_protocol_error(kind: Any, data: st.DataObject) -> None:
    sample = {
        RobotStatus: RobotStatus(1, 0, 0, 6),
        EncoderStates: EncoderStates(1, 2, (EncoderRow(1, 2, 3),) * 2),
        JointCommands: JointCommands(("J1", "J2"), (1.0, 2.0), kp_velocity=(1.0, 2.0)),
        TrajectoryPoints: TrajectoryPoints((1.0, 2.0), ((1.0, 2.0),) * 2),
        JoystickState: JoystickState((0.5, 0.5), 3),
    }[kind].serialize()
    noise = data.draw(st.binary(max_size=80))
    cut = data.draw(st.integers(0, len(sample)))
    spot = data.draw(st.integers(0, len(sample) - 1))
    flipped = bytearray(sample)
    flipped[spot] ^= data.draw(st.integers(1, 255))
    for body in (noise, sample[:cut], sample + noise, sample[:cut] + noise, bytes(flipped)):
        value = None
        with contextlib.suppress(RemoteProtocolError):
            value = kind.parse(body)
        if value is not None:
            assert kind.parse(value.serialize()) == value


def test_counts_that_promise_more_than_there_is() -> None:
    for kind, head in (
        (JointCommands, b"\xff\xff\x01"),
        (TrajectoryPoints, b"\x20\x01\xff\xff"),
        (EncoderStates, b"\0\0\0\0\0\xff"),
        (JoystickState, b"\xff\0\0\0\0"),
    ):
        with pytest.raises(RemoteProtocolError):
            kind.parse(head + bytes(40))
