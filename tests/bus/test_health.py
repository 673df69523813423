from __future__ import annotations

import math

import pytest

from hexwire.bus.health import HealthFinding, Rank, ServoSamples, judge_health
from hexwire.bus.live_values import LiveValues
from hexwire.bus.survey import Remark


def live(
    servo_id: int = 1,
    *,
    counts: int = 2000,
    volts: float = 7.4,
    heat: float = 30.0,
    amperes: float = 0.0,
    status: int = 0,
) -> LiveValues:
    return LiveValues(servo_id, counts, 0.0, 0.0, 0.0, volts, heat, amperes, status)


def servo(servo_id: int = 1, *rows: LiveValues, asked: int = 200, lost: int = 0, **more: object) -> ServoSamples:
    rows = rows or (live(servo_id),)
    options: dict[str, object] = {"torque_on": False, "settings": {"max_temperature": 70.0}, **more}
    return ServoSamples(servo_id, True, live=rows, asked=asked, lost=lost, **options)  # type: ignore[arg-type]


def silent(servo_id: int) -> ServoSamples:
    return ServoSamples(servo_id, False)


def wrong(*servos: ServoSamples) -> list[HealthFinding]:
    return [row for row in judge_health(servos) if row.rank is not Rank.OK]


def test_six_healthy_servos() -> None:
    found = judge_health([servo(i, live(i, volts=7.3), live(i, volts=7.4)) for i in range(1, 7)])
    assert all(row.rank is Rank.OK for row in found)
    assert {row.topic: row.text for row in found} == {
        "faults": "no servo reports a fault",
        "supply": "7.3 to 7.4 V",
        "temperature": "30 deg C",
        "current": "0 mA at rest without torque",
        "cabling": "0 of 1200 answers lost",
    }
    assert found[0].servo_ids == (1, 2, 3, 4, 5, 6)


@pytest.mark.parametrize(
    ("one", "rank", "topic", "text"),
    [
        (servo(3, live(heat=63.0)), Rank.HINT, "temperature", "63 deg C, its limit is 70"),
        (servo(3, live(heat=60.0)), Rank.OK, "temperature", "60 deg C"),
        (servo(3, live(heat=70.0)), Rank.BAD, "temperature", "70 deg C, its limit is 70"),
        (servo(3, live(heat=72.0), settings=None), Rank.BAD, "temperature", "72 deg C, its limit is 70"),
        (servo(3, live(amperes=-0.1)), Rank.BAD, "current", "draws 100 mA without torque"),
        (servo(3, live(amperes=0.1), torque_on=True), Rank.OK, "current", "100 mA at rest"),
        (servo(3, live(amperes=0.1), torque_on=None), Rank.OK, "current", "100 mA at rest"),
        (servo(3, live(amperes=0.5), torque_on=True), Rank.HINT, "current", "needs 500 mA at rest"),
        (servo(3, live(), live(status=32)), Rank.BAD, "faults", "reports overload"),
        (servo(3, live(status=2)), Rank.BAD, "faults", "reports encoder"),
        (
            servo(3, live(volts=7.4), live(volts=6.8)),
            Rank.HINT,
            "supply",
            "varies between 6.8 and 7.4 V at rest",
        ),
        (servo(3, live(), live(counts=2010)), Rank.HINT, "rest", "moved by 10 counts while it was watched"),
        (servo(3, backlash=math.radians(0.5)), Rank.OK, "backlash", "0.5 deg"),
        (servo(3, backlash=math.radians(1.4)), Rank.HINT, "backlash", "backlash of 1.4 deg"),
        (servo(3, backlash=math.radians(3.0)), Rank.BAD, "backlash", "backlash of 3.0 deg"),
        (servo(3, lost=2), Rank.OK, "cabling", "2 of 200 answers lost"),
        (servo(3, lost=5), Rank.HINT, "cabling", "2.5% of the answers are lost"),
        (servo(3, lost=20), Rank.BAD, "cabling", "10.0% of the answers are lost"),
    ],
)
def test_one_servo(one: ServoSamples, rank: Rank, topic: str, text: str) -> None:
    found = next(row for row in judge_health([one]) if row.topic == topic)
    assert (found.rank, found.servo_ids, found.text) == (rank, (3,), text)
    assert bool(found.advice) is (rank is not Rank.OK)
    assert [row for row in judge_health([one]) if row.rank is not Rank.OK and row.topic != topic] == []


