"""Conversions."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire import units


def test_degrees_and_radians() -> None:
    assert units.degrees(math.pi) == 180.0
    assert units.radians(180.0) == math.pi


def test_what_people_type_in_degrees_and_millimetres_is_si() -> None:
    assert units.deg(-90.0) == -math.pi / 2
    assert units.mm(152.5) == 0.1525


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (-0.0, "0"),
        (1.347e-14, "0"),
        (-1.347e-14, "0"),
        (12.3456, "12.35"),
        (-0.5, "-0.5"),
        (0.00012, "0.00012"),
        (0.000123456, "0.000123"),
        (12345.678, "12346"),
        (99.9999, "100"),
        (100.0, "100"),
        (1e9, "1000000000"),
        (1e300, "1e+300"),
        (math.nan, "nan"),
        (math.inf, "inf"),
    ],
)
def test_numbers_for_people(value: float, text: str) -> None:
    assert units.decimal(value) == text


@given(st.floats(-1e14, 1e14))
def test_numbers_for_people_have_no_exponent_and_four_digits(value: float) -> None:
    text = units.decimal(value)
    assert not set(text) - set("-0123456789.")
    assert float(text) == pytest.approx(value, rel=6e-4, abs=6e-7)
    assert text != "-0"


def test_one_count_is_the_chapters_rounded_constant() -> None:
    assert units.CHAPTER_RADIANS_PER_COUNT == 0.001534
    assert math.tau / 4096 != units.CHAPTER_RADIANS_PER_COUNT


@pytest.mark.parametrize(
    ("seconds", "parts"),
    [
        (0.0, (0, 0)),
        (14.356, (14, 356_000_000)),
        (0.1 + 0.2, (0, 300_000_000)),
        (1e-9, (0, 1)),
        (1.9999999999, (2, 0)),
        (-3.5, (0, 0)),
        (2**32 + 7.5, (7, 500_000_000)),
    ],
)
def test_split_time(seconds: float, parts: tuple[int, int]) -> None:
    assert units.split_time(seconds) == parts


@given(st.floats(0, 4e9))
def test_split_time_fits_the_header_and_loses_nothing(seconds: float) -> None:
    sec, nsec = units.split_time(seconds)
    assert 0 <= sec < 2**32
    assert 0 <= nsec < units.NSEC
    assert sec + nsec / units.NSEC == pytest.approx(seconds, abs=1e-6)


@given(st.integers(0, 2**32 - 1))
def test_milliseconds_of_a_boards_clock_stay_what_they_are(ms: int) -> None:
    # A board's clock of milliseconds wraps after 49.7 days.
    sec, nsec = units.split_time(ms / 1000)
    assert sec * 1000 + nsec // 1_000_000 == ms
