"""The health of the servos on a bus: read, judged from samples, put in words, and kept for ten minutes.

Owns which registers are read for it and how often, what counts as healthy, what a pattern of lost answers along the
chain means, and the samples in bounded memory. Nothing is written and nothing moves.

The servos are listed in the order of the chain, from the adapter on: a bad plug or cable spoils the answers of
every servo behind it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from hexwire.wire.registers import Series

from .live_values import LiveValues, read_live
from .servo_bus import ServoBus
from .setup import Found, identify, shares_id
from .survey import Remark, survey
from .values import fault_words

__all__ = [
    "HealthFinding",
    "HealthHistory",
    "HealthRow",
    "HealthSummary",
    "Rank",
    "ServoSamples",
    "check_health",
    "judge_health",
]

_HOT = 10.0
"""Degrees below a servo's own limit from which it is warm."""
_USUAL_LIMIT = 70.0
_LEAK = 0.05
"""Amperes of a servo without torque from which its motor or driver is damaged; its electronics need less."""
_WORK = 0.4
"""Amperes of a joint that only holds, from which it is blocked or carries too much: the rated load of an STS3215 is
about 0.45 A at a quarter of its stall torque."""
_DROP = 0.5
"""Volts between two servos, or two samples, from which cables or supply are too weak."""
_RESTLESS = 4
"""Counts by which a joint at rest may vary."""
_LOST, _BROKEN = 0.01, 0.05
"""Shares of lost answers: a computer that stalls loses one of a hundred."""
_JUMP = 3.0
"""Factor between two neighbours from which the cable between them is bad."""
_PLAY, _WORN = math.radians(1.0), math.radians(2.5)
"""A new servo has up to 0.5 degrees (vendor)."""
_ADVICE = {
    "voltage": "measure the supply at the servo while the arm moves",
    "encoder": "switch the supply off and on; if it stays, replace the servo",
    "temperature": "let it cool; lower the load",
    "current": "free the joint",
    "overload": "free the joint, hold the arm, then `hexwire bus recover`",
}
_READS = 200
"""Reads of each servo for its lost answers."""
_SAMPLES, _PERIOD = 20, 0.05
_PATIENCE = 0.03
"""Seconds allowed for the adapter and this computer."""


class Rank(Enum):
    """How much a finding matters."""

    OK = "ok"
    HINT = "hint"
    BAD = "bad"


@dataclass(frozen=True, slots=True)
class HealthFinding:
    """One thing that was found.

    Attributes:
        rank: How much it matters.
        servo_ids: The servos it is about; empty for the bus.
        topic: faults, supply, temperature, current, rest, backlash, firmware, or cabling.
        text: What was found.
        advice: What to do; empty if nothing.
    """

    rank: Rank
    servo_ids: tuple[int, ...]
    topic: str
    text: str
    advice: str = ""


@dataclass(frozen=True, slots=True)
class ServoSamples:
    """What was read of one servo.

    Attributes:
        servo_id: Its id.
        answers: It answered at all.
        remarks: What is known from its model, firmware, settings and supply.
        settings: SI values of stored settings, by name, as far as they are known.
        torque_on: It has torque; None if unknown.
        live: What it measured, in order of time.
        asked: Reads that were sent once, without a repeat.
        lost: Those of them without a valid answer.
        backlash: Radians; NaN if it was not measured.
    """

    servo_id: int
    answers: bool
    remarks: tuple[Remark, ...] = ()
    settings: Mapping[str, float] | None = None
    torque_on: bool | None = None
    live: tuple[LiveValues, ...] = ()
    asked: int = 0
    lost: int = 0
    backlash: float = math.nan

    @property
    def loss(self) -> float:
        """Share of lost answers."""
        return self.lost / self.asked if self.asked else 0.0


def judge_health(servos: Sequence[ServoSamples]) -> list[HealthFinding]:
    """Judge servos, in the order of the chain; the worst findings come first.

    Where nothing is wrong with a topic, one finding says so, with its range of values.
    """
    findings = _silence(servos)
    here = [servo for servo in servos if servo.answers]
    for servo in here:
        findings += _of_one(servo)
    findings += _supply_along(here) + _losses(here)
    findings += _all_well(here, {finding.topic for finding in findings})
    order = (Rank.BAD, Rank.HINT, Rank.OK)
    return sorted(_together(findings), key=lambda finding: order.index(finding.rank))


