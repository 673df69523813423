"""What an arm's settings give that is not written in them: thresholds by rate."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hexwire.control.requests.setting import Faults
from hexwire.control.requests.settings import Settings
from hexwire.control.requests.settings_reader import read_settings
from hexwire.motion.safety import SafetyLimits


@pytest.fixture(scope="module")
def settings() -> Settings:
    return read_settings({"port": "/dev/null"}, Faults())[0]


def test_thresholds_widen_with_the_period_but_those_that_were_given(settings: Settings) -> None:
    assert settings.safety_at(100.0) == SafetyLimits.at_period(0.01)
    given = replace(settings, safety={"lag": 0.25})
    assert given.safety_at(1.0).lag == 0.25
    assert given.safety_at(1.0).max_age == SafetyLimits.at_period(1.0).max_age
