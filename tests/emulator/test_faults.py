from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.emulator import faults
from hexwire.emulator.faults import Fault, FaultPlan, parse_fault
from hexwire.errors import UsageError


@pytest.mark.parametrize(
    ("spec", "fault"),
    [
        ("silent:4", Fault("silent", "bus", servo_id=4)),
        ("silent:4:0.5", Fault("silent", "bus", servo_id=4, probability=0.5)),
        ("late:4:0.05", Fault("late", "bus", servo_id=4, duration=0.05)),
        ("flip:0.01", Fault("flip", "host", probability=0.01)),
        ("bus.drop:0.01", Fault("drop", "bus", probability=0.01)),
        ("host.dup:0.01", Fault("dup", "host", probability=0.01)),
        ("junk:1", Fault("junk", "host")),
        ("cut:0.1", Fault("cut", "host", probability=0.1)),
        ("echo", Fault("echo", "bus")),
        ("host.echo", Fault("echo", "host")),
        ("reset:5.0", Fault("reset", "board", at=5.0)),
        ("brownout:3.0:0.5", Fault("brownout", "board", at=3.0, duration=0.5)),
        ("boot:2.0", Fault("boot", "board", duration=2.0)),
        ("babble:2", Fault("babble", "bus", servo_id=2, probability=0.2)),
        ("overload:3", Fault("overload", "bus", servo_id=3)),
        ("hot:3", Fault("hot", "bus", servo_id=3)),
        ("supply:3:4.8", Fault("supply", "bus", servo_id=3, volts=4.8)),
        (" sketch ", Fault("sketch", "board")),
    ],
)
def test_specifications(spec: str, fault: Fault) -> None:
    assert parse_fault(spec) == fault


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("gremlin:3", "unknown fault 'gremlin:3'; known: silent:ID"),
        ("", "unknown fault"),
        ("host.silent:3", "happens on the bus, not on 'host'"),
        ("moon.flip:0.1", "happens on the host or bus"),
        ("silent", r"is written silent:ID\[:P\]"),
        ("late:4", r"is written late:ID:D\[:P\]"),
        ("echo:1", "is written echo"),
        ("flip:two", "'two' is not a number"),
        ("flip:2", r"2 is outside 0\.\.1"),
        ("flip:nan", "nan is outside"),
        ("silent:254", r"254 is outside 0\.\.253"),
        ("silent:1.5", "is not a number"),
        ("reset:-1", "-1 is outside"),
        ("boot:inf", "inf is outside"),
    ],
)
def test_bad_specifications(spec: str, message: str) -> None:
    with pytest.raises(UsageError, match=message) as caught:
        parse_fault(spec)
    assert "\n" not in str(caught.value)


def test_every_kind_is_in_the_table_of_the_module() -> None:
    assert faults.__doc__ is not None
    for kind in faults._KINDS:
        assert f"| `{faults._form(kind)}` " in faults.__doc__


@given(st.text(max_size=20))
def test_any_text_is_a_fault_or_a_usage_error(text: str) -> None:
    try:
        parse_fault(text)
    except UsageError:
        return
    FaultPlan([text])


def spoilt(spec: str, data: bytes = b"abcdefgh", seed: int = 1) -> list[bytes]:
    plan = FaultPlan([spec], seed=seed)
    return [plan.host_in(data, 0.0) for _ in range(200)]


def test_what_each_line_fault_does() -> None:
    data = b"abcdefgh"
    for result in spoilt("flip:1"):
        changed = [a ^ b for a, b in zip(data, result, strict=True) if a != b]
        assert len(changed) == 1
        assert changed[0].bit_count() == 1
    for result in spoilt("drop:1"):
        assert len(result) == 7
        assert any(data[:i] + data[i + 1 :] == result for i in range(8))
    for result in spoilt("dup:1"):
        assert any(data[: i + 1] + data[i:] == result for i in range(8))
    for result in spoilt("junk:1"):
        assert result.endswith(data)
        assert 1 <= len(result) - 8 <= 16
    for result in spoilt("cut:1"):
        assert data.startswith(result)
        assert len(result) < 8


