"""An arm that is open in the studio: its owner, its lease, the motion that somebody holds, its facts.

Owns joining them. Its calls block; any thread may make them. Must not know pages or sockets.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar, cast

from hexwire.bus.health import HealthHistory
from hexwire.bus.live_values import LiveValues
from hexwire.control.loop.holding import SOON, hold_moving
from hexwire.control.loop.known_state import known_joints
from hexwire.control.loop.power import Stopped, Torques
from hexwire.control.motion.hold_to_run import SILENCE, HeldMotion, HoldToRun, silence_for
from hexwire.control.motion.jog import JogController, read_request
from hexwire.control.requests.controlled_arm import ControlledArm
from hexwire.control.requests.history import History
from hexwire.control.requests.leader import Leader, read_following
from hexwire.control.requests.motion_service import MotionService
from hexwire.control.requests.pose_file import PoseFile
from hexwire.control.requests.setting import Faults
from hexwire.control.requests.settings_reader import read_settings
from hexwire.control.sharing.lease import Lease
from hexwire.control.sharing.shared import Order, SharedArm
from hexwire.drivers.abilities import Counters, Leased, StoredCalibration
from hexwire.drivers.values import StopMode
from hexwire.errors import HexwireError, LinkLostError, StoppedError, UsageError
from hexwire.model.state import JointFlag

from .frames import FrameBit, serialize_frame

if TYPE_CHECKING:
    from hexwire.bus.backup import ServoBackup
    from hexwire.bus.registers import Edit
    from hexwire.control.motion.held_following import HeldFollowing
    from hexwire.control.motion.motion_run import MotionRun
    from hexwire.control.sharing.lease import Grant
    from hexwire.drivers.base import RobotDriver
    from hexwire.epochs import Token
    from hexwire.model.arm import ArmModel
    from hexwire.model.state import JointState, SentTarget
    from hexwire.motion.teach import Taught

    from .tabs import Tab

__all__ = ["ArmSource", "live_values", "torque_words", "unready"]

_log = logging.getLogger(__name__)

_BRAKES, _LOOK = 1.0, 0.005
"""Seconds for which joints may brake, and between two looks at them."""
_SILENT = 1.0
"""Seconds of silence of a servo after which its joint does not begin to follow."""
_LOOKS = 0.2
"""Seconds between two samples of the health of the servos, as on a bare bus."""
_FRESH = 2.0
"""Seconds for which an answer of the robot is passed on, so that questions of pages cannot keep its line busy."""
_TORQUE_ON = int(JointFlag.TORQUE_ON)
"""As a plain number, which costs a tenth of a flag in each frame."""
_T = TypeVar("_T")


class ArmSource:
    """An arm that is open: its owner, its lease, and the motion that somebody holds.

    Args:
        settings: Its settings, checked.
        driver: Not attached.
        silence: Seconds without a sign of life after which what somebody holds ends.
        wall: Seconds since 1970.

    Attributes:
        settings: The settings of the arm.
        driver: The driver of the arm.
        arm: The arm.
        shared: The arm with its lease.
        hold_to_run: What somebody holds.
        jog: Moves joints while somebody holds a button.
        goals: Last set-point of each joint, radians.
        motions: Motions to a goal, poses, teach mode.
        leader: The arm that this one may follow; None if there is none.
        history: The last ten minutes.
        health: What its servos measured in the last ten minutes.
        edits: Edits of registers that can be undone, with their joints; those of a restore together.
        backups: Backups of stored settings, to compare with.
        written: How often registers were written.
        listeners: Called with each state and the goals, in the owner's thread; they must not wait.
    """

    def __init__(
        self, settings: Any, driver: RobotDriver, silence: float = SILENCE, wall: Callable[[], float] = time.time
    ) -> None:
        self.driver, self.settings, self._wall = driver, settings, wall
        self.goals: dict[str, float] = {}
        self.history = History(settings.model.names)
        self.listeners: tuple[Callable[[JointState, Mapping[str, float]], object], ...] = ()
        self.arm = ControlledArm(driver, settings, monitored=False, on_sent=self._sent)
        self.shared = SharedArm(self.arm, Lease(timeout=5.0))
        owner = self.arm.owner
        owner.observe(self._keep)
        self.edits: list[tuple[str, tuple[Edit, ...]]] = []
        self.backups: list[ServoBackup] = []
        self.health, self._looked = HealthHistory(), -math.inf
        self.written = 0
        self._silence = silence
        self.hold_to_run = HoldToRun(silence=silence, clock=owner.now)
        self.jog = JogController(settings.model, settings.kinematics, self.shared.path_check, silence=silence)
        self.motions = MotionService(self.shared, PoseFile(settings.model))
        self.leader: Leader | None = None
        self._following: HeldFollowing | None = None
        self._choosing, self._closed = threading.Lock(), False
        self._asking = threading.Lock()
        self._answers: dict[str, tuple[float, Any, HexwireError | None]] = {}
        # Ends what was held, so that no thread that hears of an end waits for the line.
        self._ender = ThreadPoolExecutor(1, "end of a hold")

    @property
    def uncalibrated(self) -> str:
        """Why its angles may be wrong, as its servos said when it was opened; empty if they may not."""
        arm = StoredCalibration.find(self.driver)
        return "" if arm is None else arm.doubt

    def _sent(self, sent: SentTarget) -> None:
        self.goals.update(sent.positions)

    def _trips(self) -> Sequence[float]:
        counters = Counters.find(self.driver)
        return () if counters is None else counters.round_trips

    def _keep(self, state: JointState) -> None:
        owner, trips = self.arm.owner, self._trips()
        self.history.append(state, self.goals, rate=owner.rate, round_trip=trips[-1] if trips else math.nan)
        if state.stamp - self._looked >= _LOOKS:
            self._looked = state.stamp
            self.health.add(time.monotonic(), live_values(self.settings.model, state))
        for listener in self.listeners:
            listener(state, self.goals)

    @property
    def stops(self) -> int:
        """The number of the last stop, by anybody; see `Epochs.number`."""
        return self.driver.epochs.number

    def start(self) -> None:
        """Connect and start; raises as `ControlledArm.connect`."""
        self.arm.connect()
        self._silence = silence_for(self.arm.owner.command_period, self._silence)
        self.hold_to_run.silence = self.jog.silence = self._silence
        self.arm.start()
        owner = self.arm.owner
        with owner.locked():
            owner.group.members = (*owner.group.members, self.jog)
        self.shared.start()

    def shutdown(self) -> None:
        """Stop a motion, and detach; the joints keep their torque."""
        self._closed = True
        self.hold_to_run.end_all("the arm was closed")
        try:
            self.shared.shutdown()
        except HexwireError as error:
            _log.error("the stop was not confirmed: %s", error)
        finally:
            self._ender.shutdown()
            self.arm.shutdown()
            self.forget_leader()
            # Some MB, which would else be kept until a full pass of the collector.
            self.history = History(self.settings.model.names)

    def mark(self) -> Token:
        """The time of an order, relative to stops."""
        return self.driver.epochs.mark()

    def stopped_since(self, arrived: Token) -> bool:
        """Whether the arm was stopped since an order, see `mark`."""
        return self.driver.epochs.stopped_since(arrived)

    @property
    def holder(self) -> Grant | None:
        """Who has control, or None."""
        return self.shared.holder

    def beat(self, key: int) -> None:
        """Renew the control of a tab; raises `LeaseError` if it is lost."""
        self.shared.beat(key, 0.0)

    def stop(self, why: str) -> Stopped:
        """Stop the arm, and say what it does then; raises `HexwireError` if the stop cannot be sent."""
        began = time.monotonic()
        confirmed = self.shared.stop(why)
        seconds = time.monotonic() - began
        missing = [name for name in self.settings.model.names if name not in confirmed]
        error = f"not confirmed by {', '.join(missing)}" if missing else ""
        torques = self.arm.torques().after_stop(confirmed, StopMode.HOLD)
        return Stopped(self.name, not missing, confirmed, error, seconds, torques=torques)

    @property
    def name(self) -> str:
        """Its robot and address, for lists of several arms."""
        return f"{self.settings.model.name} at {self.driver.url}"

    def leave(self, tab: Tab, grant: int) -> None:
        """Take control back from a tab; what moves holds."""
        self.hold_to_run.end(tab.key, "control was given back")
        # First: else the end of the lease overtakes it, and the motion's outcome blames the lease.
        self._settle()
        self.shared.leave(grant, finish=False)
        if self.shared.holder is None:
            self.release()

    def release(self) -> None:
        """Give the lease of an arm that another program serves back, so that others there can command it."""
        try:
            if (leased := Leased.find(self.driver)) is not None:
                leased.release()
        except HexwireError as error:
            _log.warning("the lease was not given back: %s", error)

    def order(self, tab: Tab, arrived: Token | None = None) -> Order:
        """An order of a tab, for the calls of `SharedArm`."""
        return Order(tab.grant, tab.next_number(), arrived or self.driver.epochs.mark())

    # -- holds ------------------------------------------------------------------------------------------

    def begin_jog(self, tab: Tab, entry: HeldMotion, kind: str, args: Mapping[str, object], arrived: Token) -> None:
        """Begin a jog that was announced to `hold_to_run`.

        Raises:
            HexwireError: It is refused; nothing moves.
        """
        request = read_request(kind, args, self.settings.model)
        order = self.order(tab, arrived)
        self.shared.admit(order)
        self._settle()
        now = self.arm.owner.now
        self._take_over(
            order, entry, "a jog", lambda state: self.jog.begin(request, lambda: entry.age(now()), state)
        )
        self.hold_to_run.begun(entry, lambda why: self._ender.submit(self._end_held, self.jog, why))

    def _take_over(self, order: Order, entry: HeldMotion, what: str, begin: Callable[[JointState], object]) -> None:
        """Let a controller that follows a person take the joints over, from where they rest.

        Args:
            order: Admitted.
            entry: Of what the person holds.
            what: In words, as in ``a jog``.
            begin: Begins, or raises; called with the newest state and the controllers' lock.
        """
        owner, why = self.arm.owner, f"{what} was begun"
        if owner.lead <= SOON:
            # What moves brakes within its limits; this begins where the joints rest.
            owner.group.brake(why)
            self._await(lambda: not any(one.brakes(owner.now()) for one in self.arm.controllers.values()))
        owner.settle(why)
        with owner.locked():
            self.shared.path_check.stop_latch(owner.group.reason)
            state = owner.newest()
            if not self.shared.is_wanted(order) or entry.ended:
                raise StoppedError.unsent(what, 0, "it was released or stopped meanwhile")
            owner.group.release(why)
            begin(state)
        owner.group.deliver()
        owner.hurry()

    def begin_follow(self, tab: Tab, entry: HeldMotion, args: Mapping[str, object], arrived: Token) -> None:
        """Begin to follow the leader; raises as `begin_jog`, and as `Leader.release`."""
        request = read_following(args)
        order = self.order(tab, arrived)
        self.shared.admit(order)
        self._settle()
        leader, owner, now = self.need_leader(), self.arm.owner, self.arm.owner.now
        following = leader.following(
            request,
            lambda: entry.age(now()),
            self._silence,
            lambda why: self.hold_to_run.end(entry.who, why, entry.number),
        )
        # First: a leader that nobody will follow must not fall.
        self.shared.path_check.stop_latch(owner.group.reason)
        self.shared.path_check.ready(following.joints, owner.newest(), _SILENT)
        if not self.shared.is_wanted(order) or entry.ended:
            raise StoppedError.unsent("following", 0, "it was released or stopped meanwhile")
        leader.release(arrived)

        def begin(state: JointState) -> None:
            self.shared.path_check.ready(following.joints, state, _SILENT)
            owner.group.members = (*owner.group.members, following)
            self._following = following

        self._take_over(order, entry, "following", begin)
        self.hold_to_run.begun(entry, lambda why: self._ender.submit(self._end_follow, following, why))

    def _end_follow(self, following: HeldFollowing, why: str) -> None:
        owner = self.arm.owner
        try:
            self._end_held(following, why)
        finally:
            with owner.locked():
                following.release(why)
                owner.group.members = tuple(one for one in owner.group.members if one is not following)
            self._following = None

    def begin_run(
        self,
        tab: Tab,
        entry: HeldMotion,
        args: Mapping[str, object],
        arrived: Token,
        on_end: Callable[[], object] = lambda: None,
        *,
        taught: Taught | None = None,
    ) -> None:
        """Begin a motion to a goal that was announced to `hold_to_run`; see `MotionService.begin`.

        Args:
            tab: Whose motion it is.
            entry: Of the motion.
            args: As for the motion service.
            arrived: When it was asked for.
            on_end: Called when it has ended; must not wait.
            taught: What is played instead of the last taught motion.

        Raises:
            HexwireError: It is refused; nothing moves.
        """
        self._settle()

        def ended(run: MotionRun) -> None:
            self.hold_to_run.end(entry.who, run.progress().text or "arrived", entry.number)
            on_end()

        now = self.arm.owner.now
        run = self.motions.begin(
            lambda: self.order(tab, arrived),
            args,
            wanted=lambda: not entry.ended,
            age=lambda: entry.age(now()),
            silence=self._silence,
            on_end=ended,
            taught=taught,
        )
        self.hold_to_run.begun(entry, lambda why: self._ender.submit(run.end, why))

    def _settle(self) -> None:
        """Wait until what was held before has ended, so that its end does not end what is begun now."""
        self._ender.submit(lambda: None).result()

    def _end_held(self, controller: JogController | HeldFollowing, why: str) -> None:
        owner = self.arm.owner
        # It has seen its end itself, and brakes or holds; on a slow line a target lasts too long to wait for that.
        if owner.lead <= SOON:
            self._await(lambda: not controller.busy)
        # A stop, or the loss of the arm, has ended it, too.
        if controller.busy:
            with owner.deciding():
                hold_moving(owner, why)

    def _await(self, found: Callable[[], bool]) -> None:
        """Wait while joints brake, for as long as that takes at most."""
        until = time.monotonic() + _BRAKES
        while not found() and self.arm.owner.connected and time.monotonic() < until:
            time.sleep(_LOOK)

    def update_jog(self, kind: str, args: Mapping[str, object]) -> None:
        """Change what is held; raises as `JogController.update`."""
        request = read_request(kind, args, self.settings.model)
        with self.arm.owner.locked():
            self.jog.update(request)

    # -- the leader -------------------------------------------------------------------------------------

    def choose_leader(self, url: str, robot: str = "", *, mirror: bool = False) -> None:
        """Connect to an arm that this one may follow, in place of the one before. Nothing moves. Blocks.

        Args:
            url: Port or address.
            robot: Its name, or the file of a calibrated arm, if the address does not say it.
            mirror: The two arms face each other.

        Raises:
            UsageError: It cannot lead this arm.
            HexwireError: It cannot be opened.
        """
        if not url:
            raise UsageError("name the port or the address of the leader")
        given: dict[str, object] = {"port": url, "connect_timeout": 0.0} | ({"robot": robot} if robot else {})
        self.forget_leader()
        with self._choosing:
            made = Leader(read_settings(given, Faults())[1], self.arm, mirror=mirror)
            if self._closed:
                raise LinkLostError("this arm was closed; load the page again")
            made.open()
            former, self.leader = self.leader, made
        if former is not None:
            former.close()

    def forget_leader(self) -> None:
        """Disconnect the leader; what follows it holds. Blocks."""
        with self._choosing:
            leader, self.leader = self.leader, None
        if leader is None:
            return
        if self._following is not None:
            self.hold_to_run.end_all("its leader was disconnected")
        leader.close()

    def need_leader(self) -> Leader:
        """The leader.

        Raises:
            UsageError: None is connected.
        """
        if self.leader is None:
            raise UsageError("no leader is connected; connect one first")
        return self.leader

    # -- facts ------------------------------------------------------------------------------------------

    def frame(self, state: JointState) -> bytes:
        """The bytes of a frame of state."""
        owner = self.arm.owner
        known = self._known(state)
        bits = FrameBit(0)
        if state.stopped or owner.group.reason is not None:
            bits |= FrameBit.STOPPED
        if state.watchdog_tripped or self.shared.tripped:
            bits |= FrameBit.WATCHDOG_TRIPPED
        if state.maintenance:
            bits |= FrameBit.MAINTENANCE
        if known:
            bits |= FrameBit.KNOWN
        if self.hold_to_run.entry is not None:
            bits |= FrameBit.HELD
        for name, row in zip(state.names, state.flags, strict=True):
            if not row & _TORQUE_ON:
                # When it gets torque again, it holds where it is then.
                self.goals.pop(name, None)
        if len(known) < len(state):
            silent = (0 if name in known else int(JointFlag.SILENT) for name in state.names)
            flags = tuple(bits | more for bits, more in zip(state.flags, silent, strict=True))
            state = replace(state, flags=flags)
        return serialize_frame(state, self.goals, bits, self.stops)

    def _known(self, state: JointState | None) -> tuple[str, ...]:
        """The joints of which a page may say what they do now."""
        owner = self.arm.owner
        # What was true before the link was lost may be wrong now.
        return known_joints(state if owner.connected else None, owner.now())

    def facts(self) -> dict[str, object]:
        """What is always in sight, for JSON."""
        owner, driver = self.arm.owner, self.driver
        state, names = owner.state, self.settings.model.names
        known = self._known(state)
        missing = [name for name in names if name not in known]
        probe = owner.probe if known else None
        trips, leased = self._trips() if known else (), Leased.find(driver)
        reason, taught = owner.group.reason, self.motions.taught
        flags = {joint.name: joint.flags for joint in state or ()}
        found = {name: flags[name].faults if name in known else JointFlag.SILENT for name in names}
        torques = self.torques()
        latched = state is not None and bool(known) and state.stopped
        last = None
        if state is not None and not known:
            # Whole seconds, so that it does not change: the two clocks are not read at once.
            last = round(self._wall() - (owner.now() - state.stamp))
        return {
            "robot": self.settings.model.name,
            "url": driver.url,
            "connected": owner.connected,
            "error": "" if owner.connected else owner.error,
            "dialect": probe.dialect if probe is not None else 0,
            "known": bool(known),
            "last": last,
            "missing": missing,
            "unready": unready(owner.connected, owner.error, known, missing),
            "rate": round(owner.rate, 1) if known and math.isfinite(owner.rate) else None,
            "round_trip_ms": round(1000.0 * trips[-1], 2) if trips else None,
            "faults": [f"{name}: {fault}" for name, fault in found.items() if fault] if known else None,
            # That of an arm which another program serves, if nobody here has control.
            "holder": self.shared.holder_name or ("" if leased is None else leased.holder),
            "lost": self.shared.held,
            "stopped": str(reason) if reason is not None else "latched" if latched else "",
            "stops": self.stops,
            "torque": torque_words(torques),
            "note": self._note(),
            "uncalibrated": self.uncalibrated,
            "teaching": self.motions.teaching,
            "taught": None if taught is None else f"{len(taught.times)} rows, {taught.duration} s",
        }

    def _note(self) -> str:
        following = self._following
        if following is not None and not following.ended:
            return following.note
        return self.jog.note if self.hold_to_run.entry is not None else ""

    def ask(self, what: str, call: Callable[[], _T]) -> _T:
        """Ask the robot for a page; one answer is for all pages that ask within two seconds. Blocks.

        Args:
            what: Of what is asked; equal for equal questions.
            call: Asks; its error is that of all, too.
        """
        clock = self.arm.owner.now
        with self._asking:
            when, found, error = self._answers.get(what, (-math.inf, None, None))
            if clock() - when > _FRESH:
                found = error = None
                try:
                    found = call()
                except HexwireError as failed:
                    error = failed
                self._answers[what] = clock(), found, error
        if error is not None:
            raise error
        return cast(_T, found)

    def torques(self) -> Torques:
        """Which joints hold and which are limp, as far as it is known."""
        return self.arm.torques()

    def row(self) -> dict[str, object]:
        """The arm in a list of several, for JSON, as `hexwire.fleet.overview.Overview`."""
        owner, facts = self.arm.owner, self.facts()
        state = owner.state if owner.connected else None
        return {
            "name": self.name,
            "robot": facts["robot"],
            "host": "",
            "holder": facts["holder"],
            "torque": self.torques().short,
            "stopped": bool(facts["stopped"]),
            "why": facts["error"] or facts["stopped"] or facts["lost"],
            "age": None if state is None else max(0.0, owner.now() - state.stamp),
            "silent": not facts["known"],
            "known": facts["known"],
            "faults": "; ".join(cast(list[str], facts["faults"] or [])),
        }

    def model(self) -> dict[str, object]:
        """The joints, for JSON: radians, radians per second."""
        return {
            "robot": self.settings.model.name,
            "joints": [
                {
                    "name": joint.name,
                    "servo": joint.servo_id,
                    "min": joint.minimum,
                    "max": joint.maximum,
                    "speed": joint.max_speed,
                }
                for joint in self.settings.model.joints
            ],
            "space": self.settings.kinematics is not None,
        }


def unready(connected: bool, error: str, known: Sequence[str], missing: Sequence[str]) -> str:
    """Why the arm as a whole cannot be moved now, whoever has control; empty if it can.

    Args:
        connected: It is connected.
        error: Why it is not.
        known: Joints that are known.
        missing: The others.
    """
    if not connected:
        return f"the arm is not connected: {error}"
    if not known:
        return "the arm is silent: nobody knows where it is"
    if missing:
        verb = "does" if len(missing) == 1 else "do"
        return f"{', '.join(missing)} {verb} not answer: nobody knows where the arm is"
    return ""


def live_values(model: ArmModel, state: JointState) -> list[LiveValues]:
    """What the servos of an arm measure, as those of a bare bus do; their counts are not known."""
    rows, nan = list[LiveValues](), math.nan
    for joint in state:
        servo_id, status = model.joint(joint.name).servo_id, int(joint.flags.faults & ~JointFlag.SILENT)
        if joint.flags & JointFlag.SILENT:
            rows.append(LiveValues(servo_id, None, nan, nan, nan, nan, nan, nan, status, "no answer"))
            continue
        place = (joint.position, joint.velocity, joint.load)
        rows.append(LiveValues(servo_id, None, *place, joint.voltage, joint.temperature, joint.current, status))
    return rows


def torque_words(torques: Torques) -> str:
    """What the header says of torque: on, off, partly on, unknown, or of which joints it is unknown."""
    if torques.unknown:
        known = torques.holding or torques.limp
        return f"unknown: {' '.join(torques.unknown)}" if known else "unknown"
    return "partly on" if torques.holding and torques.limp else torques.short