def _together(findings: Sequence[HealthFinding]) -> list[HealthFinding]:
    """Findings that differ only in the servo become one."""
    joined: dict[tuple[Rank, str, str, str], tuple[int, ...]] = {}
    for one in findings:
        key = (one.rank, one.topic, one.text, one.advice)
        joined[key] = joined.get(key, ()) + one.servo_ids
    return [HealthFinding(rank, ids, topic, text, advice) for (rank, topic, text, advice), ids in joined.items()]


# --- one servo -------------------------------------------------------------------------------------------------


def _of_one(servo: ServoSamples) -> list[HealthFinding]:
    own = (servo.servo_id,)
    findings = []
    for remark in servo.remarks:
        rank = Rank.BAD if remark.bad else Rank.HINT
        topic = "supply" if "supply" in remark.text or "made for" in remark.text else "firmware"
        text, _, advice = remark.text.partition(": ")
        findings.append(HealthFinding(rank, own, topic, text, advice))
    status = 0
    for row in servo.live:
        status |= row.status
    for word in fault_words(status):
        if word == "voltage" and any(finding.topic == "supply" for finding in findings):
            continue
        findings.append(HealthFinding(Rank.BAD, own, "faults", f"reports {word}", _ADVICE.get(word, "")))
    for judge in (_heat, _current, _rest, _backlash):
        found = judge(servo)
        if found is not None:
            findings.append(found)
    return findings


def _heat(servo: ServoSamples) -> HealthFinding | None:
    heat = _most(servo, lambda row: row.temperature)
    limit = (servo.settings or {}).get("max_temperature", _USUAL_LIMIT)
    if not heat > limit - _HOT:
        return None
    rank = Rank.BAD if heat >= limit else Rank.HINT
    text = f"{heat:.0f} deg C, its limit is {limit:.0f}"
    return HealthFinding(rank, (servo.servo_id,), "temperature", text, "let it cool; lower the load")


def _current(servo: ServoSamples) -> HealthFinding | None:
    current = _most(servo, lambda row: abs(row.current))
    own = (servo.servo_id,)
    if servo.torque_on is False and current > _LEAK:
        text = f"draws {1000 * current:.0f} mA without torque"
        return HealthFinding(Rank.BAD, own, "current", text, "its motor or driver is damaged: replace it")
    if servo.torque_on and current > _WORK:
        text = f"needs {1000 * current:.0f} mA at rest"
        return HealthFinding(Rank.HINT, own, "current", text, "it is blocked, or carries much: put the arm down")
    return None


def _rest(servo: ServoSamples) -> HealthFinding | None:
    places = [row.counts for row in servo.live if row.counts is not None]
    if not places:
        return None
    # A joint near the end of its sensor's turn must not seem to jump by a turn.
    away = [(place - places[0] + 2048) % 4096 - 2048 for place in places]
    spread = max(away) - min(away)
    if spread <= _RESTLESS:
        return None
    why = "its position control trembles" if servo.torque_on else "somebody moves it, or it sinks"
    text = f"moved by {spread} counts while it was watched"
    return HealthFinding(Rank.HINT, (servo.servo_id,), "rest", text, f"{why}: look again with the arm at rest")


def _backlash(servo: ServoSamples) -> HealthFinding | None:
    if not servo.backlash > _PLAY:
        return None
    rank = Rank.BAD if servo.backlash > _WORN else Rank.HINT
    text = f"backlash of {math.degrees(servo.backlash):.1f} deg"
    advice = "tighten the screw of its horn; if that does not help, its gears are worn"
    return HealthFinding(rank, (servo.servo_id,), "backlash", text, advice)


# --- along the chain -------------------------------------------------------------------------------------------