def test_probability_and_seed() -> None:
    hit = [result != b"abcdefgh" for result in spoilt("drop:0.25")]
    assert 30 < sum(hit) < 70
    assert spoilt("drop:0.25") == spoilt("drop:0.25")
    assert spoilt("drop:0.25", seed=2) != spoilt("drop:0.25")
    assert not any(result != b"abcdefgh" for result in spoilt("drop:0"))


def test_one_more_fault_does_not_change_the_dice_of_the_others() -> None:
    alone, more = FaultPlan(["drop:0.5"], seed=9), FaultPlan(["drop:0.5", "bus.flip:0.5"], seed=9)
    for _ in range(50):
        assert alone.host_out(b"abc", 0.0) == more.host_out(b"abc", 0.0)
        more.bus_heard(b"xyz")


def test_places_are_kept_apart() -> None:
    plan = FaultPlan(["bus.drop:1", "host.echo"])
    assert plan.host_in(b"ab", 0.0) == plan.host_out(b"ab", 0.0) == b"ab"
    assert len(plan.bus_request(b"ab")) == len(plan.bus_heard(b"ab")) == 1
    assert (plan.host_echo, plan.bus_echo) == (True, False)


@given(st.sampled_from(["flip", "drop", "dup", "junk", "cut"]), st.binary(max_size=30), st.integers())
def test_spoiling_is_bounded(kind: str, data: bytes, seed: int) -> None:
    result = FaultPlan([f"{kind}:1"], seed=seed).host_in(data, 0.0)
    assert len(result) <= len(data) + 16
    if not data:
        assert result == b""


def test_resets_fall_due_once() -> None:
    plan = FaultPlan(["reset:5", "reset:7", "brownout:3:0.5"], start=100.0)
    assert plan.next_time(100.0) == 103.5
    assert plan.reset_due(103.4) is None
    assert plan.reset_due(103.5) == "brownout"
    assert plan.reset_due(103.6) is None
    assert plan.next_time(103.6) == 105.0
    assert plan.reset_due(109.0) == "reset"
    assert plan.reset_due(109.0) is None
    assert plan.next_time(109.0) is None


def test_a_brownout_silences_both_lines() -> None:
    plan = FaultPlan(["brownout:3:0.5"])
    for now, alive in ((2.9, True), (3.0, False), (3.4, False), (3.5, True)):
        assert (plan.host_in(b"x", now) == b"x") == alive
        assert (plan.host_out(b"x", now) == b"x") == alive
        assert plan.bus_dead(now) != alive
    assert plan.power_returned(3.4) is None
    assert plan.power_returned(3.6) == 3.5
    assert plan.power_returned(3.7) is None


def test_an_empty_plan_does_nothing() -> None:
    plan = FaultPlan([])
    assert plan.host_in(b"abc", 0.0) == plan.bus_heard(b"abc") == b"abc"
    assert plan.bus_answer(4, b"abc") == (b"abc", 0.0)
    assert plan.bus_answer(4, None) == (b"", 0.0)
    assert (plan.boot_time, plan.sketch, plan.host_echo, plan.bus_echo) == (0.0, False, False, False)
    assert plan.next_time(0.0) is None


def test_board_switches() -> None:
    plan = FaultPlan(["boot:2", "boot:1.5", "sketch"])
    assert plan.boot_time == 2.0
    assert plan.sketch


def test_a_bus_without_a_board_has_its_faults_on_the_bus_at_the_time_of_its_start() -> None:
    plan = FaultPlan.for_bus(["flip:1", "brownout:3:1"], start=100.0)
    assert plan.bus_heard(b"\x00") != b"\x00"
    assert plan.host_in(b"\x00", 100.0) == b"\x00"
    assert [plan.bus_dead(now) for now in (102.9, 103.5, 104.1)] == [False, True, False]


@pytest.mark.parametrize("spec", ["reset:3", "boot:1", "sketch", "host.flip:1", "host.echo"])
def test_a_fault_that_only_a_board_can_have_is_refused_for_a_bus(spec: str) -> None:
    with pytest.raises(UsageError, match="happens on a board, and there is none on a servo bus"):
        FaultPlan.for_bus([spec])
