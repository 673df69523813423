from __future__ import annotations

import math
from dataclasses import replace

import pytest

from hexwire.drivers.arm_file import load_profile
from hexwire.errors import UsageError
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.gripper import Jaws, jaws_of


def degrees(jaws: Jaws | None) -> tuple[str, float, float]:
    assert jaws is not None
    return jaws.joint, round(math.degrees(jaws.closed)), round(math.degrees(jaws.opened))


def test_which_limit_is_closed_depends_on_the_arm() -> None:
    assert degrees(jaws_of(HEX7BOT)) == ("J7", 45, -45)
    assert degrees(jaws_of(load_profile("so101").model)) == ("gripper", -10, 100)


def test_the_geometry_decides_not_the_name() -> None:
    assert degrees(jaws_of(replace(HEX7BOT, name="left", geometry="hex7bot")))[0] == "J7"
    assert jaws_of(load_profile("chain").model) is None
    assert jaws_of(replace(load_profile("chain").model, geometry="so101")) is None


def test_opening_and_angle_are_each_others_inverse() -> None:
    jaws = Jaws("g", 1.0, -1.0)
    assert jaws.angle(0.25) == pytest.approx(0.5)
    assert jaws.share(0.5) == pytest.approx(0.25)
    with pytest.raises(UsageError, match=r"not -0\.1"):
        jaws.angle(-0.1)


@pytest.mark.parametrize(("closed", "opened", "here", "pressed"), [
    (1.0, -1.0, 0.2, 0.3), (1.0, -1.0, 0.95, 1.0), (-1.0, 1.0, 0.2, 0.1), (-1.0, 1.0, -0.95, -1.0),
])  # fmt: skip
def test_pressing_goes_towards_closed_and_not_beyond(
    closed: float, opened: float, here: float, pressed: float
) -> None:
    assert Jaws("g", closed, opened).pressed(here, 0.1) == pytest.approx(pressed)
