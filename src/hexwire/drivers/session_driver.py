"""`SessionDriver`: a robot behind one or more sessions.

Owns what the sessions provide: address, clock, counters, reconnection. Must not know joints or commands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Self

from hexwire.arguments import Wanted, check
from hexwire.ipc.handle import IpcHandle
from hexwire.ipc.session import Session

from .abilities import Counters, Reconnects
from .base import RobotDriver

if TYPE_CHECKING:
    from hexwire.epochs import Epochs

__all__ = ["SessionDriver"]

_SESSION = Wanted("a Session, as in Session.from_url(...)", lambda value: isinstance(value, Session))


class SessionDriver(RobotDriver, Counters, Reconnects):
    """A robot behind sessions.

    Args:
        session: The session with the board or robot controller, which gives the robot's address and clock.
        *others: Further sessions with the same robot.

    Attributes:
        session: The session with the board or robot controller.
        sessions: Every session, `session` first, each once.
    """

    def __init__(self, session: Session, *others: Session) -> None:
        for each in (session, *others):
            check(type(self).__name__, "session", _SESSION, each)
        super().__init__()
        self.session = session
        self.sessions = tuple(dict.fromkeys((session, *others)))
        # A stop cancels the calls that wait at any of them.
        for other in self.sessions[1:]:
            other.share_stops(session)

    @classmethod
    def _on_link(cls, url: str, options: dict[str, Any]) -> Self:
        return cls(Session(IpcHandle.from_url(url)), **options)

    @property
    def url(self) -> str:
        return self.session.ipc.link.url

    @property
    def is_attached(self) -> bool:
        return self.session.is_open

    @property
    def epochs(self) -> Epochs:
        return self.session.epochs

    def _check_directions(self) -> None:
        """Refuse a channel that only receives before its port is opened, which may reset a board.

        Raises:
            ConfigError: A channel only receives, or its file is wrong.
        """
        for session in self.sessions:
            # The file is read by this, if there is one.
            assert session.ipc.link is not None
            session.ipc.check_sends("IDENTIFY")

    def now(self) -> float:
        return self.session.now()

    @property
    def round_trips(self) -> Sequence[float]:
        return self.session.rtts

    @property
    def restarts(self) -> int:
        return sum(session.board_restarts for session in self.sessions)

    def discard_reports(self) -> None:
        """As `StateReports.discard_reports`, for robots that report."""
        for session in self.sessions:
            session.poll_reports()

    def auto_reconnect(self, on: bool) -> None:
        for session in self.sessions:
            session.reconnect = replace(session.reconnect, enabled=on)

    def abort(self) -> None:
        for session in self.sessions:
            session.close()
