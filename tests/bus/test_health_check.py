from __future__ import annotations

import pytest
from tests.bus.bus_bench import lose_reads, make_bus

from hexwire.bus.health import Rank, check_health, judge_health
from hexwire.emulator.faults import FaultPlan
from hexwire.wire.registers import Series

IDS = (1, 2, 3, 4, 5, 6)


def worst(*faults: str, echo: bool = False) -> list[tuple[tuple[int, ...], str, str]]:
    bus, _ = make_bus(IDS, faults=FaultPlan(faults), echo=echo)
    found = judge_health(check_health(bus, IDS, reads=100))
    return [(row.servo_ids, row.topic, row.text) for row in found if row.rank is not Rank.OK]


@pytest.mark.parametrize("echo", [False, True])
def test_a_healthy_bus(echo: bool) -> None:
    assert worst(echo=echo) == []


def test_every_fault_is_found() -> None:
    assert worst("silent:3")[0][:2] == ((3,), "cabling")
    assert worst("supply:2:12.5")[0][2] == "supply 12.5 V is above its limit of 8.0 V"
    assert worst("overload:4")[0] == ((4,), "faults", "reports overload")
    assert (worst("hot:5")[0][0], worst("hot:5")[0][1]) == ((5,), "faults")
    ids, topic, text = worst("silent:6:0.2")[0]
    assert (ids, topic) == ((6,), "cabling")
    assert "of the answers are lost" in text


def test_a_hot_servo_is_found_though_its_limit_was_not_read() -> None:
    bus, device = make_bus((1,), faults=FaultPlan(["hot:1"]))
    lose_reads(device.wire[1], "max_temperature")
    bus.pause(0.1)
    found = judge_health(check_health(bus, (1,), reads=20))
    assert (Rank.BAD, "85 deg C, its limit is 70") in [(row.rank, row.text) for row in found]


def test_servos_of_every_series_and_nobody() -> None:
    kinds = (Series.SEVEN_BOT, Series.SCS, Series.STS_SMS, Series.HLS)
    bus, _ = make_bus((1, 2, 3, 4), kinds, paced=False)
    for servo_id in (1, 2, 3, 4):
        bus.set_series(servo_id, Series.STS_SMS)
    servos = check_health(bus, (1, 2, 3, 4, 9), reads=20)
    assert [servo.answers for servo in servos] == [True, True, True, True, False]
    assert [servo.lost for servo in servos] == [0] * 5
    assert [servo.asked for servo in servos] == [20, 20, 20, 20, 0]
    assert [servo.torque_on for servo in servos] == [False, False, False, False, None]
    assert [row.topic for row in judge_health(servos) if row.rank is Rank.BAD] == ["cabling"]


def test_it_ends_when_it_may_not_go_on_and_leaves_the_retries_alone() -> None:
    bus, _ = make_bus(IDS)
    left = iter([True] * 30)
    servos = check_health(bus, IDS, go_on=lambda: next(left, False))
    assert {servo.asked for servo in servos} == {10}
    assert bus.retries == 2


def test_two_servos_with_one_id() -> None:
    bus, device = make_bus(IDS)
    device.wire.servos[3].registers.put("id", 2)
    found = judge_health(check_health(bus, IDS, reads=20))
    bad = {row.servo_ids: row.text for row in found if row.rank is Rank.BAD}
    assert any("several servos seem to have this id" in text for text in bad.values()) or (2,) in bad
    assert (2, 4) in bad or (4,) in bad
