"""Plays a motion on an emulated arm of the same kind, before the real one does it.

Owns that arm, which lives as long as the motion. The same checks, controllers and limits as on the real arm apply.
Must not know pages or files.
"""

from __future__ import annotations

import logging
import math
import threading
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from hexwire.control.loop.outcomes import Outcome
from hexwire.control.requests.controlled_arm import ControlledArm
from hexwire.control.requests.history import History
from hexwire.control.requests.motion_service import MotionService
from hexwire.control.requests.pose_file import PoseFile
from hexwire.control.requests.setting import Faults
from hexwire.control.requests.settings_reader import read_settings
from hexwire.control.sharing.lease import Lease
from hexwire.control.sharing.shared import Order, SharedArm
from hexwire.errors import HexwireError, UsageError
from hexwire.model.arms import simulated_arms

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from hexwire.control.motion.motion_run import MotionRun
    from hexwire.model.state import JointState, SentTarget
    from hexwire.motion.teach import Taught

__all__ = ["Twin", "TwinState"]

_log = logging.getLogger(__name__)

_STALLS = 5.0
"""Watchdog of the emulated arm, s. Nothing real moves, and this program, which is both ends, may stall."""
_PATIENCE = 15.0
"""Seconds in which the emulated arm must answer."""


@dataclass(frozen=True, slots=True)
class TwinState:
    """How far the twin is.

    Attributes:
        robot: The emulated arm; empty before the first motion.
        title: What is played.
        running: It moves.
        elapsed: Seconds of the motion that are over.
        duration: Seconds of all of it.
        lead_in: Seconds at its start in which the arm moves to where the motion begins.
        began: When the motion began, seconds of the twin's clock.
        ended: How it ended, in words; empty while it runs.
        arrived: It reached the end.
    """

    robot: str = ""
    title: str = ""
    running: bool = False
    elapsed: float = 0.0
    duration: float = 0.0
    lead_in: float = 0.0
    began: float = 0.0
    ended: str = ""
    arrived: bool = False


class Twin:
    """At most one emulated arm. Any thread may call its methods.

    Attributes:
        history: What it did in the last motion; None before the first.
    """

    def __init__(self) -> None:
        self.history: History | None = None
        self._lock = threading.Lock()
        # The newest motion; without a run before the first, and after a failure.
        self._played: tuple[TwinState, MotionRun | None] = TwinState(), None
        self._why = ""
        self._over = threading.Event()
        self._thread: threading.Thread | None = None

    @property
    def state(self) -> TwinState:
        """How far it is."""
        state, run = self._played
        if run is None:
            return state
        progress = run.progress()
        running = progress.outcome is None
        return replace(
            state,
            running=running,
            elapsed=progress.elapsed,
            duration=progress.duration,
            lead_in=progress.lead_in,
            ended="" if running else progress.text or "arrived",
            arrived=progress.outcome is Outcome.SUCCEEDED,
        )

    @property
    def busy(self) -> bool:
        """It plays, or is about to."""
        return self._thread is not None and self._thread.is_alive()

    def play(
        self,
        robot: str,
        title: str,
        make: Callable[[tuple[str, ...]], Taught],
        *,
        begin: float = 0.0,
        end: float = float("inf"),
        factor: float = 1.0,
        settings: Mapping[str, object] | None = None,
    ) -> None:
        """Begin a motion; returns when the emulated arm moves.

        Args:
            robot: Its kind, one of `simulated_arms`.
            title: What is played, for people.
            make: Makes the motion for the joints of that arm.
            begin: First second of it to play.
            end: Last second.
            factor: 2 plays it twice as fast.
            settings: Further settings of `hexwire.control.requests.settings`, such as the height of the table.

        Raises:
            UsageError: It plays already, or there is no such arm.
            HexwireError: The motion is refused, as the real arm would refuse it.
        """
        if robot not in simulated_arms():
            raise UsageError(f"there is no emulated {robot}; there are {', '.join(simulated_arms())}")
        with self._lock:
            if self.busy:
                raise UsageError("the twin is moving; stop it first")
            self._over.clear()
            self._why = ""
            part = {"begin": begin, "end": end if math.isfinite(end) else None, "factor": factor}
            begun = threading.Event()
            failed: list[BaseException] = []
            self._thread = threading.Thread(
                target=self._live,
                args=(robot, title, make, part, settings or {}, begun, failed),
                name="twin",
                daemon=True,
            )
            self._thread.start()
            begun.wait()
            if failed:
                self._thread.join(_PATIENCE)
                raise failed[0]

    def stop(self, why: str) -> None:
        """End the motion, and wait until the emulated arm is gone."""
        self._why = why
        self._over.set()
        thread = self._thread
        if thread is not None:
            thread.join(_PATIENCE)

    # -- in its thread ------------------------------------------------------------------------------------

    def _live(
        self,
        robot: str,
        title: str,
        make: Callable[[tuple[str, ...]], Taught],
        part: Mapping[str, object],
        given: Mapping[str, object],
        begun: threading.Event,
        failed: list[BaseException],
    ) -> None:
        try:
            address = f"sim://{robot}?name=twin{id(self)}"
            settings, driver = read_settings({"watchdog": _STALLS, **given, "port": address}, Faults())
            history = History(settings.model.names)
            goals: dict[str, float] = {}

            def sent(target: SentTarget) -> None:
                goals.update(target.positions)

            arm = ControlledArm(driver, settings, monitored=True, on_sent=sent)

            def keep(state: JointState) -> None:
                history.append(state, goals, rate=arm.owner.rate)

            arm.owner.observe(keep)
            try:
                arm.connect()
                arm.start()
                self._move(arm, history, title, make, part, begun)
            finally:
                arm.shutdown()
        except HexwireError as error:
            failed.append(error)
        except BaseException as error:  # noqa: BLE001  # given to the caller, or logged
            failed.append(error)
            if begun.is_set():
                _log.exception("the twin failed")
        finally:
            if failed and begun.is_set():
                self._played = TwinState(robot, title, ended=f"failed: {failed[0]}"), None
            begun.set()

    def _move(
        self,
        arm: ControlledArm,
        history: History,
        title: str,
        make: Callable[[tuple[str, ...]], Taught],
        part: Mapping[str, object],
        begun: threading.Event,
    ) -> None:
        shared = SharedArm(arm, Lease(timeout=3600.0))
        shared.start()
        robot, epochs = arm.settings.model.name, arm.owner.robot.epochs
        try:
            key = shared.take("twin", 1).key
            numbers = iter(range(1, 1_000_000))

            def order() -> Order:
                return Order(key, next(numbers), epochs.mark())

            shared.torque(order(), True, None)
            taught = make(arm.settings.model.names)
            motions = MotionService(shared, PoseFile(arm.settings.model))

            def ended(run: MotionRun) -> None:
                self._over.set()

            run = motions.begin(order, {"what": "play", **part}, on_end=ended, taught=taught)
            self.history = history
            self._played = TwinState(robot, title, began=arm.owner.now()), run
            begun.set()
            self._over.wait()
            run.end(self._why or "ended")
        finally:
            shared.shutdown()
