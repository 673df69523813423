"""Diagnostics of a robot as plain rows: the link, the board, every servo.

Owns the levels and their texts. A text stays the same as long as nothing changes; numbers are in the values. Pure:
facts and time are arguments. Must not know drivers or clocks.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from functools import cache, partial

from hexwire.drivers.base import JointProbe, ProbeReport
from hexwire.model.state import JointFlag, JointState
from hexwire.wire.registers import Series

__all__ = ["ChangeWatch", "RobotFacts", "Row", "RowLevel", "diagnose"]

_ENOUGH = 0.8
"""Fraction of the wanted rate below which states are too slow."""
_STALE = 1.0
"""Seconds after which a state is old; three periods on lines that are slower than that."""
_SAFETY_MARGIN = 10.0
"""Degrees Celsius below its factory cut-off temperature at which a servo is called hot."""
_CUT_OFF = 70.0
"""Degrees Celsius: the lowest factory cut-off of all series, for series without a known one."""
# As whole numbers: a test of a member of an IntFlag takes ten times as long.
_FAULTS, _CLAMPED = int(JointFlag(-1).faults), int(JointFlag.CLAMPED)
_SHORTEST = 0.1
"""Least seconds between two reports of changes: a loose plug must not flood the log."""


class RowLevel(IntEnum):
    """Severity; a greater value is worse."""

    OK = 0
    WARNING = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True, slots=True)
class Row:
    """The diagnosis of one part of the robot.

    Attributes:
        level: Severity.
        name: ``link``, ``board``, or a servo, for example ``J1 (servo 0)``.
        text: Summary; the same as long as nothing changes.
        values: Pairs of key, with the unit, and value.
    """

    level: RowLevel
    name: str
    text: str
    values: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class RobotFacts:
    """The facts from which a robot is diagnosed.

    Attributes:
        robot: Name of the robot.
        url: URL of the link.
        connected: The link is open and the driver attached.
        error: The last error of the link; empty if there was none.
        reconnects: Number of reconnections.
        probe: The last probe; None before the first.
        state: The last state; None before the first.
        state_age: Seconds since that state; infinite before the first.
        rate: States published per second; NaN if unknown.
        wanted_rate: Wanted states per second; 0 if none are wanted.
        stopped: Why the arm is stopped; empty if it is not.
        counters: The newest counters by name; they replace the probe's of the same name.
        controllers: Name -> state of each controller in words; a single one has the empty name.
        watchdog: Seconds of silence of the host after which the board stops the arm; 0 for never.
        stop_kind: See `hexwire.motion.safety.StopReason.kind`; a kind other than ``asked`` is an error.
    """

    robot: str
    url: str
    connected: bool
    error: str
    reconnects: int
    probe: ProbeReport | None
    state: JointState | None
    state_age: float
    rate: float
    wanted_rate: float
    stopped: str
    counters: Mapping[str, int]
    controllers: Mapping[str, str]
    watchdog: float
    stop_kind: str = ""


def diagnose(facts: RobotFacts, *, states: str = "states", figures: bool = True) -> tuple[Row, ...]:
    """Rows for the link, the board and each servo, in this order.

    The servos are those of the probe; before the first probe, the joints of the state.

    Args:
        facts: The facts.
        states: The front's name of the published states.
        figures: False leaves the rows without values, which take most of the time: `ChangeWatch` needs none.
    """
    rows = [_row("link", _judge_link(facts, states), partial(_of_link, facts, states), figures)]
    rows.append(_row("board", _judge_board(facts), partial(_of_board, facts), figures))
    servos: list[tuple[str, str, JointProbe | None]] = []
    if facts.probe is not None:
        servos = [(f"{row.name} (servo {row.servo_id})", row.name, row) for row in facts.probe.joints]
    elif facts.state is not None:
        servos = [(name, name, None) for name in facts.state.names]
    for title, name, probe in servos:
        rows.append(_row(title, _judge_servo(facts, name, probe), partial(_of_servo, facts, name, probe), figures))
    return tuple(rows)


class ChangeWatch:
    """Decides when to report rows: about once per `period`, and immediately when a level or text has changed.

    Args:
        period: Seconds.

    Attributes:
        period: Seconds; may be changed.
    """

    def __init__(self, period: float = 1.0) -> None:
        self.period = period
        self._said: frozenset[tuple[str, RowLevel, str]] | None = None
        self._when = -math.inf
        self._next = -math.inf

    def due(self, rows: Iterable[Row], now: float) -> bool:
        """Whether to report these rows now; if true, they count as reported.

        Args:
            rows: All present rows, in any order.
            now: Monotonic clock, seconds.
        """
        saying = frozenset((row.name, row.level, row.text) for row in rows)
        changed = saying != self._said and now - self._when >= min(_SHORTEST, self.period)
        # A caller that asks once per period is sometimes slightly early, and must not wait for another period.
        in_turn = now >= self._next - 0.1 * self.period
        if not changed and not in_turn:
            return False
        on_time = in_turn and now - self._next <= 0.5 * self.period
        self._next = (self._next if on_time else now) + self.period
        self._said, self._when = saying, now
        return True


_Verdict = tuple[RowLevel, str]
_Values = list[tuple[str, str]]


def _row(name: str, verdict: _Verdict, values: Callable[[], _Values], figures: bool) -> Row:
    level, text = verdict
    return Row(level, name, text, tuple(values()) if figures else ())


def _judge_link(facts: RobotFacts, states: str) -> _Verdict:
    if not facts.connected:
        error = _one_line(facts.error)
        return RowLevel.ERROR, f"not connected: {error}" if error else "not connected"
    if facts.state is None:
        return RowLevel.STALE, "no state received yet"
    if _is_old(facts):
        return RowLevel.STALE, "no new states"
    if facts.rate < _ENOUGH * facts.wanted_rate:
        return RowLevel.WARNING, f"{states} come too slowly"
    return RowLevel.OK, "ok"


def _of_link(facts: RobotFacts, states: str) -> _Values:
    values = [
        ("url", facts.url),
        ("connected", _yes(facts.connected)),
        ("reconnects", str(facts.reconnects)),
        *_number(f"{states} wanted (Hz)", facts.wanted_rate, 1),
        *_number(f"{states} (Hz)", facts.rate, 1),
        *_number("age of the last state (s)", facts.state_age, 3),
    ]
    if error := _one_line(facts.error):
        values.append(("last error", error))
    return values


def _judge_board(facts: RobotFacts) -> _Verdict:
    probe = facts.probe
    if not facts.connected:
        return RowLevel.STALE, "not connected"
    verdicts: list[_Verdict] = []
    if reason := _stop_reason(facts):
        asked = facts.stop_kind == "asked" and not _tripped(facts)
        verdicts.append((RowLevel.WARNING if asked else RowLevel.ERROR, f"stopped: {reason}"))
    if probe is None:
        verdicts.append((RowLevel.STALE, "not probed yet"))
    elif probe.unprotected:
        verdicts.append((RowLevel.WARNING, probe.unprotected))
    level = max((level for level, _ in verdicts), default=RowLevel.OK)
    return level, "; ".join(text for _, text in verdicts) or "ok"


def _of_board(facts: RobotFacts) -> _Values:
    probe = facts.probe
    values = [("robot", facts.robot)]
    if probe is not None:
        values.append(("dialect", probe.dialect_name))
        if probe.firmware:
            values.append(("firmware", probe.firmware))
        if probe.boot_id is not None:
            values.append(("boot id", f"0x{probe.boot_id:08X}"))
        if probe.capabilities:
            values.append(("capabilities", ", ".join(probe.capabilities)))
    values.append(("watchdog (s)", f"{facts.watchdog:g}" if facts.watchdog > 0 else "off"))
    values.append(("watchdog tripped", _yes(_tripped(facts))))
    values.append(("stopped", _stop_reason(facts) or "no"))
    for name, doing in facts.controllers.items():
        values.append((f"controller {name}".rstrip(), doing))
    counters = {**(probe.counters if probe is not None else {}), **facts.counters}
    values += [(name.replace("_", " "), str(count)) for name, count in counters.items()]
    return values


def _tripped(facts: RobotFacts) -> bool:
    return facts.state is not None and facts.state.watchdog_tripped


def _stop_reason(facts: RobotFacts) -> str:
    """Why the arm is stopped; empty if it is not."""
    if facts.stopped:
        return _one_line(facts.stopped)
    if facts.state is not None:
        if facts.state.watchdog_tripped:
            return f"the board's watchdog: {facts.state.trip_reason}"
        return "a stop is latched on the board" if facts.state.stopped else ""
    return "a stop is latched on the board" if facts.probe is not None and facts.probe.stopped else ""


def _judge_servo(facts: RobotFacts, name: str, probe: JointProbe | None) -> _Verdict:
    state = facts.state
    if not facts.connected:
        return RowLevel.STALE, "not connected"
    if state is None or name not in state.names:
        return RowLevel.STALE, "never seen"
    place = state.names.index(name)
    if not math.isfinite(state.age[place]):
        return RowLevel.STALE, "never seen"
    if _is_old(facts):
        return RowLevel.STALE, "no new states"
    flags = state.flags[place]
    if flags & _FAULTS:
        return RowLevel.ERROR, str(JointFlag(flags).faults)
    warnings = []
    if flags & _CLAMPED:
        warnings.append("target clamped to the limits")
    if state.temperature[place] >= _hot(probe.series if probe is not None else ""):
        warnings.append("hot")
    return RowLevel.WARNING if warnings else RowLevel.OK, ", ".join(warnings) or "ok"


def _of_servo(facts: RobotFacts, name: str, probe: JointProbe | None) -> _Values:
    values: _Values = []
    if probe is not None:
        values += [("id", str(probe.servo_id)), ("series", probe.series)]
        if probe.remarks:
            values.append(("note", probe.remarks))
    state = facts.state
    if state is None or name not in state.names:
        return values
    joint = state[name]
    return [
        *values,
        *_number("position (deg)", math.degrees(joint.position), 2),
        *_number("velocity (deg/s)", math.degrees(joint.velocity), 1),
        *_number("load (%)", 100 * joint.load, 1),
        *_number("current (A)", joint.current, 3),
        *_number("voltage (V)", joint.voltage, 1),
        *_number("temperature (C)", joint.temperature, 0),
        ("torque", joint.torque),
        ("flags", str(JointFlag(joint.flags))),
        *_number("age (s)", joint.age, 3),
    ]


@cache
def _hot(series: str) -> float:
    """Temperature near the cut-off temperature of a servo of this series."""
    try:
        register = Series(series).registers.get("max_temperature")
    except ValueError:
        register = None
    cut_off = register.default if register is not None else None
    return (_CUT_OFF if cut_off is None else cut_off) - _SAFETY_MARGIN


def _is_old(facts: RobotFacts) -> bool:
    slow = 3 / facts.wanted_rate if facts.wanted_rate > 0 else 0.0
    return not facts.state_age <= max(_STALE, slow)


def _number(key: str, value: float, digits: int) -> list[tuple[str, str]]:
    """A value with its key; nothing if it is unknown."""
    # Adding 0.0 turns -0.0 into 0.0.
    return [(key, f"{round(value, digits) + 0.0:.{digits}f}")] if math.isfinite(value) else []


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _yes(so: bool) -> str:
    return "yes" if so else "no"
