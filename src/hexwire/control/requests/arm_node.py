"""What a program does that serves an arm to other programs by messages, whatever these look like.

Owns the services and whom they ask, the order at the end, diagnostics, warnings, and when each is due. Must not
know messages or names of topics.
"""

from __future__ import annotations

import logging
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from hexwire.errors import DeviceError, HexwireError

from ..loop.rate import LogLimiter, Periodic
from ..loop.shutdown import Shutdown
from ..loop.workers import MergedCalls
from ..motion.rest import rest_in_words
from .client_goals import ClientGoal, ClientGoals
from .controlled_arm import ControlledArm
from .diagnostics import ChangeWatch, Row, diagnose
from .set_point_stream import JointCommandStream

if TYPE_CHECKING:
    from concurrent.futures import Future

    from hexwire.drivers.base import RobotDriver
    from hexwire.epochs import Token
    from hexwire.model.state import JointState
    from hexwire.motion.teach import Taught

    from ..loop.controller import TrajectoryController
    from ..loop.known_state import KnownState
    from ..loop.outcomes import Progress
    from .settings import Settings

__all__ = ["ArmNode"]

_log = logging.getLogger(__name__)
_G = TypeVar("_G", bound=ClientGoals[Any])

_LONGEST_SHUTDOWN = 30.0
"""Seconds from a signal to the end of the process; with a robot that does not answer, it takes about ten."""
_RESTS = 0.3
"""Most seconds until who asked for a stop is answered, after the joints have confirmed it."""


class ArmNode(ABC, Generic[_G]):
    """Serves an arm. A subclass has the messages, and sets `_goals`.

    Args:
        robot: Not attached.
        settings: Of the arm.
        diagnostics_rate: Diagnostics per second, if nothing changes.
    """

    _goals: _G

    def __init__(self, robot: RobotDriver, settings: Settings, diagnostics_rate: float) -> None:
        self._arm = ControlledArm(robot, settings, on_state=self._publish_state, on_taught=self._publish_taught)
        self._stops: MergedCalls[str, str] = MergedCalls("stops", lambda said: self._arm.stop(said[0]))
        self._joint_commands = JointCommandStream(self._arm)
        self._shutdown = Shutdown(_LONGEST_SHUTDOWN)
        self._watch = ChangeWatch(1.0 / diagnostics_rate)
        self._state_due, self._feedback_due, self._log_limiter = Periodic(), Periodic(), LogLimiter()

    @abstractmethod
    def _publish_state(self, state: JointState, published: KnownState) -> None: ...
    @abstractmethod
    def _publish_taught(self, taught: Taught) -> None: ...
    @abstractmethod
    def _publish_controller(self, name: str, controller: TrajectoryController, progress: Progress) -> None: ...
    @abstractmethod
    def _publish_feedback(self, client: Any, progress: Progress, elapsed: float) -> None: ...

    def _listen(self, warnings: Sequence[str]) -> None:
        for text in warnings:
            _log.warning("%s", text)
        # Until the arm is connected, nothing must be made safe, and the wait for a board may be long.
        self._shutdown.interrupts = True
        self._shutdown.listen()

    def _make_safe(self, wait: float) -> bool:
        """Bring the arm to rest and answer who waits, at most for so many seconds; whether a client had a goal."""
        self._shutdown.interrupts = False
        self._shutdown.request()
        had_goals = self._goals.open
        self._arm.shutdown()
        self._goals.close()
        self._stops.close(wait)
        return had_goals

    def _requests(self) -> dict[str, Callable[[Token], str]]:
        """What a client may ask for by a name alone, besides a stop; the token is when it asked."""
        arm = self._arm
        poses = {f"go_to/{pose}": partial(arm.go_to, pose) for pose in arm.settings.poses}
        teach = {"teach/start": arm.teach_start, "teach/stop": lambda asked: arm.teach_stop()}
        return {"reset": arm.reset, **teach, "teach/play": arm.teach_play, **poses}

    def _stopped(self, stopped: Future[str]) -> str:
        """What a client of a stop is told: that all joints confirmed it, and whether they are at rest."""
        said, owner = stopped.result(), self._arm.owner
        # The joints are known from `connect` on.
        assert owner.state is not None
        last = owner.state
        rest = rest_in_words(lambda: owner.state or last, _RESTS, clock=owner.now, sleep=threading.Event().wait)
        return f"{said}; {rest}"

    @staticmethod
    def _outcome(call: Callable[[], str]) -> tuple[bool, str]:
        """Whether a request succeeded, and what the client is told."""
        try:
            return True, call()
        except HexwireError as error:
            _log.warning("%s", error)
            return False, str(error)

    def _follow(self, topic: str, call: Callable[[], str | None]) -> None:
        """Follow a message of a topic; what it says that has no effect, and why it is refused, is logged."""
        try:
            if without_effect := call():
                self._warn(f"{topic}: {without_effect}", 60.0)
        except HexwireError as error:
            self._warn(f"{topic} refused: {error}")

    def _warn(self, text: str, period: float = 1.0) -> None:
        if self._log_limiter.due(text, time.monotonic(), period):
            _log.warning("%s", text)

    def _diagnostics_due(self) -> tuple[tuple[Row, ...], str] | None:
        """Diagnostics that are to be published now, and the robot's address; raises if its owner has failed."""
        crash = self._arm.owner.crash
        if crash is not None:
            raise DeviceError(f"the node failed: {crash!r}") from crash
        facts = self._arm.facts()
        if not self._watch.due(diagnose(facts, states="joint_states", figures=False), time.monotonic()):
            return None
        return diagnose(facts, states="joint_states"), facts.url

    def _publish_progress(self, state_rate: float, feedback_rate: float) -> None:
        """Publish states of controllers and feedback of goals, each at its rate."""
        now, controllers = time.monotonic(), self._arm.controllers.items()
        if self._state_due.due(now, 1.0 / state_rate):
            for name, controller in controllers:
                if controller.progress is not None:
                    self._publish_controller(name, controller, controller.progress)
        if self._feedback_due.due(now, 1.0 / feedback_rate):
            for _, controller in controllers:
                goal, progress = controller.listener, controller.progress
                if isinstance(goal, ClientGoal) and goal.accepted and progress is not None:
                    elapsed = progress.stamp - controller.begins
                    # A board that executes trajectories begins a moment later: there is nothing to tell before.
                    if elapsed >= 0.0:
                        self._publish_feedback(goal.client, progress, elapsed)
