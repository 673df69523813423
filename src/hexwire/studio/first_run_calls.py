"""The first run of an arm on a page: which run there is, and what pages ask and are told of it.

Owns the one run of this studio, what is open for each of its steps, and the messages. What the steps are, and what
each needs, is decided by `hexwire.setup.first_run`; measuring and storing are those of the page Servos. Every page
sees the run; only the page with control goes on with it.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from hexwire.drivers.abilities import BareServos
from hexwire.drivers.registry import load_bus_arm, load_driver, robot_at, robot_names
from hexwire.drivers.stored_calibration import stored_calibration
from hexwire.errors import HexwireError, UsageError
from hexwire.inputs import Item
from hexwire.link.url import parse_url
from hexwire.model.arms import assembled_arms, record_of
from hexwire.model.state import JointFlag
from hexwire.setup.calibrating import store
from hexwire.setup.first_run import FirstRun, FoundJoint, Stage

from .access import Right
from .calls import Arguments, Asked, CallHost, call
from .geometry import make_geometry
from .present_calls import read_address
from .servos.calibration_run import CalibrationRun, calibration_values

if TYPE_CHECKING:
    from hexwire.control.motion.hold_to_run import HeldMotion
    from hexwire.epochs import Token
    from hexwire.model.arm import ArmModel
    from hexwire.model.calibration import Calibration
    from hexwire.model.state import JointState

    from .bus_source import BusSource
    from .source import ArmSource
    from .tabs import Tab

__all__ = ["FirstRuns"]

_TELL = 0.1
"""Seconds between two messages about what a hand moves."""
_NONE = "no first run was begun, or something else was opened; begin again"
_BUSY = "the first run is busy; wait a moment"
_LONGEST = 100
"""Letters of a joint's name."""


