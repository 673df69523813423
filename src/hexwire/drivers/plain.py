"""`PlainDriver`: a robot without a board that latches a stop, so that this program keeps the stop.

Owns what such robots share: targets checked before they are sent, and a stop that holds until `resume`, whichever
thread or signal handler calls it. Must not know any particular robot.
"""

from __future__ import annotations

import threading
from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, TypeVar

from hexwire.errors import CommandRefusedError, StoppedError, UsageError
from hexwire.model.state import JointFlag, JointState, JointTarget, SentTarget
from hexwire.motion.limits import check_target
from hexwire.wire.command_frame import Status

from .base import RobotDriver
from .values import StopMode

__all__ = ["PlainDriver"]

_T = TypeVar("_T")
_MAY_HAVE_TORQUE = JointFlag.TORQUE_ON | JointFlag.TORQUE_UNKNOWN


class PlainDriver(RobotDriver):
    """A robot that obeys whatever it is sent: write four hooks, and it has the whole contract of `RobotDriver`.

    The hooks are `on_read`, `on_target`, `on_torque` and `on_hold`. They send and return without waiting for a
    motion. Only one of the last three runs at a time: a stop waits for the one that runs, and what waits behind the
    stop is refused. A signal handler's stop interrupts the hook; what that hook sends afterwards is stopped again.

    A robot with a connection opens it in `attach` and closes it in `detach`, and calls the method it overrides.
    """

    def __init__(self) -> None:
        super().__init__()
        self._open, self._mode = False, StopMode.HOLD
        # A target that was checked before torque off or a stop must not be sent after it. Reentrant, since a signal
        # handler may stop the arm in the middle of a hook.
        self._turn = threading.RLock()

    # -- hooks ----------------------------------------------------------------------------------------

    @abstractmethod
    def on_read(self) -> JointState:
        """Read all joints; `JointState.of` makes a state. `read` adds whether the arm is stopped."""

    @abstractmethod
    def on_target(self, target: JointTarget) -> SentTarget | None:
        """Send joints to a target that is inside the limits and slow enough.

        Returns:
            What was sent, if that is not exactly the target.
        """

    @abstractmethod
    def on_torque(self, on: bool, joints: tuple[str, ...]) -> tuple[str, ...] | None:
        """Switch torque; with torque on, joints stay where they are.

        Returns:
            Names of the joints that confirmed it; None for all of the arm.
        """

    @abstractmethod
    def on_hold(self) -> tuple[str, ...] | None:
        """Have all joints hold where they are. A joint without torque gets none.

        Returns:
            Names of the joints that confirmed it; None for all of the arm.
        """

    # -- the contract ---------------------------------------------------------------------------------

    @property
    def is_attached(self) -> bool:
        return self._open

    def attach(self) -> None:
        self._open = True

    def detach(self, *, torque_off: bool = False) -> None:
        if self._open and torque_off:
            self.torque(False)
        self._open = False

    @property
    def stop_kept_by(self) -> str:
        return ""

    def read(self) -> JointState:
        self._check_attached()
        state, stopped = self.on_read(), self.epochs.stopped
        return state if state.stopped == stopped else replace(state, stopped=stopped)

    def write(self, target: JointTarget) -> SentTarget:
        return self._act("a move", self._send, target)

    def _send(self, target: JointTarget) -> SentTarget:
        checked = self._checked(target)
        return self.on_target(checked) or SentTarget(checked.positions, checked.duration)

    def torque(self, on: bool, joints: Sequence[str] | None = None) -> tuple[str, ...]:
        model = self.model
        names = model.names if joints is None else tuple(model.joint(name).name for name in joints)
        confirmed = self._act("torque on" if on else "torque off", self.on_torque, on, names, freeing=not on)
        return _or_all(confirmed, model.names)

    def stop(self, mode: StopMode = StopMode.HOLD) -> tuple[str, ...]:
        self._check_attached()
        # What waits for its turn is void from here on.
        with self.epochs.stopping(), self._turn:
            return self._halt(mode)

    def resume(self) -> None:
        token = self.epochs.token("resume", freeing=True)
        with self._turn:
            self.epochs.check(token, "resume")
            self.epochs.resumed(token)

    # -- for drivers that do more ---------------------------------------------------------------------

    def _checked(self, target: JointTarget) -> JointTarget:
        """Refuse a target outside the limits, or of a joint without torque; give it the time that it needs."""
        state = self.read()
        checked = check_target(self.model, target, state.positions)
        self._refuse_limp([name for name, _ in checked.positions if not state[name].flags & _MAY_HAVE_TORQUE])
        return checked

    def _halt(self, mode: StopMode) -> tuple[str, ...]:
        """Stop the joints; call it within `Epochs.stopping`."""
        self._mode, names = mode, self.model.names
        return _or_all(self.on_torque(False, names) if mode is StopMode.TORQUE_OFF else self.on_hold(), names)

    def _act(self, what: str, hook: Callable[..., _T], *given: Any, freeing: bool = False) -> _T:
        """Call a hook in its turn, unless a stop came after the call; `freeing` for one that takes torque away."""
        epochs, again = self._epochs, False
        if not self._open:
            self._check_attached()
        token = epochs.token(what, freeing=freeing)
        # As `Epochs.using` does, which costs a fast loop four calls more.
        calls = epochs.calls
        before, calls.token = calls.token, token
        try:
            with self._turn:
                if freeing:
                    epochs.check(token, what)
                elif not epochs.undisturbed(token):
                    self._refuse_if_stopped(what)
                    epochs.check_leaving(token, what)
                try:
                    found = hook(*given)
                finally:
                    if not epochs.undisturbed(token) and (again := epochs.stopped_here_since(token)):
                        # By a signal handler: what it interrupted may have been sent after the stop.
                        with epochs.stopping():
                            self._halt(self._mode)
                if again:
                    epochs.check(token, what)
                return found
        finally:
            calls.token = before

    def _check_attached(self) -> None:
        if not self._open:
            raise UsageError("the driver is not attached; call attach() first")

    def _refuse_if_stopped(self, what: str) -> None:
        if self.epochs.stopped:
            raise StoppedError.unsent(what, StoppedError.STATUS, "the arm is stopped; `hexwire resume` ends that")

    def _refuse_limp(self, joints: Sequence[str]) -> None:
        if joints:
            advice = f"{', '.join(joints)} has no torque; `hexwire torque on` first"
            raise CommandRefusedError("a move", int(Status.TORQUE_OFF), advice)


def _or_all(confirmed: tuple[str, ...] | None, names: tuple[str, ...]) -> tuple[str, ...]:
    return names if confirmed is None else confirmed
