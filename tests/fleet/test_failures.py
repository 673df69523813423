"""Errors on their way from the server of an arm to its clients."""

from __future__ import annotations

import inspect
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire import errors
from hexwire.errors import (
    CommandRefusedError,
    DeviceError,
    GoalError,
    HexwireError,
    LeaseError,
    LimitError,
    LinkLostError,
    ReplyTimeoutError,
    ServoError,
    StoppedError,
    UsageError,
)
from hexwire.fleet import messages as m
from hexwire.fleet.failures import describe, restore


def travelled(error: HexwireError) -> HexwireError:
    kind, text, details = describe(error)
    answer = m.decode(m.encode(m.Answer(kind, text, details)), m.Answer)
    return restore(answer.kind, answer.text, answer.details)


@pytest.mark.parametrize(
    "error",
    [
        UsageError("no joint 'J9'"),
        LimitError("J1 would be at 400 degrees"),
        LinkLostError("the port was unplugged", url="serial:///dev/ttyUSB0"),
        StoppedError("JOINT_MOVE", 5, "stopped"),
        StoppedError.unsent("a target", 5, "a stop came after the call"),
        CommandRefusedError("JOINT_MOVE", 4, "a joint has no torque"),
        ServoError("servo 3 does not answer", servo_id=3, status=8),
        LeaseError("Ann holds the lease", holder="Ann"),
        LeaseError("the set-point is 300 ms old", holder="Bob", lost=False),
    ],
)
def test_an_error_reads_the_same_after_its_way(error: HexwireError) -> None:
    after = travelled(error)
    assert type(after) is type(error)
    assert str(after) == str(error)
    for name in ("status", "command", "servo_id", "holder", "lost"):
        assert getattr(after, name, None) == getattr(error, name, None)


def test_an_error_that_does_not_travel_arrives_as_its_nearest_kind() -> None:
    after = travelled(ReplyTimeoutError("JOINT_MOVE"))
    assert isinstance(after, DeviceError)
    assert "JOINT_MOVE" in str(after)


def test_every_error_of_this_program_can_travel() -> None:
    kinds = [
        kind
        for kind in vars(errors).values()
        if inspect.isclass(kind) and issubclass(kind, HexwireError) and kind is not HexwireError
    ]
    assert len(kinds) > 15
    for kind in kinds:
        bare = kind.__new__(kind)
        bare.args = ("a text",)
        for name in ("reason", "command", "holder", "url"):
            bare.__dict__.setdefault(name, "")
        bare.__dict__ |= {"status": 0, "servo_id": 1, "lost": True}
        assert isinstance(travelled(bare), HexwireError), kind


def test_a_long_text_is_cut_so_that_it_fits() -> None:
    assert len(str(travelled(UsageError("x" * 100_000)))) <= 4096
    assert len(str(travelled(LeaseError("x" * 100_000)))) <= 4200


_ANY: Any = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.binary(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=5,
)
_KINDS = [
    "LeaseError",
    "StoppedError",
    "CommandRefusedError",
    "ServoError",
    "GoalError",
    "UsageError",
    "DeviceError",
]


@given(
    kind=st.sampled_from(_KINDS) | st.text(max_size=64),
    text=st.text(max_size=50),
    details=st.dictionaries(
        st.sampled_from(["holder", "lost", "status", "command", "reason", "servo_id", "other"]), _ANY
    ),
)
def test_whatever_a_server_says_gives_an_error_of_this_program(
    kind: str, text: str, details: dict[str, Any]
) -> None:
    error = restore(kind, text, details)
    assert isinstance(error, HexwireError)
    str(error), repr(error)
    assert not isinstance(error, ReplyTimeoutError)


def test_why_a_goal_was_refused_arrives() -> None:
    error = travelled(GoalError("the start time is 0.1 s ago", reason="too late"))
    assert isinstance(error, GoalError)
    assert (str(error), error.reason) == ("the start time is 0.1 s ago", "too late")
    old = restore("GoalError", "no", {})
    assert isinstance(old, GoalError)
    assert old.reason == "malformed"
