"""The studio: what is open, and who looks at it.

Owns joining source, access, tabs and the live socket, how calls of pages are run, and the order in which all ends.
Must not know what a page shows, how pages are served, nor decide about motion.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
import time
from collections import Counter
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from hexwire.control.loop.power import Stopped
from hexwire.control.loop.workers import MergedCalls
from hexwire.control.motion.hold_to_run import FINE
from hexwire.errors import HexwireError, LeaseError, LinkLostError, LinkNotFoundError, UsageError

# What pages may ask for by name: each of these adds its calls.
from . import arm_calls, leader_calls, present_calls, program_calls, recording_calls, wire_calls  # noqa: F401
from .access import WATCHING_ONLY, Access, Right
from .bus_source import live_row
from .calls import Asked, CallLane, find_call
from .cameras import Cameras
from .first_run_calls import FirstRuns
from .fleet_watch import FleetWatch
from .holds import Holds
from .live import Live
from .recordings import Recordings
from .servos import (  # noqa: F401
    backup,
    board,
    calibration_run,
    health,
    identity,
    registers,
    search,
    stress,
    whole_arm,
)
from .servos.slide_run import add_slide
from .servos.wave_run import add_wave
from .source import Source
from .tabs import Tab, Tabs
from .wire_feed import WireFeed

if TYPE_CHECKING:
    from hexwire.control.motion.hold_to_run import HeldMotion
    from hexwire.epochs import Token

    from .bus_source import BusSource
    from .foxglove import Foxglove
    from .page_process import PageProcess
    from .plugged import Plugged
    from .source import ArmSource
    from .urdf_folder import UrdfFolder

__all__ = ["Studio"]

_log = logging.getLogger(__name__)

_T = TypeVar("_T")
_LONGEST = 200
"""Letters of the names of those who stopped the arm."""
_MOST_CALLS, _MOST_PLANS = 8, 4
"""Calls of the pages of one session that are under way in a lane at a time, and of one page that compute."""
_LOOK = 0.1
"""Most seconds between two looks whether what is held has signs of life: shorter than the silence that ends it."""
_LAST_STOP = 5.0
"""Seconds in which the last stop must end."""
_PATIENCE = 3.0
"""Seconds for an arm to confirm that it is stopped, as for a shared one."""


def _address(url: str) -> str:
    """Without options."""
    return url.partition("?")[0]


async def _outcome(name: str, future: Future[Stopped]) -> Stopped:
    """What has become of a stop; not confirmed if it takes too long."""
    waiting = asyncio.wrap_future(future)
    await asyncio.wait((waiting,), timeout=_PATIENCE)
    if waiting.done():
        return waiting.result()
    return Stopped(name, False, error=f"no answer within {_PATIENCE:g} s", seconds=_PATIENCE)


class Studio:
    """One studio. Its pages call it in the loop of the server.

    Args:
        access: The rules of access.
        recordings: Folder of recordings; this user's if None.
        foxglove: Shows what is open to programs that speak Foxglove's protocol; None for nobody.
        cameras: Cameras of this computer that pages may show; none if None.

    Attributes:
        access: The rules of access.
        source: What is open.
        recordings: The recordings.
        tabs: The open tabs.
        wire: The traffic of what is open, and of files.
        fleet: The shared arms that this program may see.
        holds: The kinds of motion that a page may hold.
        first: The first run of an arm.
        live: The tabs' own sockets.
        foxglove: Shows what is open to programs that speak Foxglove's protocol; None for nobody.
        cameras: Cameras of this computer that pages may show.
        files: The process for the files of pages, of each right.
        urdf: A robot's URDF that pages draw in place of the arm's own picture; None for that.
        settings: Further settings of arms that pages open, see `hexwire.control.requests.settings`.
        plugged: What was found last at the ports of this machine; None before somebody has looked.
        demo: Port of the emulated arm that this program has started, and what a person should know of it; empty if
            there is none.
        orders: Runs what tabs order, one after the other.
    """

    def __init__(
        self,
        access: Access,
        recordings: Path | None = None,
        foxglove: Foxglove | None = None,
        cameras: Cameras | None = None,
    ) -> None:
        self.access, self.foxglove = access, foxglove
        self.cameras = cameras if cameras is not None else Cameras()
        self.settings: dict[str, object] = {}
        self.urdf: UrdfFolder | None = None
        self.plugged: list[Plugged] | None = None
        self.demo = ("", "")
        # The arm that viewers see.
        self._watched: ArmSource | None = None
        self.recordings = Recordings(recordings)
        self.tabs = Tabs()
        self.wire = WireFeed()
        self.fleet = FleetWatch()
        self.source = Source(self._changed, self.wire)
        self.holds = Holds(self.source)
        self.holds.add("run", self._begin_run)
        self.holds.add("follow", lambda *hold: self.source.need_arm().begin_follow(*hold))
        add_wave(self)
        self.first = FirstRuns(self)
        add_slide(self)
        self.live = Live(self)
        self.orders = ThreadPoolExecutor(1, "studio orders")
        # The stops of what is open: one answers all who have asked before it began.
        self._stops: tuple[object, MergedCalls[str, Stopped]] | None = None
        self._stopping = threading.Lock()
        # Those who may operate never wait for those who only watch. Of all that pages ask for, at most two things
        # compete with the arm for the interpreter.
        self._lanes = {
            (lane, right): ThreadPoolExecutor(8 if lane is CallLane.WAITS else 1, f"studio {lane.name.lower()}")
            for lane in CallLane
            for right in Right
        }
        self.files = {right: self.recordings.process() for right in Right}
        self._calls: Counter[tuple[str, CallLane]] = Counter()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._ending = threading.Event()
        self._watch: threading.Thread | None = None

    def emulated(self, arm: ArmSource) -> str:
        """What a person should know of an emulated arm that this program has started; empty for others."""
        port, words = self.demo
        return words if port and arm.driver.url.partition("?")[0].endswith(port) else ""

    # -- for pages ----------------------------------------------------------------------------------------

    async def run(self, lane: CallLane, right: Right, call: Callable[[], _T]) -> _T:
        """Do something for a page in turn with the others of this lane and right."""
        return await asyncio.get_running_loop().run_in_executor(self._lanes[lane, right], call)

    async def ask_files(self, right: Right, call: Callable[[PageProcess], _T]) -> _T:
        """Have the process for the files of pages do something, in turn with the others of this right.

        Args:
            right: Of the session that asks.
            call: Asks it.

        Raises:
            HexwireError: As `PageProcess.ask`.
            OSError: As `PageProcess.ask`.
        """
        return await self.run(CallLane.FILES, right, lambda: call(self.files[right]))

    async def call(self, tab: Tab, name: str, args: Mapping[str, object], opened: int | None = None) -> object:
        """Do what a page asks for by name, see `calls`; what it does runs in a thread.

        Args:
            tab: Who asks.
            name: Of the call.
            args: Its arguments, unchecked.
            opened: `Source.opened` of what the page shows; None if the call is about nothing of it.

        Raises:
            HexwireError: It is refused, or failed.
        """
        found = find_call(name)
        lane = found.lane(tab)
        computes = lane is CallLane.COMPUTES
        key = (tab.key if computes else tab.session, lane)
        if self._calls[key] >= (_MOST_PLANS if computes else _MOST_CALLS):
            raise UsageError("this browser asks for too much at a time; try again")
        if tab.right < found.right:
            raise LeaseError(WATCHING_ONLY)
        if opened is not None and opened != self.source.opened:
            raise LinkLostError("what this page shows was closed; load the page again")
        if found.control:
            self.need_control(tab)
        given, present = found.read(args), self.source.present
        # Marked now: it waits for a thread, and a stop that comes meanwhile must stay.
        asked = Asked(self, tab, present, None if present is None else present.mark())

        def act() -> object:
            if found.control:
                # Again: it may have waited for a thread, and control may have gone to another page meanwhile.
                self.need_control(tab)
                asked.refuse_if_stopped_since()
            return found.act(asked, given)

        self._calls[key] += 1
        try:
            return await self.run(lane, tab.right, act)
        except HexwireError:
            raise
        except Exception as error:
            _log.exception("the call %s of a page failed", name)
            raise HexwireError(f"the studio failed at this: {type(error).__name__}: {error}") from error
        finally:
            self._calls[key] -= 1
            if not self._calls[key]:
                del self._calls[key]

    def need_control(self, tab: Tab) -> None:
        """Check that a tab may command now.

        Raises:
            LeaseError: It does not have control.
        """
        self.source.need_control(tab)

    def take(self, tab: Tab, *, force: bool = False) -> None:
        """Give a tab control. Blocks.

        Args:
            tab: The tab.
            force: Take it from another tab.

        Raises:
            LeaseError: Its session may only watch, or another tab has control.
        """
        if tab.right < Right.OPERATE:
            raise LeaseError(WATCHING_ONLY)
        self.source.take(tab, force=force)

    def open(self, tab: Tab, url: str, robot: str | None = None) -> None:
        """Open an arm for a tab, in place of what is open. Blocks.

        Raises:
            LeaseError: Its session may only watch, or another tab has control of what is open.
            HexwireError: As `Source.open`.
        """
        self._may_switch(tab)
        self.source.open(url, robot, **self.settings)

    def open_bus(self, tab: Tab, url: str = "") -> None:
        """Open a servo bus in place of what is open, and give the tab control of it. Blocks.

        Args:
            tab: The tab.
            url: Port or address; if empty, the bus of the arm that is open, of which the tab must have control.

        Raises:
            LeaseError: As `open`.
            HexwireError: As `Source.open_bus`.
        """
        self._may_switch(tab)
        if not url:
            self.need_control(tab)
        self.source.open_bus(url)
        self.take(tab)

    def close_source(self, tab: Tab) -> None:
        """Close what is open, for a tab; raises as `open`."""
        self._may_switch(tab)
        self.source.close()

    def _may_switch(self, tab: Tab) -> None:
        if tab.right < Right.OPERATE:
            raise LeaseError(WATCHING_ONLY)
        present = self.source.present
        holder = present.holder if present is not None else None
        if holder is not None and not self.source.has_control(tab):
            raise LeaseError(f"{holder.client} has control of what is open; take control first")

    # -- for the live socket --------------------------------------------------------------------------------

    def soon(self, call: Callable[[], object]) -> None:
        """Call something in the loop of the server, from any thread."""
        loop = self._loop
        if loop is not None:
            with contextlib.suppress(RuntimeError):
                loop.call_soon_threadsafe(call)

    def stop(self, who: str) -> None:
        """Stop what is open, ahead of everything; returns at once. Any thread may call it; nobody needs control."""
        self._stop_present(who)

    def _stop_present(self, who: str) -> tuple[str, Future[Stopped]] | None:
        """Begin to stop what is open; its name and what will have become of it, or None if nothing is open."""
        present = self.source.present
        if present is None:
            return None
        present.hold_to_run.end_all(f"{who} stopped it")
        with self._stopping:
            return present.name, self._stops_of(present).ask(who)

    def _stops_of(self, present: ArmSource | BusSource) -> MergedCalls[str, Stopped]:
        """The stops of what is open. Another one never waits for those of what was open before, which may hang."""

        def stop(names: list[str]) -> Stopped:
            try:
                done = present.stop(f"{', '.join(dict.fromkeys(names))[:_LONGEST]} stopped it")
            except HexwireError as error:
                done = Stopped(present.name, False, error=str(error), torques=present.torques())
            if not done.confirmed:
                _log.error("the stop was not confirmed: %s", done.error)
                self.live.tell(
                    {"kind": "news", "level": "error", "text": f"the stop was not confirmed: {done.error}"}
                )
            return done

        known = self._stops
        if known is not None and known[0] is present:
            return known[1]
        self._stops = made = present, MergedCalls("studio stops", stop)
        if known is not None:
            known[1].close(0.0)
        return made[1]

    async def stop_own(self, who: str) -> list[Stopped]:
        """Stop what is open here, and say what it does then; nothing if nothing is open."""
        begun = self._stop_present(who)
        return [] if begun is None else [await _outcome(*begun)]

    async def stop_all(self, who: str) -> list[Stopped]:
        """Stop every arm that a page can reach: what is open here first, then those that are shared.

        Raises:
            LinkNotFoundError: There is none.
        """
        begun = self._stop_present(who)
        try:
            shared = await self.fleet.stop(None, who)
        except LinkNotFoundError:
            if begun is None:
                raise
            shared = []
        except Exception as error:  # noqa: BLE001  # shown: the stop of what is open here is said all the same
            if not isinstance(error, HexwireError):
                _log.exception("the stop of the shared arms failed")
            shared = [Stopped("the shared arms", False, error=str(error) or type(error).__name__)]
        if begun is None:
            return sorted(shared, key=lambda row: row.confirmed)
        own = await _outcome(*begun)
        # Of an arm that is shared and open here, once.
        here = self.source.arm
        url = "" if here is None else _address(here.driver.url)
        rest = [row for row in shared if self.fleet.address(row.name) != url]
        # What may still move is seen first.
        return [own, *sorted(rest if own.confirmed else shared, key=lambda row: row.confirmed)]

    def arms(self) -> dict[str, Any]:
        """The arms that a page can reach, for JSON, as `FleetWatch.look`; first what is open here."""
        found, present = self.fleet.look(), self.source.present
        if present is not None:
            url = str(present.facts()["url"])
            rest = [row for row in found["arms"] if row["url"] != _address(url)]
            found["arms"] = [present.row() | {"url": url, "own": True}, *rest]
        return found

    def end_motions(self, why: str) -> None:
        """End what anybody holds; returns at once."""
        present = self.source.present
        if present is not None:
            present.hold_to_run.end_all(why)

    def gone(self, tab: Tab) -> None:
        """The socket of a tab is closed: end what it holds, and give its control back."""
        self.holds.forget(tab)
        present = self.source.present
        if present is not None:
            present.hold_to_run.end(tab.key, "its page was closed")
        if tab.grant:
            self.orders.submit(self.source.leave, tab)

    def refused(self, entry: HeldMotion, why: str) -> None:
        """A motion that was announced did not begin."""
        present = self.source.present
        if present is not None:
            present.hold_to_run.end(entry.who, why, entry.number)

    def ended(self, entry: HeldMotion) -> None:
        """A motion has ended: tell its tab."""
        fine = entry.ended in FINE
        self.live.tell({"kind": "ended", "id": entry.number, "why": entry.ended, "fine": fine}, entry.who)

    def facts(self) -> dict[str, object]:
        """What is always in sight, for JSON."""
        source = self.source
        common: dict[str, object] = {
            "mode": source.mode,
            "opened": source.opened,
            "opening": source.opening,
            "open_error": source.error,
            "refused": source.refused,
        }
        present = source.present
        if present is None:
            return common
        holder = present.holder
        tab = self.tabs.holder(holder.key) if holder is not None else None
        return {**common, **present.facts(), "holder_tab": tab.name if tab is not None else ""}

    def model(self) -> dict[str, object]:
        """The joints of what is open, for JSON."""
        arm = self.source.arm
        return arm.model() if arm is not None else {"robot": "", "joints": [], "space": False}

    # -- motions to a goal ----------------------------------------------------------------------------------

    def running(self) -> dict[str, object] | None:
        """How far the motion to a goal is, for JSON; None if there is none."""
        arm = self.source.arm
        progress = None if arm is None else arm.motions.progress
        return None if progress is None or progress.outcome is not None else {"kind": "run", **asdict(progress)}

    def _begin_run(self, tab: Tab, entry: HeldMotion, args: Mapping[str, object], arrived: Token) -> None:
        """Begin a motion to a goal for a tab, and tell all tabs how far it is."""
        arm = self.source.need_arm()
        motion, taught = self.recordings.asked(args, arm.settings.model.names)
        arm.begin_run(tab, entry, motion, arrived, lambda: self._tell_run(arm), taught=taught)
        self._tell_run(arm)

    def _tell_run(self, arm: ArmSource) -> None:
        progress = arm.motions.progress
        if progress is not None:
            # A motion may end in another thread before its beginning is told.
            self.live.tell(lambda: {"kind": "run", **asdict(arm.motions.progress or progress)})

    # -- life -----------------------------------------------------------------------------------------------

    def _changed(self) -> None:
        present = self.source.present
        # A recording ends with its arm.
        self._lanes[CallLane.WAITS, Right.OPERATE].submit(self.recordings.recorder.follow, self.source.arm)
        if present is not None:
            present.hold_to_run.on_end = self.ended
        if self.foxglove is not None:
            self._watch_arm(self.foxglove)
        bus = self.source.bus
        if bus is not None:
            bus.on_change = lambda: self.soon(self.live.tell_facts)
            bus.on_live = lambda values: self.live.tell(
                {"kind": "servos", "t": time.monotonic(), "rows": [live_row(row) for row in values]}
            )
        self.soon(lambda: self.live._tell({"kind": "hello", **self.model()}, None))
        self.soon(self.live.tell_facts)

    def _watch_arm(self, foxglove: Foxglove) -> None:
        """Show viewers what is open now."""
        arm = self.source.arm
        if arm is self._watched:
            return
        self._watched = arm
        if arm is None:
            foxglove.hide("")
        else:
            arm.listeners = (*arm.listeners, foxglove.show("", arm.settings.model, arm.settings.links))

    def begin(self, loop: asyncio.AbstractEventLoop) -> None:
        """The server has started."""
        self._loop = loop
        self._watch = threading.Thread(target=self._look, name="studio watch", daemon=True)
        self._watch.start()

    def _look(self) -> None:
        """End what is held without signs of life, also when the loop of the server hangs."""
        due = 0.0
        while not self._ending.wait(min(due, _LOOK)):
            present, due = self.source.present, _LOOK
            if present is not None:
                try:
                    due = present.hold_to_run.check()
                except Exception:  # noqa: BLE001  # logged; a hold ends in the owner's cycle, too
                    _log.exception("the watch of holds failed")

    def close(self) -> None:
        """End: make the arm safe, and close everything."""
        self._ending.set()
        if self._watch is not None:
            self._watch.join()
        self.recordings.close()
        self.source.close()
        self.cameras.close()
        for process in self.files.values():
            process.close()
        self.fleet.close()
        if self._stops is not None:
            self._stops[1].close(_LAST_STOP)
        for pool in (self.orders, *self._lanes.values()):
            pool.shutdown()
