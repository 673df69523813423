"""A bare servo bus that the studio has open: the servos found on it, what they measure, and what is done with them.

Owns the last search, the thread that reads live values, and what several pages of one bus share: history, edits,
backups. What may be done, and a stop, belong to `ServoBench`. Must not know pages or sockets.
"""

from __future__ import annotations

import contextlib
import logging
import math
import threading
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, cast

from hexwire.bus.health import HealthHistory
from hexwire.bus.live_values import LiveValues, read_live
from hexwire.bus.registers import RegisterEdits
from hexwire.bus.setup import Found, identify, scan, shares_id
from hexwire.bus.survey import Surveyed, survey
from hexwire.control.loop.known_state import KNOWN_FOR
from hexwire.control.loop.power import Stopped, Torques
from hexwire.drivers.values import StopMode
from hexwire.errors import HexwireError, LeaseError, ServoError, StoppedError
from hexwire.model.state import JointFlag
from hexwire.setup.servo_bench import Job, ServoBench

from .arm_source import torque_words

if TYPE_CHECKING:
    from hexwire.bus.backup import ServoBackup
    from hexwire.bus.servo_bus import ServoBus
    from hexwire.control.motion.hold_to_run import HoldToRun
    from hexwire.control.sharing.lease import Grant
    from hexwire.epochs import Token

    from .tabs import Tab

__all__ = ["BusSource", "live_row"]

_log = logging.getLogger(__name__)

_PERIOD = 0.2
"""Seconds between two reads of live values."""
_RETRY = 0.5
"""Seconds between two attempts to open a line that was lost."""


