"""What the studio has open: nothing, an arm with its owner and lease, or a bare servo bus.

Owns opening, closing and switching, and the facts that are always in sight. Its calls block; any thread may make
them. Must not know pages or sockets.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

from hexwire.control.motion.hold_to_run import SILENCE
from hexwire.control.requests.setting import Faults
from hexwire.control.requests.settings_reader import read_settings
from hexwire.drivers.abilities import BareServos, Leased
from hexwire.errors import HexwireError, LeaseError, LinkLostError, UsageError
from hexwire.link.tap import wrap_new_links

from .arm_source import ArmSource
from .wire_feed import WireFeed

if TYPE_CHECKING:
    from hexwire.link.base import Link

    from .bus_source import BusSource
    from .tabs import Tab

__all__ = ["ArmSource", "Source"]

_log = logging.getLogger(__name__)

_RANK = 1
"""All pages have one rank: none takes control from another without asking for it."""
_NO_ARM = "no arm is open; choose a port on the page Arms"


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
        refused: What was to be opened then; empty likewise.
        opened: Another number after each opening and closing; for pages, which show what is open.
        silence: Seconds without a sign of life after which what somebody holds ends.
    """

    def __init__(self, on_change: Callable[[], object] = lambda: None, wire: WireFeed | None = None) -> None:
        self._wire = wire or WireFeed()
        self.arm: ArmSource | None = None
        self.bus: BusSource | None = None
        self.opening, self.error, self.refused = "", "", ""
        self.silence = SILENCE
        self.opened = 0
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
            **settings: Further settings of `hexwire.control.requests.settings`.

        Raises:
            HexwireError: It cannot be opened.
        """
        with self._lock:
            return self._open(url, robot, None, settings)

    def open_arm_of_bus(self, robot: str, **settings: object) -> ArmSource:
        """Close the servo bus that is open, and open its servos as an arm; they keep their torque as it is.

        Args:
            robot: Its name.
            **settings: As in `open`.

        Raises:
            HexwireError: No bus is open, or the arm cannot be opened.
        """
        with self._lock:
            link = self.need_bus().bus.link
            return self._open(link.url, robot, link, settings)

    def _open(self, url: str, robot: str | None, kept: Link | None, settings: Mapping[str, object]) -> ArmSource:
        """Open an arm, over a link that is there already if one is given: an emulated arm goes on as it is."""
        with self._opening(url):
            # Whoever opens it sees at once why it fails, and tries again.
            given: dict[str, object] = {"port": url, "connect_timeout": 0.0, **settings}
            if robot:
                given["robot"] = robot
            tap = self._wire.begin(url)
            with wrap_new_links(tap if kept is None else lambda _: tap(kept)):
                read, driver = read_settings(given, Faults())
            self._wire.expect(joint.series for joint in read.model.joints)
            arm = ArmSource(read, driver, self.silence)
            try:
                arm.start()
            except BaseException:
                arm.shutdown()
                raise
            self.arm = arm
        return arm

    @contextmanager
    def _opening(self, url: str) -> Iterator[None]:
        """Close what is open; the block opens something else. Pages are told of that, and why it fails."""
        self._close()
        self.opening, self.error, self.refused = url, "", ""
        self._on_change()
        try:
            yield
            self.opened += 1
        except HexwireError as error:
            self.error, self.refused = str(error), url
            raise
        finally:
            self.opening = ""
            self._on_change()

    def open_bus(self, url: str = "") -> BusSource:
        """Close what is open, and open a bare servo bus; its servos keep their torque as it is.

        Args:
            url: Port or address; if empty, the bus of the arm that is open.

        Raises:
            HexwireError: It cannot be opened.
        """
        from hexwire.bus.servo_bus import ServoBus
        from hexwire.drivers.board_reset import warn_of_reset

        from .bus_source import BusSource

        with self._lock:
            link: Link | None = None
            if not url:
                # The same link: an emulated arm goes on as it is.
                bare = BareServos.find(self.need_arm().driver)
                if bare is None:
                    raise UsageError("this arm has a board: its servos are on the board's bus, not on this port")
                link, url = bare.servo_link, bare.servo_link.url
            # Until the servos are known, those of the arm that was open here, or the most common ones.
            series = (
                [joint.series for joint in self.arm.settings.model.joints] if self.arm and link else ["sts_sms"]
            )
            with self._opening(url):
                tap = self._wire.begin(url)
                # A rate in the address, or that of the factory.
                link = tap(link if link is not None else ServoBus.from_url(url).link)
                self._wire.expect(series)
                bus = ServoBus(link)
                # A controller board may be there by mistake.
                warn_of_reset(link)
                bus.open()
                self.bus = BusSource(bus, self.silence)
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
        self.opened += 1
        if arm is not None:
            arm.shutdown()
        if bus is not None:
            from hexwire.drivers.board_reset import note_servos

            note_servos(bus.bus)
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
            if (leased := Leased.find(arm.driver)) is not None:
                leased.take()
        except HexwireError:
            self.leave(tab)
            raise
        if former is not None and former.key != tab.grant:
            arm.hold_to_run.end_all(f"{tab.name} took control")

    def leave(self, tab: Tab) -> None:
        """Take control back from a tab; what moves holds."""
        grant, tab.grant = tab.grant, 0
        if self.bus is not None and grant:
            self.bus.leave(tab, grant)
        if self.arm is not None and grant:
            self.arm.leave(tab, grant)

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
