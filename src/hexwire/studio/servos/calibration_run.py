"""A calibration by hand for a tab: samples the joints, tells the page, stores the result or a file.

Owns the messages, which run belongs to which tab, and which file fits the servos here. `setup.calibrating` owns
the calibration. Nothing moves by itself.
"""

from __future__ import annotations

import datetime
import math
import threading
import time
from typing import TYPE_CHECKING, Any

from hexwire.drivers.bus_arm import BusArm
from hexwire.drivers.registry import load_bus_arm
from hexwire.errors import ConfigError, DeviceError, HexwireError, UsageError
from hexwire.model.arms import assembled_arms
from hexwire.model.calibration import Calibration
from hexwire.setup.calibrating import CalibrationBench, counting_arm, store
from hexwire.studio.calls import Arguments, Asked, CallHost, call

if TYPE_CHECKING:
    from hexwire.studio.bus_source import BusSource
    from hexwire.studio.tabs import Tab

__all__ = ["CalibrationRun", "calibration_values", "parse_file", "store_in"]

_PERIOD, _TELL = 0.02, 0.1
"""Seconds between two samples, and between two messages."""
_REACH = 1.6
"""Radians to either side that a joint of an unknown arm usually goes."""


class _Arm(Arguments, frozen=True):
    arm: str


class _File(Arguments, frozen=True):
    arm: str
    name: str
    text: str


def _kinds() -> dict[str, str]:
    """What may be calibrated: words by name."""
    return assembled_arms() | {"servos": "the servos here"}


@call("calibration.arms", Arguments)
def _arms(asked: Asked, args: Arguments) -> dict[str, Any]:
    """The arms to choose from, and which is likely."""
    ids = asked.bus.bench.servo_ids
    models = {name: load_bus_arm(name).described().model for name in assembled_arms()}
    likely = [name for name, model in models.items() if tuple(joint.servo_id for joint in model.joints) == ids]
    return {"arms": [*_kinds().items()], "likely": next(iter(likely), "servos")}


@call("calibration.begin", _Arm, control=True)
def _begin(asked: Asked, args: _Arm) -> bool:
    """Prepare a run; whether it has joints without stops, whose middle must be told."""
    run = CalibrationRun(asked.studio, asked.bus, asked.tab, args.arm)
    asked.tab.begun["calibration"] = asked.bus, run
    return run.hand.needs_middle


@call("calibration.work", Arguments, control=True)
def _work(asked: Asked, args: Arguments) -> dict[str, Any]:
    """Run it until it is finished, cancelled or stopped; the calibration."""
    run = _run_of(asked)
    run.work()
    assert run.found is not None
    return calibration_values(run.found)


@call("calibration.middle", Arguments)
def _middle(asked: Asked, args: Arguments) -> bool:
    return _run_of(asked).mark_middle()


@call("calibration.finish", Arguments)
def _finish(asked: Asked, args: Arguments) -> None:
    _run_of(asked).finish()


@call("calibration.store", _File, control=True)
def _store(asked: Asked, args: _File) -> tuple[str, ...]:
    """Store a calibration of hexwire in the servos; the names of the joints that have changed."""
    return store_in(asked.bus, parse_file(asked.bus, "calibration.toml", args.text.encode(), args.arm))


def loaded(asked: Asked, name: str, data: bytes, arm: str) -> dict[str, Any]:
    """A calibration from a file, for a page; raises as `parse_file`."""
    return calibration_values(parse_file(asked.bus, name, data, arm))


def _run_of(asked: Asked) -> CalibrationRun:
    bus, run = asked.tab.begun.get("calibration", (None, None))
    if not isinstance(run, CalibrationRun) or bus is not asked.bus:
        raise UsageError("no calibration was begun on this page")
    return run


def calibration_values(found: Calibration) -> dict[str, Any]:
    """A calibration for a page: its rows, and as files; that for LeRobot, or why there is none."""
    told: dict[str, Any] = {
        "rows": [
            (
                row.name,
                str(row.servo_id),
                "–" if row.servo_offset is None else str(row.servo_offset),
                str(row.low),
                str(row.high),
            )
            for row in found.joints
        ],
        "toml": found.serialize(),
        "lerobot": "",
        "no_lerobot": "",
    }
    try:
        told["lerobot"] = found.to_lerobot()
    except UsageError as error:
        told["no_lerobot"] = str(error)
    return told