class BusSource:
    """An open servo bus. Any thread may call its methods; those that use the bus wait.

    Args:
        bus: Open; this object closes it.
        silence: Seconds without a sign of life after which what somebody holds ends.
        clock: Seconds.
        wall: Seconds since 1970.

    Attributes:
        bus: The open bus.
        bench: Who has control, the present job, and the stop.
        servos: What the last search found, in the order of rates and ids.
        live: The newest values by servo id, of the servos at the bus's rate.
        torque: Whether each servo has torque, by id, as last read.
        heard: When the newest values came, seconds of the clock; minus infinity before the first.
        history: The last ten minutes of them.
        edits: Edits of registers that can be undone.
        backups: Backups taken or loaded here, newest last.
        slid: Where servos were sent last by hand, radians by id.
        error: Why the bus cannot be read; empty if it can.
        on_live: Called with the newest values, in the thread that reads them.
        on_change: Called when servos, job or stop have changed, in any thread.
    """

    def __init__(
        self,
        bus: ServoBus,
        silence: float,
        clock: Callable[[], float] = time.monotonic,
        wall: Callable[[], float] = time.time,
    ) -> None:
        self.bus = bus
        self._clock, self._wall = clock, wall
        self.bench = ServoBench(bus, silence=silence)
        self.servos: list[Surveyed] = []
        self.live: dict[int, LiveValues] = {}
        self.torque: dict[int, bool] = {}
        self.heard = -math.inf
        self.history = HealthHistory()
        self.edits = RegisterEdits()
        self.backups: list[ServoBackup] = []
        self.slid: dict[int, float] = {}
        self.error = ""
        self.on_live: Callable[[list[LiveValues]], object] = lambda values: None
        self.on_change: Callable[[], object] = lambda: None
        self._ending = threading.Event()
        self._reader = threading.Thread(target=self._read, name="studio servos", daemon=True)
        self._reader.start()

    @property
    def hold_to_run(self) -> HoldToRun:
        """What somebody holds."""
        return self.bench.hold_to_run

    @property
    def holder(self) -> Grant | None:
        """Who has control, or None."""
        return self.bench.holder

    def beat(self, key: int) -> None:
        """Renew the control of a tab; raises `LeaseError` if it is lost."""
        self.bench.beat(key)

    @property
    def stops(self) -> int:
        """The number of the last stop; see `Epochs.number`."""
        return self.bus.epochs.number

    def mark(self) -> Token:
        """The time of an order, relative to stops."""
        return self.bus.epochs.mark()

    def stopped_since(self, arrived: Token) -> bool:
        """Whether the servos were stopped since an order, see `mark`."""
        return self.bus.epochs.stopped_since(arrived)

    # -- control ------------------------------------------------------------------------------------------

    def take(self, tab: Tab, *, force: bool = False) -> None:
        """Give a tab control; raises `LeaseError` if another one has it."""
        tab.grant = self.bench.take(tab.name, key=tab.grant, force=force).key
        self.on_change()

    def leave(self, tab: Tab, grant: int) -> None:
        """Take control back from a tab; what moves holds."""
        self.bench.hold_to_run.end(tab.key, "control was given back")
        self.bench.leave(grant)
        self.on_change()

    def has_control(self, tab: Tab) -> bool:
        """Whether a tab has control."""
        try:
            self.bench.need_control(tab.grant)
        except LeaseError:
            return False
        return True

    def stop(self, why: str) -> Stopped:
        """Stop the servos, and say what they do then; raises `HexwireError` if the stop cannot be sent."""
        began = time.monotonic()
        try:
            unsure = self.bench.stop(why)
        finally:
            self.on_change()
        seconds = time.monotonic() - began
        ids = self.bench.servo_ids
        confirmed = tuple(str(i) for i in ids if i not in unsure)
        error = f"not confirmed by servo {', '.join(map(str, unsure))}" if unsure else ""
        torques = self.torques().after_stop(confirmed, StopMode.HOLD)
        return Stopped(self.name, not unsure, confirmed, error, seconds, torques=torques)

    @property
    def name(self) -> str:
        """What it is and its address, for lists of several arms."""
        return f"servo bus at {self.bus.link.url}"

    def torques(self) -> Torques:
        """Which servos hold and which are limp, by id, as far as it was just read."""
        known = {i: self.torque[i] for i in self.torque if self.is_known(i)}
        bits = {True: JointFlag.TORQUE_ON, False: JointFlag(0), None: JointFlag.TORQUE_UNKNOWN}
        return Torques.by_flags({str(i): bits[known.get(i)] for i in self.bench.servo_ids})

    def is_known(self, servo_id: int) -> bool:
        """Whether what is shown of a servo is from now."""
        row = self.live.get(servo_id)
        return not self.error and row is not None and not row.error and self._clock() - self.heard <= KNOWN_FOR

    def resume(self, arrived: Token | None = None) -> None:
        """End a stop; nothing moves.

        Args:
            arrived: When it was asked for, see `mark`; now if None.

        Raises:
            StoppedError: It was stopped again since then.
        """
        if arrived is not None and not self.bus.epochs.holds(arrived):
            raise StoppedError.unsent("resume", 0, "it was stopped again meanwhile")
        self.bench.resume()
        self.on_change()

    def switch_torque(self, on: bool, servo_ids: Sequence[int] | None = None) -> None:
        """Switch torque of servos, or of all; one that gets it holds where it is.

        Raises:
            ServoError: A servo does not confirm it.
        """
        ids = self.bench.servo_ids if servo_ids is None else tuple(servo_ids)
        if not ids:
            return
        done = self.bench.torque(on, ids)
        self.torque = {**self.torque, **dict.fromkeys(done, on)}
        self.on_change()
        if unsure := set(ids) - set(done):
            raise ServoError(f"servo {', '.join(map(str, sorted(unsure)))} did not confirm it")

    # -- servos -------------------------------------------------------------------------------------------

    def search(self, rates: Sequence[int], ids: Sequence[int]) -> list[Surveyed]:
        """Search servos, and read what they are; those at the bus's rate can then be used.

        Args:
            rates: Rates to try; only the present one if empty.
            ids: Ids to try.

        Raises:
            DeviceError: It was cancelled; the servos known before are kept.
            HexwireError: The bus cannot be read.
        """
        bauds = list(rates) or [self.bus.timing.baud]
        total, done, before = len(bauds) * len(ids), 0, 0
        with self.bench.working("a search", changes_rate=True) as job:

            def progress(baud: int, servo_id: int, found: int) -> None:
                nonlocal done
                job.tell(f"{baud} baud, id {servo_id}, {before + found} found", done / total)
                done += 1

            found = scan(self.bus, bauds=bauds, ids=ids, progress=progress)
            if len(bauds) == 1:
                # An answer that was late, as on a busy machine, must not hide a servo: ask silent ids once more.
                here_already = {row.servo_id for row in found}
                silent = [servo_id for servo_id in ids if servo_id not in here_already]
                total += len(silent)
                before = len(found)
                found += scan(self.bus, bauds=bauds, ids=silent, progress=progress)
                found.sort(key=lambda row: row.servo_id)
            here = self.bus.timing.baud
            if found and not any(row.baud == here for row in found):
                # All are at another rate: work there.
                self.bus.set_baud(found[0].baud)
            self._keep(survey(self.bus, found))
        self.on_change()
        return self.servos

    def use_rate(self, baud: int) -> None:
        """Work at another rate, with the servos that were found there.

        Raises:
            HexwireError: The link has no such rate, or a job is under way.
        """
        with self.bench.working("a change of the rate", changes_rate=True):
            self.bus.set_baud(baud)
            self._keep(survey(self.bus, [row.found for row in self.servos]))
        self.on_change()

    def look_again(self, servo_id: int, former: int | None = None) -> Surveyed:
        """Read again what a servo is, such as one with another id; it is in the list afterwards.

        Args:
            servo_id: Its id.
            former: The id that it had.

        Raises:
            ServoError: It does not answer.
        """
        here = self.bus.timing.baud
        info = identify(self.bus, servo_id)
        if info is None:
            raise ServoError(f"servo {servo_id} does not answer: check its cable and power", servo_id=servo_id)
        # At any rate: it may have had another one.
        rest = [row.found for row in self.servos if row.found.servo_id not in (servo_id, former)]
        if former is not None and former != servo_id:
            self.history.forget(former)
        found = Found(info, servo_id, here, shares_id(self.bus, servo_id))
        self._keep(survey(self.bus, sorted([*rest, found], key=lambda row: (row.baud != here, row.servo_id))))
        self.on_change()
        return next(row for row in self.servos if row.found.servo_id == servo_id and row.found.baud == here)

    def find(self, servo_id: int) -> Surveyed | None:
        """What is known of a servo at the bus's rate; None without it."""
        here = self.bus.timing.baud
        return next((row for row in self.servos if row.found.servo_id == servo_id and row.found.baud == here), None)

    def _keep(self, servos: list[Surveyed]) -> None:
        here = self.bus.timing.baud
        self.servos = servos
        self.bench.servo_ids = tuple(
            row.found.servo_id
            for row in servos
            if row.found.baud == here and row.found.info is not None and not row.found.shared
        )
        self.live = {i: values for i, values in self.live.items() if i in self.bench.servo_ids}

    # -- live values --------------------------------------------------------------------------------------

    def _read(self) -> None:
        """Read live values while nothing else needs the bus for itself."""
        turn = 0
        while not self._ending.wait(_PERIOD):
            ids = self.bench.servo_ids
            if not ids or not self.bench.readable:
                continue
            try:
                values = read_live(self.bus, ids)
                if turn % 5 == 0:
                    now = self.bus.sync_read("torque_enable", ids)
                    self.torque = {i: bool(raw) for i, raw in zip(ids, now.raw, strict=True) if raw is not None}
                turn += 1
            except HexwireError as error:
                if not self._ending.is_set() and str(error) != self.error:
                    self.error = str(error)
                    self.on_change()
                self._reopen()
                continue
            except Exception:  # noqa: BLE001  # logged; the next reading may succeed
                _log.exception("reading servos failed")
                continue
            self.error = ""
            self.live, self.heard = {row.servo_id: row for row in values}, self._clock()
            self.history.add(time.monotonic(), values)
            self.on_live(values)

    def _reopen(self) -> None:
        """Open the line again after a loss. Nothing is written: servos that kept their supply hold."""
        if not self.bus.link.is_open and not self._ending.wait(_RETRY):
            with contextlib.suppress(HexwireError):
                self.bus.open()

    # -- facts --------------------------------------------------------------------------------------------

    @property
    def job(self) -> Job | None:
        """The present job."""
        return self.bench.job

    def facts(self) -> dict[str, object]:
        """What is always in sight, for JSON."""
        bench, job = self.bench, self.bench.job
        holder = bench.holder
        # Without servos there is nothing to be read.
        fresh = not bench.servo_ids or self._clock() - self.heard <= KNOWN_FOR
        known = not self.error and fresh
        last = None
        if not known and self.heard > -math.inf:
            last = round(self._wall() - (self._clock() - self.heard))
        torques = self.torques()
        faults = [f"servo {i}: {', '.join(row.faults)}" for i, row in sorted(self.live.items()) if row.faults]
        silent = [str(i) for i, row in sorted(self.live.items()) if row.error]
        if silent:
            faults.append(f"servo {', '.join(silent)}: silent")
        overhead = self.bus.timing.overhead
        return {
            "robot": "servo bus",
            "url": self.bus.link.url,
            "connected": not self.error,
            "known": known,
            "last": last,
            "missing": [],
            "unready": "",
            "error": self.error,
            "dialect": 0,
            "rate": 1 / _PERIOD if bench.servo_ids and known else None,
            "baud": self.bus.timing.baud,
            "round_trip_ms": round(1000.0 * overhead, 2) if known and math.isfinite(overhead) else None,
            "faults": faults if known else None,
            "holder": holder.client if holder is not None else "",
            "stopped": bench.why_stopped or "latched" if bench.stopped else "",
            "stops": self.stops,
            "torque": torque_words(torques) if bench.servo_ids else "–",
            "job": "" if job is None else f"{job.what}: {job.told}" if job.told else job.what,
            "share": None if job is None or math.isnan(job.share) else round(job.share, 3),
            "note": "",
            "uncalibrated": "",
        }

    def row(self) -> dict[str, object]:
        """The bus in a list of arms, for JSON, as `hexwire.fleet.overview.Overview`."""
        facts = self.facts()
        heard = self.heard > -math.inf
        return {
            "name": self.name,
            "robot": "servo bus",
            "host": "",
            "holder": facts["holder"],
            "torque": self.torques().short if self.bench.servo_ids else "",
            "stopped": bool(facts["stopped"]),
            "why": facts["error"] or facts["stopped"],
            "age": max(0.0, self._clock() - self.heard) if heard else None,
            "silent": not facts["known"],
            "known": facts["known"],
            "faults": "; ".join(cast(list[str], facts["faults"] or [])),
        }

    def shutdown(self) -> None:
        """End what is done, and close the bus; the servos keep their torque."""
        self._ending.set()
        self.bench.shutdown()
        self._reader.join()
        self.bus.close()


def live_row(row: LiveValues) -> dict[str, object]:
    """Live values for JSON, which knows no NaN: degrees, degrees per second, percent, volts, amperes."""
    values = {
        "counts": row.counts,
        "deg": math.degrees(row.position),
        "speed": math.degrees(row.speed),
        "load": 100 * row.load,
        "volts": row.voltage,
        "celsius": row.temperature,
        "amps": row.current,
    }
    known = {
        name: None if value is None or not math.isfinite(value) else round(value, 3)
        for name, value in values.items()
    }
    return {"id": row.servo_id, **known, "faults": list(row.faults), "error": row.error}
