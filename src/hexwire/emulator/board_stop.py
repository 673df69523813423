"""The stops of an emulated board: which goes first, what a hold does, and whether the joints are at rest.

Implements STOP of PROTOCOL.md section 6.3 and the last paragraph of 6.5. Knows requests only as something to answer
at the end; what a stop voids belongs to `board`.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, field

from hexwire.session.events import Request

from .board_bus import BoardBus, Clock, Job, Pause, Wait
from .board_state import JointSlot

__all__ = ["StopQueue", "StopResult", "Stopping"]

_MAX_STOPS = 16
_HOLD, _TORQUE_OFF = 0, 1
_SETTLE_TIME = 0.4
"""Seconds that a joint has to come to rest."""
_SAMPLE_EVERY = 0.02
_STILL = 4
"""Counts between two samples of a joint at rest."""
_SAMPLES = 2
"""Consecutive samples needed at rest: a joint that reverses may be at the same position in two samples."""


class StopQueue:
    """Stops that wait or are under way, each with the request it answers; None is the watchdog's."""

    def __init__(self) -> None:
        self.mode: int | None = None
        self._waiting: list[tuple[int, Request | None]] = []
        self._under_way: list[Request | None] = []

    def __bool__(self) -> bool:
        return bool(self._waiting)

    def add(self, mode: int, request: Request | None) -> bool:
        """Queue a stop; False if there is no room for its answer.

        A stop of the mode that is under way is answered together with that one.
        """
        if request is not None and len(self._waiting) + len(self._under_way) >= _MAX_STOPS:
            return False
        if mode == self.mode:
            self._under_way.append(request)
        else:
            self._waiting.append((mode, request))
        return True

    @property
    def interrupts(self) -> bool:
        """Whether a waiting stop goes ahead of the one under way: torque off goes ahead of hold."""
        return self.mode == _HOLD and any(mode == _TORQUE_OFF for mode, _ in self._waiting)

    def put_back(self) -> None:
        """Queue the interrupted stop again."""
        if self.mode is not None:
            self._waiting = [(self.mode, request) for request in self._under_way] + self._waiting
            self.mode, self._under_way = None, []

    def start(self) -> int:
        """Start the next stop and return its mode; all requests for that mode are answered together."""
        mode = self.mode = max(mode for mode, _ in self._waiting)
        self._under_way = [request for m, request in self._waiting if m == mode]
        self._waiting = [(m, request) for m, request in self._waiting if m != mode]
        return mode

    def finish(self) -> list[Request]:
        """End the current stop; returns the requests it answers, in the order of their arrival."""
        done = [request for request in self._under_way if request is not None]
        self.mode, self._under_way = None, []
        return done


@dataclass(slots=True)
class StopResult:
    """The result of a stop.

    Attributes:
        mask: Joints, by index, that hold still or have no torque.
        taken: Torque was switched off at a joint that did not hold.
    """

    mask: int
    taken: bool


@dataclass(slots=True)
class _Held:
    """One joint that is coming to rest."""

    joint: JointSlot
    goal: int | None = None
    last: int | None = None
    took_target: bool = False
    stood: int = 0

    @property
    def holds(self) -> bool:
        return self.took_target and self.stood >= _SAMPLES

    def sample(self, position: int) -> None:
        """Take a new position."""
        if self.stood < _SAMPLES:
            still = self.last is not None and abs(position - self.last) <= _STILL
            self.stood = self.stood + 1 if still else 0
        self.last = position


@dataclass(slots=True)
class Stopping:
    """One stop of one board, as a job of its bus."""

    joints: list[JointSlot]
    bus: BoardBus
    clock: Clock
    mask: int = 0
    taken: bool = False
    held: list[_Held] = field(default_factory=list)

    def run(self, mode: int) -> Generator[Wait, bytes | None, StopResult]:
        """Stop the joints."""
        bus, joints = self.bus, self.joints
        if mode == _TORQUE_OFF:
            return StopResult((yield from bus.torque_off(joints)), taken=False)
        yield from bus.poll_all()
        for joint in joints:
            if joint.present and joint.unsure:
                yield from self._look(joint)
        yield from self._hold([j for j in joints if j.torque_on or (j.unsure and j.sampled_at is not None)])
        for joint in joints:
            # Joints believed to have no torque are read as well: only their answer is certain.
            if joint.present and not self._is_held(joint) and not self.mask & self._bit(joint):
                yield from self._look(joint)
                if joint.torque_on:
                    yield from self._hold([joint])
                elif not joint.unsure:
                    self.mask |= self._bit(joint)
        yield from self._settle()
        failed = [h.joint for h in self.held if not h.holds]
        if failed:
            yield from self._take_torque(failed)
        return StopResult(self.mask | sum(self._bit(h.joint) for h in self.held), self.taken)

    def _bit(self, joint: JointSlot) -> int:
        return 1 << self.joints.index(joint)

    def _is_held(self, joint: JointSlot) -> bool:
        return any(h.joint is joint for h in self.held)

    def _look(self, joint: JointSlot) -> Job:
        """Read mode and torque; a joint with torque that is not in position mode loses it at once."""
        bus = self.bus
        yield from bus.read_switches(joint)
        if joint.torque_on and joint.mode:
            yield from self._take_torque([joint])
        elif joint.torque_on:
            yield from bus.read_ceiling(joint)

    def _take_torque(self, joints: list[JointSlot]) -> Job:
        self.taken = True
        self.held = [h for h in self.held if h.joint not in joints]
        self.mask |= yield from self.bus.torque_off(joints)

    def _hold(self, joints: list[JointSlot]) -> Job:
        """Make the present positions the targets, and read the targets back."""
        bus = self.bus
        self.held += [_Held(joint) for joint in joints]
        yield from bus.hold(joints)
        for held in self.held:
            if held.joint in joints:
                held.goal = held.last = held.joint.position
                yield from self._read_back(held)

    def _read_back(self, held: _Held) -> Job:
        joint = held.joint
        yield from self.bus.read_switches(joint)
        if joint.mode and not joint.unsure:
            # In another mode it keeps turning, whatever its target is.
            yield from self._take_torque([joint])
            return
        target = yield from self.bus.read_target(joint)
        held.took_target = target is not None and target == held.goal

    def _settle(self) -> Job:
        """Read positions until every joint is at rest at its target, or the time is up."""
        until = self.clock() + _SETTLE_TIME
        while self.clock() < until and any(not h.holds and self._worth_waiting(h) for h in self.held):
            began = self.clock()
            missing = [h.joint for h in self.held if not h.took_target and h.joint.sampled_at is not None]
            if missing:
                again = [h for h in self.held if h.joint in missing]
                yield from self.bus.hold(missing)
                for held in again:
                    held.goal = held.joint.position
                    yield from self._read_back(held)
            yield Pause(max(0.0, began + _SAMPLE_EVERY - self.clock()))
            yield from self.bus.poll_all()
            for held in self.held:
                if held.joint.present:
                    held.sample(held.joint.position)

    @staticmethod
    def _worth_waiting(held: _Held) -> bool:
        return held.joint.present or held.joint.torque_on
