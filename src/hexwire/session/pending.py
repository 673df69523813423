"""One request of a host that waits for its answer.

Owns the facts of its attempts. Must not know when the next one is due, nor how frames are made.
"""

from __future__ import annotations

from dataclasses import dataclass, field

__all__ = ["Pending"]


@dataclass(slots=True)
class Pending:
    """A request that was sent at least once.

    Attributes:
        ticket: What the caller knows it by.
        seq: Its number on the wire.
        window: Seconds for each answer.
        attempts: Most times that it is sent.
        sent: Times that it has been sent.
        sent_at: Time of the last attempt.
        deadline: Time at which that attempt is over.
        instead: What arrived instead of the answer, in words.
        message_id: Its message in fragments; None if it fits a frame.
        urgent: It is a stop.
        frames: Frames of the last attempt; those not written yet can still be withheld.
    """

    ticket: int
    cmd: int
    body: bytes
    seq: int
    window: float
    attempts: int
    sent: int = 0
    sent_at: float = 0.0
    deadline: float = 0.0
    instead: str = ""
    message_id: int | None = None
    urgent: bool = False
    frames: list[bytes] = field(default_factory=list)

    def begin_attempt(self, now: float) -> None:
        """Count one more attempt, whose window begins now."""
        self.sent += 1
        self.sent_at = now
        self.extend(now)

    def extend(self, now: float) -> None:
        """Begin the window of this attempt anew: the peer is still busy with the request."""
        self.deadline = now + self.window
