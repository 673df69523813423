"""Deadlines, retries and reconnection: one frozen value each, applied in one place.

Owns the numbers. The connection applies `RetryPolicy`, the session applies `ReconnectPolicy`.
"""

from __future__ import annotations

from dataclasses import dataclass

from hexwire.wire import tables

__all__ = ["ReconnectPolicy", "RetryPolicy"]


@dataclass(frozen=True, slots=True)
class RetryPolicy:
    """Time to wait for an answer, and number of attempts.

    Attributes:
        attempts: Number of times that a request is sent before it counts as unanswered.
        window: Seconds for an answer in dialect 2.
        dialect1_window: Seconds for an answer in dialect 1.
        dialect1_holdoff: Seconds of pause after a frame of dialect 1 that is never answered: the chapter's board
            loses bytes that arrive while it writes to the bus.
    """

    attempts: int = 3
    window: float = tables.DIALECT2_REPLY_WINDOW
    dialect1_window: float = tables.DIALECT1_REPLY_WINDOW
    dialect1_holdoff: float = 0.030


@dataclass(frozen=True, slots=True)
class ReconnectPolicy:
    """Reconnection after the port is lost.

    Attributes:
        enabled: Whether to open it again.
        give_up_after: Seconds after which the loss is final.
        interval: Seconds between attempts.
    """

    enabled: bool = True
    give_up_after: float = 10.0
    interval: float = 0.25
