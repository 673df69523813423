"""What the studio has open: nothing, an arm with its owner and lease, or a bare servo bus.

Owns opening, closing and switching, and the facts that are always in sight. Its calls block; any thread may make
them. Must not know pages or sockets.
"""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, cast

from hexwire.control.arm import Arm
from hexwire.control.attended import SILENCE, Attended, Entry
from hexwire.control.history import History
from hexwire.control.holding import hold_moving
from hexwire.control.jog import JogController, read_request
from hexwire.control.lease import Lease
from hexwire.control.motion_desk import MotionDesk
from hexwire.control.pose_file import PoseFile
from hexwire.control.setting import Faults
from hexwire.control.settings_reader import read_settings
from hexwire.control.shared import Order, SharedArm
from hexwire.drivers.registry import is_address
from hexwire.errors import HexwireError, LeaseError, LinkLostError, StoppedError, UsageError
from hexwire.link.tap import wrap_new_links
from hexwire.model.state import JointFlag

from .frames import FrameBit, serialize_frame
from .wire_feed import WireFeed

if TYPE_CHECKING:
    from hexwire.control.lease import Grant
    from hexwire.control.motion_run import MotionRun
    from hexwire.drivers.base import RobotDriver
    from hexwire.epochs import Token
    from hexwire.link.base import Link
    from hexwire.model.state import JointState, SentTarget
    from hexwire.motion.teach import Taught

    from .bus_source import BusSource
    from .tabs import Tab

__all__ = ["ArmSource", "Source"]

_log = logging.getLogger(__name__)

_RANK = 1
_SLOW, _SHORT_SILENCE = 0.3, 0.15
"""Seconds between two targets from which a line is slow; seconds of silence that end a hold there."""
_NO_ARM = "no arm is open; choose a port on the start page"


