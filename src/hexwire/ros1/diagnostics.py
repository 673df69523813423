"""What is right and wrong with the robot as rows of REP-107: link, board, every servo.

Owns the judgement and its words. Pure: facts and time are arguments. Must not know messages, drivers or clocks.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import IntEnum

from hexwire.drivers.base import ProbeReport
from hexwire.model.state import JointState

__all__ = ["ChangeWatch", "Facts", "Level", "Row", "diagnose"]


class Level(IntEnum):
    """Levels of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True, slots=True)
class Row:
    """One diagnostic_msgs/DiagnosticStatus."""

    level: Level
    name: str
    message: str
    hardware_id: str
    values: tuple[tuple[str, str], ...]


@dataclass(frozen=True, slots=True)
class Facts:
    """What the node knows."""

    node: str
    robot: str
    url: str
    hardware_id: str
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


def diagnose(facts: Facts) -> tuple[Row, ...]:
    """Rows for the link, the board and each servo."""
    raise NotImplementedError


class ChangeWatch:
    """When rows are to be published: about once a second, and at once when one changed."""

    def __init__(self, period: float = 1.0) -> None:
        self._period = period

    def due(self, rows: Iterable[Row], now: float) -> bool:
        """Whether to publish these rows now."""
        raise NotImplementedError