class FirstRuns:
    """The first run of one studio. Any thread may call its methods; most of them wait.

    Args:
        studio: The studio.
    """

    def __init__(self, studio: CallHost) -> None:
        self._studio, self._source = studio, studio.source
        self._run: FirstRun | None = None
        self._robot = ""
        # What is open for the run; see `Source.opened`.
        self._opened = -1
        self._lock = threading.Lock()
        self._measuring: CalibrationRun | None = None
        self._followed: ArmSource | None = None
        # What is open is being changed for the run itself.
        self._switching = False
        studio.holds.add("first", self._begin_step)

    # -- what pages are told ------------------------------------------------------------------------------

    def values(self) -> dict[str, Any]:
        """Where the run is, for JSON; without ``stage`` if there is none."""
        run = self._present
        if run is None:
            return {"kind": "first"}
        told, present, measuring = run.told, self._source.present, self._measuring
        url = "" if present is None else str(present.facts()["url"])
        return {
            "kind": "first",
            "robot": self._robot,
            "url": url,
            "hand": _hand_port(url),
            "bare": run.bare,
            "stage": told.stage.name.lower(),
            "title": told.stage.value,
            "text": told.text,
            "next": told.next,
            "missing": told.missing,
            "joint": told.joint,
            "joints": list(run.model.names),
            "rows": list(told.rows),
            "measuring": measuring is not None,
            "middle": measuring is not None and measuring.hand.needs_middle,
            "endless": [] if measuring is None else list(measuring.hand.endless),
            "measured": None if run.measured is None else calibration_values(run.measured),
            "undo": run.former is not None,
        }

    def _tell(self) -> None:
        self._studio.live.tell(self.values)

    @property
    def _present(self) -> FirstRun | None:
        """The run, unless something else was opened meanwhile."""
        return self._run if self._switching or self._opened == self._source.opened else None

    @contextmanager
    def changing(self) -> Iterator[FirstRun]:
        """Change the run for a `with` block; all pages are told afterwards.

        Raises:
            UsageError: There is none, or it is being changed.
        """
        if not self._lock.acquire(blocking=False):
            raise UsageError(_BUSY)
        try:
            run = self._present
            if run is None:
                raise UsageError(_NONE)
            yield run
        finally:
            self._lock.release()
            self._tell()

    # -- beginning and going on -----------------------------------------------------------------------------

    def begin(self, tab: Tab, url: str, robot: str) -> None:
        """Open an arm for a first run, or begin one with what is open if there is no address.

        Raises:
            HexwireError: It cannot be opened.
        """
        with self._beginning():
            robot = self._open(tab, url, robot)
            bare = self._source.bus is not None
            arm = self._source.arm
            model = load_bus_arm(robot).described().model if arm is None else arm.settings.model
            run = FirstRun(model, bare=bare)
            self._look(run)
            # Only now: before, a page would be told that nothing is missing.
            self._run, self._robot, self._opened = run, robot, self._source.opened
            if arm is not None:
                self._follow(arm)

    @contextmanager
    def _beginning(self) -> Iterator[None]:
        if not self._lock.acquire(blocking=False):
            raise UsageError(_BUSY)
        try:
            yield
        finally:
            self._lock.release()
            self._tell()

    def _open(self, tab: Tab, url: str, robot: str) -> str:
        """Open what the first step needs, and give the tab control of it; the name of the robot."""
        studio, source = self._studio, self._source
        if url:
            robot = robot or robot_at(url)
            record = record_of(robot)
            if record is not None and record.assembly is not None:
                studio.open_bus(tab, url)
            else:
                studio.open(tab, url, robot)
                studio.take(tab)
            return robot
        studio.take(tab)
        arm = source.arm
        if arm is None:
            return robot if robot in assembled_arms() else self._likely(source.need_bus())
        robot = arm.settings.model.kind
        if BareServos.find(arm.driver) is not None and robot in assembled_arms():
            studio.open_bus(tab)
        return robot

    @staticmethod
    def _likely(bus: BusSource) -> str:
        """The arm whose servos are on a bus."""
        for name in assembled_arms():
            model = load_bus_arm(name).described().model
            if {joint.servo_id for joint in model.joints} <= set(bus.bench.servo_ids):
                return name
        raise UsageError("choose which arm this is")

    def _look(self, run: FirstRun) -> None:
        """Find out what answers, and what the servos have stored."""
        if run.bare:
            bus = self._source.need_bus()
            bus.search((), [joint.servo_id for joint in run.model.joints])
            rows = [_servo_of(bus, joint.name, joint.servo_id) for joint in run.model.joints]
            run.identified(rows, f"The servos of an arm at {bus.bus.link.url}.")
            if not any(row.fault for row in rows):
                run.examined(stored_calibration(bus.bus, run.model))
            return
        arm = self._source.need_arm()
        report = arm.ask("probe", arm.shared.probe)
        firmware = f", firmware {report.firmware}" if report.firmware else ""
        what = f"A {run.model.name} at {arm.driver.url}{firmware}."
        if report.unprotected:
            what += f" It has {report.unprotected}."
        rows = [
            FoundJoint(row.name, row.servo_id, row.remarks or "answers", "" if row.present else "does not answer")
            for row in report.joints
        ]
        run.identified(rows, what)

    def again(self) -> None:
        """Look again at what the present step is about. Nothing is written."""
        with self.changing() as run:
            if run.stage is Stage.JOG or run.stage is Stage.DONE:
                return
            run.measured = None
            self._look(run)
            run.forget_seen()

    def forward(self, tab: Tab) -> None:
        """Go on; the arm is opened for the first jog."""
        with self.changing() as run:
            self._refuse_while_measuring()
            run.forward()
            if run.stage is Stage.RANGES:
                run.forget_seen()
            if run.stage is Stage.JOG and self._source.bus is not None:
                try:
                    with self._switch():
                        self._open_arm(tab)
                except HexwireError:
                    run.back()
                    raise

    def back(self, tab: Tab) -> None:
        """Go back a step; the servos are opened again where the arm was open."""
        with self.changing() as run:
            self._refuse_while_measuring()
            was = run.stage
            run.back()
            if was is Stage.JOG and run.bare:
                with self._switch():
                    self._studio.open_bus(tab)
                    self._opened = self._source.opened
                self._look(run)

    @contextmanager
    def _switch(self) -> Iterator[None]:
        """Change what is open for a `with` block; pages go on seeing the run."""
        self._switching = True
        try:
            yield
        finally:
            self._switching = False

    def _open_arm(self, tab: Tab) -> None:
        studio = self._studio
        studio.need_control(tab)
        arm = self._source.open_arm_of_bus(self._robot, **studio.settings)
        self._opened = self._source.opened
        studio.take(tab)
        self._follow(arm)

    def leave(self) -> None:
        """End the run where it is: what is open stays so, torque stays as it is, nothing is stored."""
        if (measuring := self._measuring) is not None and self._source.bus is not None:
            self._source.bus.bench.cancel()
            measuring.finish()
        self._run = None
        self._tell()

    def _refuse_while_measuring(self) -> None:
        if self._measuring is not None:
            raise UsageError("finish or cancel the calibration first")

    # -- by hand --------------------------------------------------------------------------------------------

    def measure(self) -> None:
        """Switch torque off, and follow the joints until it is finished, cancelled or stopped.

        Raises:
            HexwireError: It was cancelled or stopped, or a servo fails. Nothing was stored.
        """
        with self.changing() as run:
            self._refuse_while_measuring()
            run.may_measure()
            run.measured = None
            bus = self._source.need_bus()
            self._measuring = mine = CalibrationRun(self._studio, bus, None, self._robot)
        try:
            mine.work()
        finally:
            self._measuring = None
            self._tell()
        with self.changing() as run:
            run.may_measure()
            run.measured = mine.found

    def middle(self) -> None:
        """The joints without stops are in their middle now."""
        measuring = self._need_measuring()
        if not measuring.mark_middle():
            names = " and ".join(measuring.hand.endless)
            raise UsageError(f"{names} does not report its position: check its cable, then try again")
        self._tell()

    def finish(self, *, sure: bool) -> str:
        """Let `measure` end with what was seen.

        Args:
            sure: Also if joints have moved less than they usually can.

        Returns:
            What is missing, if it goes on for that reason; else empty.

        Raises:
            UsageError: A joint was not moved, or has no middle yet.
        """
        measuring = self._need_measuring()
        hand = measuring.hand
        if blocked := [row for row in hand.progress if row.name in hand.unmoved]:
            joints = "; ".join(f"{row.name} {row.missing}" for row in blocked)
            raise UsageError(f"not measured yet: {joints}")
        missing = "; ".join(f"{row.name} {row.missing}" for row in hand.missing)
        if missing and not sure:
            return missing
        measuring.finish()
        return ""

    def _need_measuring(self) -> CalibrationRun:
        if self._measuring is None:
            raise UsageError("no calibration is under way")
        return self._measuring

    def store(self) -> None:
        """Write what was measured to the servos, with a check of each value; all or none."""
        with self.changing() as run:
            run.may_measure()
            if run.measured is None:
                raise UsageError("measure the ranges first")
            bus = self._source.need_bus()
            self._write(run, bus, run.measured, "storing a calibration")

    def undo(self) -> None:
        """Write to the servos what they had before `store`."""
        with self.changing() as run:
            run.may_measure()
            if run.former is None:
                raise UsageError("nothing was stored here that could be taken back")
            self._write(run, self._source.need_bus(), run.former, "taking a calibration back")
            run.was_undone()

    @staticmethod
    def _write(run: FirstRun, bus: BusSource, calibration: Calibration, what: str) -> None:
        with bus.bench.working(what, acts=True):
            former = stored_calibration(bus.bus, run.model)
            try:
                store(bus.bus, calibration)
            except HexwireError:
                # Going on with what they had before would open the arm with angles that are wrong.
                run.may_be_changed()
                with suppress(HexwireError):
                    run.examined(stored_calibration(bus.bus, run.model))
                raise
            if calibration is run.measured:
                run.was_stored(former)
            run.examined(stored_calibration(bus.bus, run.model))

    # -- an open arm ----------------------------------------------------------------------------------------

    def _follow(self, arm: ArmSource) -> None:
        """Tell pages what a hand moves, while a run shows the ranges of this arm."""
        if self._followed is arm:
            return
        self._followed = arm
        told = -math.inf

        def follow(state: JointState, goals: Mapping[str, float]) -> None:
            nonlocal told
            run = self._present
            if run is None or run.stage is not Stage.RANGES or self._source.arm is not arm:
                return
            limp = {joint.name: joint.position for joint in state if not joint.flags & JointFlag.TORQUE_ON}
            run.seen(limp)
            now = arm.arm.owner.now()
            if now - told >= _TELL:
                told = now
                self._studio.live.tell({"kind": "range", "rows": _ranges_of(run)})

        arm.listeners = (*arm.listeners, follow)

    def _begin_step(self, tab: Tab, entry: HeldMotion, args: Mapping[str, object], arrived: Token) -> None:
        """Begin a step of the first jog, which a page holds."""
        row = Item(args).table(("joint", "way"), ())
        run, arm = self._present, self._source.need_arm()
        if run is None:
            raise UsageError(_NONE)
        name, state = row["joint"].text(_LONGEST), arm.arm.owner.state
        way = row["way"].integer(-1, 1)
        request = run.jog(name, way, torque=name in arm.torques().holding)
        before = state.positions.get(name, math.nan) if state is not None else math.nan

        def ended() -> None:
            now = arm.arm.owner.state
            run.jogged(name, (now.positions.get(name, math.nan) if now is not None else math.nan) - before)
            self._tell()

        arm.begin_run(tab, entry, request, arrived, ended)