def _silence(servos: Sequence[ServoSamples]) -> list[HealthFinding]:
    silent = [servo.servo_id for servo in servos if not servo.answers]
    if not silent:
        return []
    ids = ", ".join(map(str, silent))
    if len(silent) == len(servos):
        text, advice = "no servo answers", "check supply, port and rate: `hexwire bus scan --all-rates`"
    elif silent == [servo.servo_id for servo in servos[-len(silent) :]]:
        last = servos[-len(silent) - 1].servo_id
        text = f"no answer from servo {ids}, the end of the chain"
        advice = f"check the cable between servos {last} and {silent[0]}, and both its plugs"
    else:
        text = f"no answer from servo {ids}, but from servos behind"
        advice = (
            "the chain goes on, so its cable is good: check its id and rate with `hexwire bus scan --all-rates`"
        )
    return [HealthFinding(Rank.BAD, tuple(silent), "cabling", text, advice)]


def _supply_along(servos: Sequence[ServoSamples]) -> list[HealthFinding]:
    findings = []
    means: list[tuple[int, float]] = []
    for servo in servos:
        volts = _finite([row.voltage for row in servo.live])
        if not volts:
            continue
        means.append((servo.servo_id, sum(volts) / len(volts)))
        if max(volts) - min(volts) > _DROP:
            text = f"varies between {min(volts):.1f} and {max(volts):.1f} V at rest"
            advice = "a bad plug, or a supply that is too weak"
            findings.append(HealthFinding(Rank.HINT, (servo.servo_id,), "supply", text, advice))
    if means:
        first, last = means[0], means[-1]
        if first[1] - last[1] > _DROP:
            text = f"{first[1]:.1f} V at servo {first[0]}, but {last[1]:.1f} V at servo {last[0]}"
            advice = "the cables of the chain are too thin, or a plug is bad"
            findings.append(HealthFinding(Rank.HINT, (last[0],), "supply", text, advice))
            return findings
        low, high = (choose(means, key=lambda one: one[1]) for choose in (min, max))
        if high[1] - low[1] > _DROP:
            text = f"{low[1]:.1f} V at servo {low[0]}, but {high[1]:.1f} V at servo {high[0]}"
            findings.append(HealthFinding(Rank.HINT, (low[0],), "supply", text, "its plug is bad, or its sensor"))
    return findings


def _losses(servos: Sequence[ServoSamples]) -> list[HealthFinding]:
    """What lost answers say about the cables, by their place in the chain."""
    bad = [servo for servo in servos if servo.loss > _LOST]
    if not bad:
        return []
    ids = tuple(servo.servo_id for servo in bad)
    worst = max(bad, key=lambda servo: servo.loss)
    rank = Rank.BAD if worst.loss > _BROKEN else Rank.HINT
    share = f"{worst.loss:.1%} of the answers are lost"
    if len(bad) == len(servos) and len(servos) > 1 and worst.loss < _JUMP * min(servo.loss for servo in bad):
        advice = "the adapter, its ground, the supply, or the first cable"
        return [HealthFinding(rank, ids, "cabling", f"all servos alike: {share}", advice)]
    place = servos.index(bad[0])
    if len(bad) > 1 and servos[place:] == bad:
        before = f"between servos {servos[place - 1].servo_id} and {ids[0]}" if place else "to the first servo"
        advice = f"check the cable {before}, and both its plugs"
        return [HealthFinding(rank, ids, "cabling", f"from servo {ids[0]} to the end: {share}", advice)]
    text = f"{share}" if len(bad) == 1 else f"up to {share}"
    advice = "its own plug or supply, since others answer well" if len(bad) == 1 else "check each of their plugs"
    return [HealthFinding(rank, ids, "cabling", text, advice)]


# --- nothing wrong ---------------------------------------------------------------------------------------------


def _all_well(servos: Sequence[ServoSamples], said: set[str]) -> list[HealthFinding]:
    if not servos:
        return []
    ids = tuple(servo.servo_id for servo in servos)
    rows = [row for servo in servos for row in servo.live]
    asked, lost = sum(servo.asked for servo in servos), sum(servo.lost for servo in servos)
    play = _finite([math.degrees(servo.backlash) for servo in servos])
    limp = " without torque" if all(servo.torque_on is False for servo in servos) else ""
    texts = {
        "faults": "no servo reports a fault",
        "supply": _span([row.voltage for row in rows], "{:.1f} V"),
        "temperature": _span([row.temperature for row in rows], "{:.0f} deg C"),
        "current": _span([abs(row.current) * 1000 for row in rows], f"{{:.0f}} mA at rest{limp}"),
        "backlash": _span(play, "{:.1f} deg") if play else "",
        "cabling": f"{lost} of {asked} answers lost" if asked else "",
    }
    return [
        HealthFinding(Rank.OK, ids, topic, text)
        for topic, text in texts.items()
        if text.strip() and topic not in said
    ]