def test_a_joint_at_the_end_of_its_sensors_turn_does_not_jump() -> None:
    assert wrong(servo(1, live(counts=4095), live(counts=0), live(counts=1))) == []


def test_remarks_are_findings_and_servos_with_the_same_are_named_together() -> None:
    supply = Remark(True, "supply 12.1 V is above its limit of 8.0 V: switch it off, check its class")
    weak = Remark(False, "made for 12 V: with 7.4 V it is slower and weaker")
    old = Remark(True, "firmware 3.9 is older than 3.10: LeRobot's calibration fails with it")
    found = wrong(
        servo(1, live(1, status=1), remarks=(supply,)),
        servo(2, live(2, status=1), remarks=(supply, old)),
        servo(3, remarks=(weak,)),
    )
    # The status bit of the supply says nothing more.
    assert [(row.rank, row.servo_ids, row.topic) for row in found] == [
        (Rank.BAD, (1, 2), "supply"),
        (Rank.BAD, (2,), "firmware"),
        (Rank.HINT, (3,), "supply"),
    ]
    assert (found[0].text, found[0].advice) == (
        "supply 12.1 V is above its limit of 8.0 V",
        "switch it off, check its class",
    )


def test_a_sag_that_only_the_status_saw() -> None:
    found = wrong(servo(1, live(status=1)))
    assert (found[0].topic, found[0].text) == ("faults", "reports voltage")


def test_one_servo_in_the_chain_with_less_supply_than_the_others() -> None:
    found = wrong(servo(1, live(1)), servo(2, live(2, volts=4.8)), servo(3, live(3)))
    assert [(row.rank, row.servo_ids, row.text) for row in found] == [
        (Rank.HINT, (2,), "4.8 V at servo 2, but 7.4 V at servo 1")
    ]


def test_volts_lost_along_the_chain() -> None:
    found = wrong(servo(1, live(1, volts=7.4)), servo(2, live(2, volts=7.1)), servo(3, live(3, volts=6.7)))
    assert (found[0].topic, found[0].text) == ("supply", "7.4 V at servo 1, but 6.7 V at servo 3")
    assert "cables" in found[0].advice


@pytest.mark.parametrize(
    ("chain", "ids", "text", "advice"),
    [
        ((silent(1), silent(2)), (1, 2), "no servo answers", "supply, port and rate"),
        ((servo(1), servo(2), silent(3), silent(4)), (3, 4), "the end of the chain", "between servos 2 and 3"),
        ((servo(1), silent(2), servo(3)), (2,), "but from servos behind", "check its id and rate"),
        ((silent(1), servo(2), silent(3)), (1, 3), "but from servos behind", "check its id and rate"),
    ],
)
def test_silent_servos_by_their_place(
    chain: tuple[ServoSamples, ...], ids: tuple[int, ...], text: str, advice: str
) -> None:
    found = wrong(*chain)[0]
    assert (found.rank, found.servo_ids, found.topic) == (Rank.BAD, ids, "cabling")
    assert text in found.text
    assert advice in found.advice


@pytest.mark.parametrize(
    ("lost", "ids", "text", "advice"),
    [
        ((20, 24, 18, 22), (1, 2, 3, 4), "all servos alike: 12.0%", "the adapter, its ground"),
        ((0, 0, 16, 20), (3, 4), "from servo 3 to the end: 10.0%", "between servos 2 and 3"),
        ((1, 2, 16, 2), (3,), "8.0% of the answers", "its own plug"),
        ((16, 0, 10, 0), (1, 3), "up to 8.0%", "each of their plugs"),
        ((4, 4, 4, 60), (1, 2, 3, 4), "from servo 1 to the end", "to the first servo"),
    ],
)
def test_lost_answers_by_their_place(lost: tuple[int, ...], ids: tuple[int, ...], text: str, advice: str) -> None:
    found = [row for row in wrong(*(servo(i, lost=n) for i, n in enumerate(lost, 1))) if row.topic == "cabling"]
    assert len(found) == 1
    assert found[0].servo_ids == ids
    assert text in found[0].text
    assert advice in found[0].advice


def test_what_a_servo_does_not_report_is_not_judged() -> None:
    nan = math.nan
    legacy = LiveValues(1, 2000, 0.0, nan, nan, nan, nan, nan)
    found = judge_health([servo(1, legacy, settings={})])
    assert {row.topic for row in found} == {"faults", "cabling"}
    assert judge_health([]) == []
    assert wrong(ServoSamples(1, True)) == []
