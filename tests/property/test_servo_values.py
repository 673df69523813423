"""A small part of what `servo_values` does, in a few seconds; the command asks for millions."""

from __future__ import annotations

import sys
from collections import Counter

import pytest
from tests.property import servo_values
from tests.property.dialect1_values import all_noise, ask_board
from tests.property.servo_line import Faults, FaultyLine, MemoryServo, all_faults

from hexwire.wire.servo_packet import make_read, make_status


def test_no_value_is_wrong_under_any_combination_of_faults() -> None:
    total: Counter[str] = Counter()
    for faults in all_faults():
        count = servo_values.ask(faults, 20, seed=5, calls=20)
        assert count["wrong"] == 0, str(faults)
        total += count
    assert total["right"] > 0.6 * total["asked"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("faults", "share"),
    [
        (Faults(), 1.0),
        (Faults(echo=True), 0.75),
        (Faults(echo=True, latency=True), 0.75),
        (Faults(stall=True), 0.95),
        (Faults(junk=True), 0.75),
        (Faults(flip=True), 0.7),
    ],
)
def test_most_values_come(faults: Faults, share: float) -> None:
    count = servo_values.ask(faults, 1500, seed=6)
    assert count["wrong"] == 0
    assert count["right"] >= share * count["asked"]


def test_no_value_of_a_dialect_1_board_is_wrong() -> None:
    for noise in all_noise():
        count = ask_board(noise, 100, seed=7)
        assert count["wrong"] == 0, str(noise)
        assert count["right"]


def test_the_judge_notices_a_wrong_value_and_knows_what_nobody_could() -> None:
    import random

    from hexwire.wire.registers import Series

    servo = MemoryServo(1, Series.STS_SMS, random.Random(1))
    line = FaultyLine([servo], Faults(), random.Random(1))
    answer = make_status(1, 0, b"\x05\x06")
    # An answer that was sent is no forgery, nor is an echo; one that was never sent is.
    line.heard = answer
    assert line.forged(1, b"\x05\x06")
    line.genuine.add(answer)
    assert not line.forged(1, b"\x05\x06")
    request = make_read(1, 56, 2)
    line.write(request)
    line.heard = request
    assert not line.forged(1, b"\x38\x02")


def test_the_command_prints_a_table(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(servo_values, "all_faults", lambda: [Faults(), Faults(echo=True)])
    monkeypatch.setattr(servo_values, "all_noise", lambda: all_noise()[:1])
    monkeypatch.setattr(sys, "argv", ["servo_values", "300"])
    assert servo_values.main() == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split("  ")[0] for line in lines[:5]] == [
        "faults",
        "none",
        "echo",
        "dialect 1: none",
        "all together",
    ]
    assert lines[4].split()[-1] == "0"
