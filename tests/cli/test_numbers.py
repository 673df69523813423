from __future__ import annotations

import click
import pytest

from hexwire.cli.options import FiniteFloat


@pytest.mark.parametrize("text", ["nan", "inf", "-inf", "x", "", "1,5", "-1"])
def test_invalid_numbers_are_refused(text: str) -> None:
    with pytest.raises(click.BadParameter):
        FiniteFloat("seconds", minimum=0).convert(text, None, None)


def test_numbers() -> None:
    assert FiniteFloat("seconds", minimum=0).convert("0", None, None) == 0.0
    assert FiniteFloat("hz", above=0).convert("1e-3", None, None) == 0.001
    with pytest.raises(click.BadParameter, match="not above 0"):
        FiniteFloat("hz", above=0).convert("0", None, None)