def _span(values: Sequence[float], form: str) -> str:
    known = _finite(values)
    if not known:
        return ""
    low, high = form.format(min(known)), form.format(max(known))
    return low if low == high else f"{low.split()[0]} to {high}"


def _finite(values: Sequence[float]) -> list[float]:
    return [value for value in values if math.isfinite(value)]


def _most(servo: ServoSamples, value: Callable[[LiveValues], float]) -> float:
    """Largest value of a servo; NaN if it reports none."""
    return max(_finite([value(row) for row in servo.live]), default=math.nan)


def check_health(
    bus: ServoBus,
    servo_ids: Sequence[int],
    *,
    reads: int = _READS,
    go_on: Callable[[], bool] = lambda: True,
) -> list[ServoSamples]:
    """Read all servos for about a second, then each of them again and again.

    Args:
        bus: The open bus.
        servo_ids: In the order of the chain, from the adapter on.
        reads: Reads of each servo, without repeats, that count lost answers.
        go_on: Asked between two reads; what is there is returned as soon as it returns False.

    Raises:
        LinkError: The line has a fault.
    """
    infos = {servo_id: identify(bus, servo_id) for servo_id in servo_ids}
    here = [servo_id for servo_id, info in infos.items() if info is not None]
    found = [Found(infos[servo_id], servo_id, bus.timing.baud, shares_id(bus, servo_id)) for servo_id in here]
    known = {row.found.servo_id: row for row in survey(bus, found)}
    settings = {servo_id: dict(known[servo_id].settings) for servo_id in here}
    torque: dict[int, bool | None] = {}
    for servo_id in here:
        registers = bus.series_of(servo_id).registers
        if "max_temperature" in registers and (limit := bus.read(servo_id, "max_temperature")).raw is not None:
            settings[servo_id]["max_temperature"] = limit.value
        on = bus.read(servo_id, "torque_enable").raw if "torque_enable" in registers else None
        torque[servo_id] = None if on is None else bool(on)
    live: dict[int, list[LiveValues]] = {servo_id: [] for servo_id in here}
    for _ in range(_SAMPLES if here else 0):
        if not go_on():
            break
        for row in read_live(bus, here):
            if not row.error:
                live[row.servo_id].append(row)
        bus.pause(_PERIOD)
    counts = _count_losses(bus, here, reads, go_on)
    return [
        ServoSamples(
            servo_id,
            servo_id in here,
            tuple(known[servo_id].remarks) if servo_id in known else (),
            settings.get(servo_id),
            torque.get(servo_id),
            tuple(live.get(servo_id, ())),
            *counts.get(servo_id, (0, 0)),
        )
        for servo_id in servo_ids
    ]


def _count_losses(
    bus: ServoBus, servo_ids: Sequence[int], reads: int, go_on: Callable[[], bool]
) -> dict[int, tuple[int, int]]:
    """Number of reads and of lost answers of each servo; in turns, so that a disturbance meets all of them."""
    asked, lost = dict.fromkeys(servo_ids, 0), dict.fromkeys(servo_ids, 0)
    retries = bus.retries
    try:
        bus.retries = 0
        for _ in range(reads):
            if not go_on():
                break
            for servo_id in servo_ids:
                asked[servo_id] += 1
                # A legacy servo answers short reads only.
                count = 2 if bus.series_of(servo_id) is Series.SEVEN_BOT else 15
                # An answer that is late because this computer stalls says nothing about cables.
                bus.timing.allowance = max(bus.timing.allowance, _PATIENCE)
                lost[servo_id] += bool(bus.read_block(servo_id, 56, count).error)
    finally:
        bus.retries = retries
    return {servo_id: (asked[servo_id], lost[servo_id]) for servo_id in servo_ids}