def _hand_port(url: str) -> str:
    """The port for `hexwire sim hand` of an arm that is emulated in this program; empty for others."""
    if not url.startswith("sim://"):
        return ""
    found = parse_url(url)
    name = found.query.get("name", "")
    return f"sim://{found.netloc}?name={name}" if name else f"sim://{found.netloc}"


def _servo_of(bus: BusSource, name: str, servo_id: int) -> FoundJoint:
    found = bus.find(servo_id)
    if found is None or found.found.info is None:
        return FoundJoint(name, servo_id, fault="does not answer" if found is None else "tells nothing of itself")
    info = found.found.info
    words = [info.model_name or "unknown model"]
    words += [f"firmware {info.firmware}"] if info.firmware else []
    words += [f"supply {found.supply:.1f} V"] if math.isfinite(found.supply) else []
    bad = [remark.text for remark in found.remarks if remark.bad and found.found.shared]
    remarks = tuple(remark.text for remark in found.remarks if remark.text not in bad)
    return FoundJoint(name, servo_id, ", ".join(words), "; ".join(bad), remarks)


def _ranges_of(run: FirstRun) -> list[dict[str, object]]:
    """What a hand has moved, for JSON: degrees."""
    return [
        {
            "name": row.name,
            "low": _degrees(row.low),
            "now": _degrees(row.position),
            "high": _degrees(row.high),
            "usual": _degrees(row.usual),
            "missing": row.missing,
        }
        for row in run.progress
    ]


