"""The values of a control law."""

from __future__ import annotations

import math
from dataclasses import fields

import pytest

from hexwire.errors import UsageError
from hexwire.model.control_law import ControlLaw
from hexwire.wire.robot_bodies import COMMAND_ARRAYS


def test_it_has_every_field_of_joint_commands_but_the_position() -> None:
    assert ["position", *(field.name for field in fields(ControlLaw))] == list(COMMAND_ARRAYS)


def test_an_effort_or_a_gain_makes_it_act() -> None:
    acting = {field.name for field in fields(ControlLaw) if ControlLaw(**{field.name: -1.0}).acts}
    assert acting == {"effort", "kp_position", "ki_position", "kd_position", "kp_velocity"}
    assert not ControlLaw(velocity=1.0, i_effort_max=1.0).acts


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_value_that_is_not_a_number_is_refused(value: float) -> None:
    for field in fields(ControlLaw):
        with pytest.raises(UsageError, match=f"{field.name} is {value}, not a number"):
            ControlLaw(**{field.name: value})