class ArmSource:
    """An arm that is open: its owner, its lease, and the motion that somebody holds.

    Args:
        settings: Its settings, checked.
        driver: Not attached.
        silence: Seconds without a sign of life after which what somebody holds ends.

    Attributes:
        settings: As given.
        driver: As given.
        arm: The arm.
        shared: The arm with its lease.
        attended: What somebody holds.
        jog: Moves joints while somebody holds a button.
        goals: Last set-point of each joint, radians.
        desk: Motions to a goal, poses, teach mode.
        history: The last ten minutes.
        watchers: Called with each state and the goals, in the owner's thread; they must not wait.
    """

    def __init__(self, settings: Any, driver: RobotDriver, silence: float = SILENCE) -> None:
        self.driver, self.settings = driver, settings
        self.goals: dict[str, float] = {}
        self.history = History(settings.model.names)
        self.watchers: tuple[Callable[[JointState, Mapping[str, float]], object], ...] = ()
        self.arm = Arm(driver, settings, monitored=False, on_sent=self._sent)
        self.shared = SharedArm(self.arm, Lease(timeout=5.0))
        owner = self.arm.owner
        owner.observers = [*owner.observers, self._keep]
        self.attended = Attended(silence=silence, clock=owner.now)
        self.jog = JogController(settings.model, settings.kinematics, self.shared.path_check, silence=silence)
        self.desk = MotionDesk(self.shared, PoseFile(settings.model))
        self._stops = 0
        # Ends what was held, so that no thread that hears of an end waits for the line.
        self._ender = ThreadPoolExecutor(1, "end of a hold")
        driver.epochs.on_stop(self._on_stop)

    def _sent(self, sent: SentTarget) -> None:
        self.goals.update(sent.positions)

    def _keep(self, state: JointState) -> None:
        owner, trips = self.arm.owner, self.driver.round_trips
        self.history.append(state, self.goals, rate=owner.rate, round_trip=trips[-1] if trips else math.nan)
        for watcher in self.watchers:
            watcher(state, self.goals)

    def _on_stop(self) -> None:
        # May run in a signal handler: nothing here locks.
        self._stops += 1

    @property
    def stops(self) -> int:
        """Number of stops so far, by anybody."""
        return self._stops + self.arm.owner.group.stops

    def start(self) -> None:
        """Connect and start; raises as `Arm.connect`."""
        self.arm.connect()
        if self.arm.owner.command_period > _SLOW:
            # Sending takes a good part of a second there, which leaves less for waiting.
            self.attended.silence = self.jog.silence = min(self.attended.silence, _SHORT_SILENCE)
        self.arm.start()
        owner = self.arm.owner
        with owner.locked():
            owner.group.members = (*owner.group.members, self.jog)
        self.shared.start()

    def shutdown(self) -> None:
        """Stop a motion, and detach; the joints keep their torque."""
        self.attended.end_all("the arm was closed")
        try:
            self.shared.shutdown()
        except HexwireError as error:
            _log.error("the stop was not confirmed: %s", error)
        finally:
            self._ender.shutdown()
            self.arm.shutdown()

    def mark(self) -> Token:
        """The time of an order, relative to stops."""
        return self.driver.epochs.mark()

    @property
    def holder(self) -> Grant | None:
        """Who has control, or None."""
        return self.shared.holder

    def beat(self, key: int) -> None:
        """Renew the control of a tab; raises `LeaseError` if it is lost."""
        self.shared.beat(key, 0.0)

    def stop(self, why: str) -> None:
        """Stop the arm; raises `HexwireError` if it does not confirm it."""
        self.shared.stop(why)

    def take_elsewhere(self) -> None:
        """Take the lease of an arm that another program serves; raises `LeaseError` if somebody else has it."""
        if is_address(self.driver.url):
            cast("Any", self.driver).take()

    def leave_elsewhere(self) -> None:
        """Give the lease of an arm that another program serves back, so that others there can command it."""
        if is_address(self.driver.url):
            try:
                cast("Any", self.driver).release()
            except HexwireError as error:
                _log.warning("the lease was not given back: %s", error)

    def order(self, tab: Tab, arrived: Token | None = None) -> Order:
        """An order of a tab, for the calls of `SharedArm`."""
        return Order(tab.grant, tab.next_number(), arrived or self.driver.epochs.mark())

    # -- holds ------------------------------------------------------------------------------------------

    def begin_jog(self, tab: Tab, entry: Entry, kind: str, args: Mapping[str, object], arrived: Token) -> None:
        """Begin a jog that was announced to `attended`.

        Raises:
            HexwireError: It is refused; nothing moves.
        """
        request = read_request(kind, args, self.settings.model)
        order = self.order(tab, arrived)
        self.shared.admit(order)
        self._settle()
        owner = self.arm.owner
        with owner.locked():
            self.shared.path_check.stop_latch(owner.group.reason)
            state = owner.newest()
            if not self.shared.is_wanted(order) or entry.ended:
                raise StoppedError.unsent("a jog", 0, "it was released or stopped meanwhile")
            owner.group.release("a jog was begun")
            self.jog.begin(request, lambda: entry.age(owner.now()), state)
        owner.group.deliver()
        owner.hurry()
        self.attended.begun(entry, lambda why: self._ender.submit(self._end_jog, why))

    def begin_run(
        self,
        tab: Tab,
        entry: Entry,
        args: Mapping[str, object],
        arrived: Token,
        on_end: Callable[[], object] = lambda: None,
        *,
        taught: Taught | None = None,
    ) -> None:
        """Begin a motion to a goal that was announced to `attended`; see `MotionDesk.begin`.

        Args:
            tab: Whose motion it is.
            entry: Of the motion.
            args: As for the desk.
            arrived: When it was asked for.
            on_end: Called when it has ended; must not wait.
            taught: What is played instead of the last taught motion.

        Raises:
            HexwireError: It is refused; nothing moves.
        """
        self._settle()

        def ended(run: MotionRun) -> None:
            self.attended.end(entry.who, run.progress().text or "arrived", entry.number)
            on_end()

        run = self.desk.begin(
            lambda: self.order(tab, arrived), args, wanted=lambda: not entry.ended, on_end=ended, taught=taught
        )
        self.attended.begun(entry, lambda why: self._ender.submit(run.end, why))

    def _settle(self) -> None:
        """Wait until what was held before has ended, so that its end does not end what is begun now."""
        self._ender.submit(lambda: None).result()

    def _end_jog(self, why: str) -> None:
        owner = self.arm.owner
        with owner.deciding():
            if owner.group.reason is None and owner.connected:
                hold_moving(owner, why)

    def update_jog(self, kind: str, args: Mapping[str, object]) -> None:
        """Change what is held; raises as `JogController.update`."""
        request = read_request(kind, args, self.settings.model)
        with self.arm.owner.locked():
            self.jog.update(request)

    # -- facts ------------------------------------------------------------------------------------------

    def frame(self, state: JointState) -> bytes:
        """The bytes of a frame of state."""
        owner = self.arm.owner
        bits = FrameBit(0)
        if state.stopped or owner.group.reason is not None:
            bits |= FrameBit.STOPPED
        if state.watchdog_tripped or self.shared.tripped:
            bits |= FrameBit.WATCHDOG_TRIPPED
        if state.maintenance:
            bits |= FrameBit.MAINTENANCE
        if owner.connected:
            bits |= FrameBit.CONNECTED
        if self.attended.entry is not None:
            bits |= FrameBit.HELD
        for joint in state:
            if not joint.flags & JointFlag.TORQUE_ON:
                # When it gets torque again, it holds where it is then.
                self.goals.pop(joint.name, None)
        return serialize_frame(state, self.goals, bits, self.stops)

    def facts(self) -> dict[str, object]:
        """What is always in sight, for JSON."""
        owner, driver = self.arm.owner, self.driver
        state, probe = owner.state, owner.probe
        trips = driver.round_trips
        holder = self.shared.holder
        reason = owner.group.reason
        joints = state or ()
        faults = [f"{joint.name}: {found}" for joint in joints if (found := JointFlag(joint.flags).faults)]
        on = len(state.torque_on) if state is not None else 0
        return {
            "robot": self.settings.model.name,
            "url": driver.url,
            "connected": owner.connected,
            "error": "" if owner.connected else owner.error,
            "dialect": probe.dialect if probe is not None else 0,
            "rate": round(owner.rate, 1) if math.isfinite(owner.rate) else 0.0,
            "round_trip_ms": round(1000.0 * trips[-1], 2) if trips else None,
            "faults": faults,
            # That of an arm which another program serves, if nobody here has control.
            "holder": holder.client if holder is not None else getattr(driver, "holder", ""),
            "lost": self.shared.held,
            "stopped": str(reason) if reason is not None else "latched" if state and state.stopped else "",
            "stops": self.stops,
            "torque": "unknown"
            if state is None
            else "on"
            if on == len(state)
            else "off"
            if not on
            else "partly on",
            "note": self.jog.note if self.attended.entry is not None else "",
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


class Source:
    """What is open. One at a time.

    Args:
        on_change: Called after each change, in the thread that made it.
        wire: Keeps the traffic of what is open; one of its own if None.

    Attributes:
        arm: The open arm, or None.
        bus: The open servo bus, or None.
        opening: What is being opened, in words; empty if nothing is.
        error: Why the last opening failed; empty if it did not.
        silence: Seconds without a sign of life after which what somebody holds ends.
    """

    def __init__(self, on_change: Callable[[], object] = lambda: None, wire: WireFeed | None = None) -> None:
        self._wire = wire or WireFeed()
        self.arm: ArmSource | None = None
        self.bus: BusSource | None = None
        self.opening, self.error = "", ""
        self.silence = SILENCE
        self._on_change = on_change
        self._lock = threading.Lock()

    @property
    def mode(self) -> str:
        """``arm``, ``bus``, ``opening`` or ``none``."""
        if self.arm is not None:
            return "arm"
        if self.bus is not None:
            return "bus"
        return "opening" if self.opening else "none"

    def open(self, url: str, robot: str | None = None, **settings: object) -> ArmSource:
        """Close what is open, and open an arm.

        Args:
            url: Port or address.
            robot: Its name, if the address does not say it.
            **settings: Further settings of `hexwire.control.settings`.

        Raises:
            HexwireError: It cannot be opened.
        """
        with self._lock:
            self._close()
            self.opening, self.error = url, ""
            self._on_change()
            try:
                # Whoever opens it sees at once why it fails, and tries again.
                given: dict[str, object] = {"port": url, "connect_timeout": 0.0} | settings
                if robot:
                    given["robot"] = robot
                with wrap_new_links(self._wire.begin(url)):
                    read, driver = read_settings(given, Faults())
                self._wire.expect(joint.series for joint in read.model.joints)
                arm = ArmSource(read, driver, self.silence)
                try:
                    arm.start()
                except BaseException:
                    arm.shutdown()
                    raise
                self.arm = arm
            except HexwireError as error:
                self.error = str(error)
                raise
            finally:
                self.opening = ""
                self._on_change()
            return arm

    def open_bus(self, url: str = "") -> BusSource:
        """Close what is open, and open a bare servo bus; its servos keep their torque as it is.

        Args:
            url: Port or address; if empty, the bus of the arm that is open.

        Raises:
            HexwireError: It cannot be opened.
        """
        from hexwire.bus.servo_bus import ServoBus

        from .bus_source import BusSource

        with self._lock:
            link: Link | None = None
            if not url:
                # The same link: an emulated arm goes on as it is.
                link = self.need_arm().driver.servo_link
                if link is None:
                    raise UsageError("this arm has a board: its servos are on the board's bus, not on this port")
                url = link.url
            # Until the servos are known, those of the arm that was open here, or the most common ones.
            series = (
                [joint.series for joint in self.arm.settings.model.joints] if self.arm and link else ["sts_sms"]
            )
            self._close()
            self.opening, self.error = url, ""
            self._on_change()
            try:
                tap = self._wire.begin(url)
                # A rate in the address, or that of the factory.
                link = tap(link if link is not None else ServoBus.from_url(url).link)
                self._wire.expect(series)
                bus = ServoBus(link)
                bus.open()
                self.bus = BusSource(bus, self.silence)
            except HexwireError as error:
                self.error = str(error)
                raise
            finally:
                self.opening = ""
                self._on_change()
            return self.bus

    def close(self) -> None:
        """Close what is open."""
        with self._lock:
            self._close()
            self._wire.begin("")
        self._on_change()

    def _close(self) -> None:
        arm, self.arm = self.arm, None
        bus, self.bus = self.bus, None
        if arm is not None:
            arm.shutdown()
        if bus is not None:
            bus.shutdown()

    @property
    def present(self) -> ArmSource | BusSource | None:
        """What is open: the arm, the servo bus, or None."""
        return self.arm or self.bus

    def need_bus(self) -> BusSource:
        """The open servo bus.

        Raises:
            LinkLostError: None is open.
        """
        if self.bus is None:
            raise LinkLostError("no servo bus is open; open one on the page Servos")
        return self.bus

    def need_arm(self) -> ArmSource:
        """The open arm.

        Raises:
            LinkLostError: None is open.
        """
        if self.arm is None:
            raise LinkLostError(_NO_ARM)
        return self.arm

    # -- control ----------------------------------------------------------------------------------------

    def take(self, tab: Tab, *, force: bool = False) -> None:
        """Give a tab control; raises `LeaseError` if another one has it."""
        if self.bus is not None:
            self.bus.take(tab, force=force)
            return
        arm = self.need_arm()
        former = arm.shared.holder
        tab.grant = arm.shared.take(tab.name, _RANK, key=tab.grant, force=force).key
        try:
            arm.take_elsewhere()
        except HexwireError:
            self.leave(tab)
            raise
        if former is not None and former.key != tab.grant:
            arm.attended.end_all(f"{tab.name} took control")

    def leave(self, tab: Tab) -> None:
        """Take control back from a tab; what moves holds."""
        grant, tab.grant = tab.grant, 0
        if self.bus is not None and grant:
            self.bus.leave(tab, grant)
        if self.arm is not None and grant:
            self.arm.attended.end(tab.key, "control was given back")
            self.arm.shared.leave(grant, finish=False)
            if self.arm.shared.holder is None:
                self.arm.leave_elsewhere()

    def has_control(self, tab: Tab) -> bool:
        """Whether a tab has control."""
        if self.bus is not None:
            return self.bus.has_control(tab)
        arm = self.arm
        holder = arm.shared.holder if arm is not None else None
        return holder is not None and bool(tab.grant) and holder.key == tab.grant

    def need_control(self, tab: Tab) -> None:
        """Check that a tab has control.

        Raises:
            LeaseError: It has not.
        """
        if not self.has_control(tab):
            raise LeaseError("this page does not have control; take it first")
