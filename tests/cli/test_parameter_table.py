from __future__ import annotations

from hexwire.cli.parameter_table import table
from hexwire.control.requests.setting import Setting


def test_texts_are_beside_short_names_and_below_long_ones() -> None:
    row = Setting("rate", 1.0, "states per second", "Hz", low=0.0, high=9.0)
    lines = table([("rate:=1.0", row), ("r" * 50, row), ("of:=x", Setting("of", "x", "words " * 40))]).splitlines()
    assert lines[0] == "  rate:=1.0  states per second (0 to 9 Hz)"
    assert lines[1:3] == ["  " + "r" * 50, " " * 13 + "states per second (0 to 9 Hz)"]
    assert all(line.startswith(" " * 13 + "words") for line in lines[4:])
    assert max(map(len, lines)) <= 112
