"""What a host asks of servos, in either dialect: checked by the gate, limited, and carried out.

Owns what is refused, clamped and read first before anything goes to the bus. Knows neither frames nor who asks.
"""

from __future__ import annotations

from collections.abc import Generator, Iterable

from hexwire.wire.command_frame import Status
from hexwire.wire.servo_packet import ServoPacket

from .board_bus import BoardBus, Clock, Job, Wait
from .board_chapter import ChapterRow
from .board_state import BoardState, JointSlot
from .gate import Admitted, Gate, RefusedError, clamp, time_needed, written_ids

__all__ = ["BoardOrders"]

Passing = Generator[Wait, bytes | None, Admitted]
Found = Generator[Wait, bytes | None, bool]


class BoardOrders:
    """Orders to the servos of one board.

    Args:
        state: What the board knows.
        bus: Its servos.
        clock: The board's time.
    """

    def __init__(self, state: BoardState, bus: BoardBus, clock: Clock) -> None:
        self._state = state
        self._bus = bus
        self._clock = clock

    def refuse_if_stopped(self) -> None:
        """Refuse the request while a stop is latched.

        Raises:
            RefusedError: A stop is latched.
        """
        if self._state.stopped:
            raise RefusedError(Status.STOPPED)

    def refuse_motion(self) -> None:
        """Refuse motion while a stop is latched or the board is in maintenance.

        Raises:
            RefusedError: A stop is latched, or the board is in maintenance.
        """
        self.refuse_if_stopped()
        if self._state.maintenance:
            raise RefusedError(Status.FORBIDDEN)

    def refuse_following(self, joints: Iterable[JointSlot]) -> None:
        """Refuse targets for joints of which one follows a trajectory.

        Raises:
            RefusedError: One does.
        """
        if any(joint.following for joint in joints):
            raise RefusedError(Status.BUSY)

    def clamp(self, joint: JointSlot, position: int) -> int:
        """Clamp a position to the joint's stored limits; records whether that changed it."""
        inside = clamp(self._state.facts_of(joint, self._clock()), position)
        joint.clamped = inside != position
        return inside

    def slowest(self, targets: list[tuple[JointSlot, int]]) -> int:
        """Shortest duration of a move that the speed limits allow, milliseconds."""
        facts_of, now = self._state.facts_of, self._clock()
        return max((time_needed(facts_of(joint, now), position) for joint, position in targets), default=0)

    def chapter_move(self, rows: list[ChapterRow], *, chapter: bool) -> Found:
        """The chapter's sync write: id, position and run time per row; checked like JOINT_MOVE.

        Returns:
            Whether a target could be sent to every joint.

        Raises:
            RefusedError: Stopped, in maintenance, a joint follows a trajectory, or in dialect 2 one has no torque.
        """
        state = self._state
        self.refuse_motion()
        named = [(joint, p, t) for i, p, t in rows if (joint := state.joint(i)) is not None]
        self.refuse_following(joint for joint, _, _ in named)
        yield from self.look_at([joint for joint, _, _ in named])
        able = [(j, p, t) for j, p, t in named if j.present and not j.mode]
        if not chapter and any(not j.torque_on for j, _, _ in able):
            raise RefusedError(Status.TORQUE_OFF)
        groups: dict[int, list[tuple[JointSlot, int]]] = {}
        for joint, position, run_time in able:
            groups.setdefault(run_time, []).append((joint, self.clamp(joint, position)))
        for run_time, group in groups.items():
            for joint, _ in group:
                # A target makes the servo switch its torque on; the switch is read back nevertheless.
                joint.torque_on = joint.unsure = True
            yield from self._bus.move(group, max(run_time, self.slowest(group)))
        return len(able) == len(named)

    def let_through(self, packet: ServoPacket, *, chapter: bool) -> Passing:
        """Check a well-formed packet of the host by the gate; returns what may go to the bus now.

        Raises:
            RefusedError: No part of it may.
        """
        state = self._state
        written = written_ids(packet)
        if written and not state.stopped:
            yield from self.look_at([j for j in state.joints if j.servo_id in written])
        passed = self._gate(chapter=chapter).judge(packet)
        if passed.hold:
            # A joint that gets torque must hold its present position: an older target would move it at once.
            yield from self._bus.poll_all()
            passed = self._gate(chapter=chapter).judge(packet)
            yield from self._bus.hold([j for j in state.joints if j.servo_id in passed.hold])
        return passed

    def _gate(self, *, chapter: bool) -> Gate:
        state = self._state
        return Gate(
            state.facts(self._clock()), chapter=chapter, stopped=state.stopped, maintenance=state.maintenance
        )

    def look_at(self, joints: list[JointSlot]) -> Job:
        """Update what the board knows of joints before it checks a target for them."""
        yield from self._bus.refresh()
        for joint in joints:
            if joint.present and joint.unsure:
                yield from self._bus.recheck(joint)
