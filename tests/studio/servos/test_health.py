from __future__ import annotations

import math
from functools import partial
from typing import Any

import pytest
from tests.studio.servos.conftest import servo_of

from hexwire.bus.health import check_health
from hexwire.studio.servos import health


def test_the_servos_are_judged_in_words(view: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(health, "check_health", partial(check_health, reads=10))
    servo_of(view, 4).supply = 12.1
    rows = health.judged(view)
    assert any(level == "error" and "servo 4" in words and "12.1 V" in words for level, words in rows)
    assert view.bus.bench.readable


def test_numbers() -> None:
    assert (health._number(7.44, "V"), health._number(math.nan, "V")) == ("7.4 V", "–")
    assert (health._json(1.23456), health._json(math.nan)) == (1.235, None)