def _degrees(angle: float) -> float | None:
    return round(math.degrees(angle), 1) if math.isfinite(angle) else None


# -- calls of pages -----------------------------------------------------------------------------------------


class _Arm(Arguments, frozen=True):
    url: str = ""
    robot: str = ""


class _Finish(Arguments, frozen=True):
    sure: bool = False


class _Robot(Arguments, frozen=True):
    robot: str


def _runs(asked: Asked) -> FirstRuns:
    runs = asked.studio.first
    assert isinstance(runs, FirstRuns)
    return runs


@call("first.look", Arguments)
def _look(asked: Asked, args: Arguments) -> dict[str, Any]:
    """Where the first run is."""
    return _runs(asked).values()


@call("first.shape", _Robot)
def _shape(asked: Asked, args: _Robot) -> dict[str, Any] | None:
    """What an arm looks like, for the 3D view: the one that is open, or else one of its kind; None if unknown."""
    arm = asked.studio.source.arm
    if arm is not None and arm.settings.model.kind == args.robot:
        return make_geometry(arm.settings.model, arm.settings.links)
    return make_geometry(_model_of(args.robot))


def _model_of(robot: str) -> ArmModel:
    if robot not in robot_names():
        raise UsageError(f"there is no robot {robot[:20]!r}")
    # The model does not depend on the port, which is not opened.
    return load_driver(robot).from_url("/dev/null").model


@call("first.begin", _Arm, right=Right.OPERATE)
def _begin(asked: Asked, args: _Arm) -> None:
    """Open an arm for a first run, or begin one with what is open."""
    _runs(asked).begin(asked.tab, read_address(args.url), args.robot)


@call("first.again", Arguments, control=True)
def _again(asked: Asked, args: Arguments) -> None:
    _runs(asked).again()


@call("first.next", Arguments, control=True)
def _next(asked: Asked, args: Arguments) -> None:
    _runs(asked).forward(asked.tab)


@call("first.back", Arguments, control=True)
def _back(asked: Asked, args: Arguments) -> None:
    _runs(asked).back(asked.tab)


@call("first.leave", Arguments, control=True)
def _leave(asked: Asked, args: Arguments) -> None:
    _runs(asked).leave()


@call("first.measure", Arguments, control=True)
def _measure(asked: Asked, args: Arguments) -> None:
    _runs(asked).measure()


@call("first.middle", Arguments, control=True)
def _middle(asked: Asked, args: Arguments) -> None:
    _runs(asked).middle()


@call("first.finish", _Finish, control=True)
def _finish(asked: Asked, args: _Finish) -> str:
    """Finish measuring; if something is missing and the page is not sure, what that is."""
    return _runs(asked).finish(sure=args.sure)


@call("first.store", Arguments, control=True)
def _store(asked: Asked, args: Arguments) -> None:
    _runs(asked).store()


@call("first.undo", Arguments, control=True)
def _undo(asked: Asked, args: Arguments) -> None:
    _runs(asked).undo()