class HealthRow(NamedTuple):
    """One second of one servo. NaN where it did not answer.

    Attributes:
        t: Its last sample, seconds.
        voltage: Lowest supply, volts: a short drop must be seen.
        temperature: Highest, degrees Celsius.
        current: Largest magnitude, amperes.
        load: Largest magnitude, fraction of full load.
        status: All fault bits that were set.
        lost: Answers that are missing.
    """

    t: float
    voltage: float
    temperature: float
    current: float
    load: float
    status: int
    lost: int


class HealthSummary(NamedTuple):
    """What is worst of all samples that are kept; NaN without any.

    Attributes:
        lowest_voltage: Volts.
        highest_voltage: Volts; of the lowest in each second.
        hottest: Degrees Celsius.
        most_current: Amperes.
        most_load: Fraction of full load.
        status: All fault bits that were set.
        lost: Answers that are missing.
        asked: Answers that were asked for, since the servo is watched.
    """

    lowest_voltage: float
    highest_voltage: float
    hottest: float
    most_current: float
    most_load: float
    status: int
    lost: int
    asked: int


class HealthHistory:
    """Samples of any number of servos.

    Args:
        seconds: How long they are kept.
        period: Seconds that become one row, however often the servos are read.
        most: Number of servos that are kept; further ones are ignored.
    """

    def __init__(self, *, seconds: float = 600.0, period: float = 1.0, most: int = 64) -> None:
        self._period, self._most = period, most
        self._kept = math.ceil(seconds / period)
        self._rows: dict[int, deque[HealthRow]] = {}
        self._now: dict[int, HealthRow] = {}
        self._second: dict[int, int] = {}
        self._asked: dict[int, int] = {}

    @property
    def servo_ids(self) -> tuple[int, ...]:
        """The servos of which there are samples."""
        return tuple(self._rows)

    def add(self, now: float, values: Sequence[LiveValues]) -> None:
        """Add what servos measured at a time, seconds."""
        for row in values:
            servo_id = row.servo_id
            if servo_id not in self._rows:
                if len(self._rows) >= self._most:
                    continue
                self._rows[servo_id] = deque(maxlen=self._kept)
                self._asked[servo_id] = 0
            self._asked[servo_id] += 1
            fresh, second = _row(now, row), math.floor(now / self._period)
            former = self._now.get(servo_id)
            if former is not None and self._second[servo_id] == second:
                self._now[servo_id] = _merged(former, fresh)
                continue
            if former is not None:
                self._rows[servo_id].append(former)
            self._now[servo_id], self._second[servo_id] = fresh, second

    def rows(self, servo_id: int, since: float = -math.inf) -> list[HealthRow]:
        """The rows of a servo after a time, oldest first, without that of the present second."""
        return [row for row in self._rows.get(servo_id, ()) if row.t > since]

    def summary(self, servo_id: int) -> HealthSummary:
        """What is worst of the rows of a servo, the present second included."""
        rows = [*self._rows.get(servo_id, ())]
        if servo_id in self._now:
            rows.append(self._now[servo_id])
        status = 0
        for row in rows:
            status |= row.status
        return HealthSummary(
            _least([row.voltage for row in rows]),
            _largest([row.voltage for row in rows]),
            _largest([row.temperature for row in rows]),
            _largest([row.current for row in rows]),
            _largest([row.load for row in rows]),
            status,
            sum(row.lost for row in rows),
            self._asked.get(servo_id, 0),
        )

    def forget(self, servo_id: int) -> None:
        """Forget a servo, such as one with a new id."""
        for kept in (self._rows, self._now, self._second, self._asked):
            kept.pop(servo_id, None)


def _row(now: float, row: LiveValues) -> HealthRow:
    current, load = abs(row.current), abs(row.load)
    return HealthRow(now, row.voltage, row.temperature, current, load, row.status, int(bool(row.error)))


def _merged(one: HealthRow, other: HealthRow) -> HealthRow:
    return HealthRow(
        other.t,
        _least([one.voltage, other.voltage]),
        _largest([one.temperature, other.temperature]),
        _largest([one.current, other.current]),
        _largest([one.load, other.load]),
        one.status | other.status,
        one.lost + other.lost,
    )


def _least(values: Sequence[float]) -> float:
    return min((value for value in values if not math.isnan(value)), default=math.nan)


def _largest(values: Sequence[float]) -> float:
    return max((value for value in values if not math.isnan(value)), default=math.nan)