class CalibrationRun:
    """One calibration by hand. `work` runs it in a thread until it is finished, cancelled or stopped.

    Args:
        studio: The studio.
        bus: The servo bus.
        tab: The tab that is told how far it is; None for all.
        arm: Name of an assembled arm, or ``servos``.

    Attributes:
        hand: What was seen so far.
        found: The calibration, when it is finished.

    Raises:
        UsageError: There is no such arm, or its servos are not here.
        HexwireError: A servo does not answer.
    """

    def __init__(self, studio: CallHost, bus: BusSource, tab: Tab | None, arm: str) -> None:
        if arm not in _kinds():
            raise UsageError(f"there is no arm {arm[:20]!r}")
        described = (
            load_bus_arm(arm).described() if arm != "servos" else bus.bench.describe(bus.bench.servo_ids, _REACH)
        )
        missing = {joint.servo_id for joint in described.model.joints} - set(bus.bench.servo_ids)
        if missing or not described.model.joints:
            names = ", ".join(map(str, sorted(missing)))
            raise UsageError(
                f"servo {names} of this arm was not found; search first" if missing else "search first"
            )
        self._studio, self._bus, self._arm = studio, bus, arm
        self._told_to = None if tab is None else tab.key
        self._driver = BusArm(bus.bus.link, arm=counting_arm(described), bus=bus.bus)
        self._bench = CalibrationBench(self._driver, described)
        self._lock, self._finish = threading.Lock(), False
        self.found: Calibration | None = None
        self._driver.attach()
        try:
            self._bench.examine()
        finally:
            self._driver.detach()
        self.hand = self._bench.by_hand()

    def work(self) -> None:
        """Switch torque off, and follow the joints.

        Raises:
            HexwireError: A servo fails, or the calibration is cancelled or cannot be finished.
        """
        with self._bus.bench.working("a calibration") as job, self._driver:
            self._bench.release()
            told = -math.inf
            while not self._finish:
                if not job.go_on():
                    raise DeviceError(f"the calibration has ended: {job.ended}; nothing was stored")
                with self._lock:
                    self.hand.receive(self._bench.positions(), time.monotonic())
                now = time.monotonic()
                if now - told >= _TELL:
                    told = now
                    self._studio.live.tell({"kind": "range", "rows": self.rows()}, self._told_to)
                time.sleep(_PERIOD)
            taken = datetime.datetime.now().astimezone().isoformat(timespec="seconds")
            with self._lock:
                self.found = self.hand.finish(taken)

    def mark_middle(self) -> bool:
        """Take the present position of joints without stops as their middle; False if they do not report it."""
        try:
            with self._lock:
                self.hand.mark_middle()
        except HexwireError:
            return False
        return True

    def finish(self) -> None:
        """Let `work` end with what was seen."""
        self._finish = True

    def rows(self) -> list[dict[str, object]]:
        """Every joint so far, for JSON: degrees."""
        with self._lock:
            progress = self.hand.progress
        return [
            {
                "name": row.name,
                "low": _degrees(row.low),
                "now": _degrees(row.position),
                "high": _degrees(row.high),
                "usual": _degrees(row.usual) if self._arm != "servos" else None,
                "missing": row.missing if self._arm != "servos" or row.travel < math.radians(5.0) else "",
            }
            for row in progress
        ]


def store_in(bus: BusSource, found: Calibration) -> tuple[str, ...]:
    """Store offsets and limits in the servos; raises as `setup.calibrating.store`."""
    with bus.bench.working("storing a calibration", acts=True):
        return store(bus.bus, found)


def parse_file(bus: BusSource, name: str, data: bytes, arm: str) -> Calibration:
    """Read a calibration of hexwire, or of LeRobot if the file's name ends with ``.json``.

    Args:
        bus: The servo bus.
        name: Name of the file.
        data: What is in it.
        arm: Name of an assembled arm, or ``servos``.

    Raises:
        ConfigError: It is no calibration.
        UsageError: It is of another arm, or its servos are not here.
    """
    if arm not in _kinds():
        raise UsageError(f"there is no arm {arm[:20]!r}")
    try:
        text = data.decode()
    except UnicodeDecodeError:
        raise ConfigError("this file is no text", file=name) from None
    if name.lower().endswith(".json"):
        found = Calibration.from_lerobot(text, arm=arm, file=name)
    else:
        found = Calibration.parse(text, file=name)
    if arm != "servos":
        found.apply(load_bus_arm(arm).described().model)
    missing = sorted({row.servo_id for row in found.joints} - set(bus.bench.servo_ids))
    if missing or not found.joints:
        raise UsageError(f"servo {', '.join(map(str, missing))} of this file was not found; search first")
    return found


def _degrees(angle: float) -> float | None:
    return round(math.degrees(angle), 1) if math.isfinite(angle) else None
