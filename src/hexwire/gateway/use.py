"""What a host does with a board: whether it may leave without the board having to stop.

Owns this judgement, from requests and the replies to them. No I/O and no time. Must not know queues or links.
"""

from __future__ import annotations

from hexwire.errors import RemoteProtocolError
from hexwire.session.effects import Effect, effect_of
from hexwire.wire.board_trajectory import BeginRequest, PathFlag, PathState, PathStatus, PointsRequest
from hexwire.wire.command_frame import Command, Frame, Status
from hexwire.wire.tables import EXT_REPLY, EXT_STATUS_MASK, PROTO_HEXWIRE

__all__ = ["Use"]

_WATCHDOG_BODY = 3
_MOST_ASKED = 512
"""Requests without an answer; a host has at most 256."""


class Use:
    """The use of one board by one host.

    Attributes:
        watched: The host has armed the board's watchdog.
        mode: What that watchdog does: 0 holds, 1 switches torque off.
    """

    def __init__(self) -> None:
        self.watched = False
        self.mode = 0
        self._asked: dict[tuple[int, int], Frame] = {}
        self._outlives = self._whole = self._runs = False
        self._forgot = False

    @property
    def in_order(self) -> bool:
        """Whether the host may leave: no watchdog is armed, no path runs, and nothing that acts is unanswered."""
        acts = (effect_of(PROTO_HEXWIRE, f.cmd, f.body) is not Effect.NONE for f in self._asked.values())
        return self.finishes or not (self.watched or self._runs or self._forgot or any(acts))

    @property
    def finishes(self) -> bool:
        """Whether the host wants a path that is wholly on the board to be finished without it."""
        return self._outlives and self._whole and self._runs

    def asked(self, frame: Frame) -> None:
        """Note a request."""
        self._asked[frame.src, frame.seq] = frame
        if len(self._asked) > _MOST_ASKED:
            # No host does that. What is forgotten may have acted.
            del self._asked[next(iter(self._asked))]
            self._forgot = True

    def ended(self, frame: Frame) -> None:
        """Note that a request will not be carried out."""
        self._asked.pop((frame.src, frame.seq), None)

    def answered(self, reply: Frame) -> None:
        """Note a reply of the board."""
        request = self._asked.get((reply.dst, reply.seq))
        if request is None or request.cmd != reply.cmd:
            return
        del self._asked[reply.dst, reply.seq]
        if reply.cmd_ext == EXT_REPLY | Status.OK:
            try:
                self._done(request, reply)
            except RemoteProtocolError:
                return
        elif reply.cmd_ext & EXT_STATUS_MASK == Status.STOPPED:
            self._runs = False

    def _done(self, request: Frame, reply: Frame) -> None:
        cmd, body = request.cmd, request.body
        if cmd == Command.WATCHDOG and len(body) == _WATCHDOG_BODY:
            self.watched, self.mode = body[:2] != b"\0\0", body[2]
        elif cmd == Command.TRAJECTORY_BEGIN:
            self._outlives = bool(BeginRequest.parse(body).flags & PathFlag.OUTLIVES_HOST)
            self._whole = self._runs = False
        elif cmd == Command.TRAJECTORY_START:
            self._runs = True
        elif cmd in (Command.STOP, Command.TRAJECTORY_ABORT):
            self._runs = False
        elif cmd in (Command.TRAJECTORY_POINTS, Command.TRAJECTORY_STATUS):
            if cmd == Command.TRAJECTORY_POINTS:
                self._whole = PointsRequest.parse(body).last == 1
            if PathStatus.parse(reply.body).state in (PathState.NONE, PathState.LOADING) or self._is_over(reply):
                self._runs = False

    @staticmethod
    def _is_over(reply: Frame) -> bool:
        return PathStatus.parse(reply.body).state.over
