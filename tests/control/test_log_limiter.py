from __future__ import annotations

import pytest

from hexwire.control.loop.rate import LogLimiter


def test_same_text_is_logged_again_after_its_period() -> None:
    limiter = LogLimiter()
    assert [limiter.due("no", now, 1.0) for now in (0.0, 0.5, 0.9, 1.0, 1.5)] == [True, False, False, True, False]
    assert limiter.due("other", 1.5)
    assert [limiter.due("usual", now) for now in (5.0, 5.9, 6.0)] == [True, False, True]
    assert not limiter.due("other", 30.0, 60.0)


@pytest.mark.parametrize("number", ["91", "-91.25", "1e+09", "6.1e-05", "0"])
def test_texts_that_differ_in_numbers_are_one(number: str) -> None:
    limiter = LogLimiter()
    assert limiter.due("J1=90.5 deg is outside its limits -85 to 75 deg", 0.0)
    assert not limiter.due(f"J1={number} deg is outside its limits -85 to 75 deg", 0.5)
    assert limiter.due(f"J1={number} deg is fine", 0.5)


def test_only_so_many_texts_are_remembered_and_the_newest_of_them() -> None:
    limiter = LogLimiter()
    for i in range(1000):
        assert limiter.due("no joint " + "x" * i, 0.0)
    assert len(limiter._logged) <= 100
    assert not limiter.due("no joint " + "x" * 999, 0.5)
