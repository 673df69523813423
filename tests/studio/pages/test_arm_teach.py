from __future__ import annotations

import re

from hexwire.control.motion_service import read_motion
from hexwire.studio.pages.arm_teach import teach_html


def test_torque_goes_off_only_after_somebody_holds_the_arm() -> None:
    button = re.search(r'<button[^>]*id="arm-teach-start"[^>]*>', teach_html())
    assert button is not None
    assert "disabled" in button.group()


def test_every_speed_is_one_that_may_be_played() -> None:
    factors = [float(value) for value in re.findall(r'<option value="([^"]+)"', teach_html())]
    assert factors == sorted(factors)
    for factor in factors:
        assert read_motion({"what": "play", "factor": factor}).factor == factor
    assert 'value="1.0" selected' in teach_html()
