"""Times and durations of `builtin_interfaces` as plain numbers, and back.

Owns both ways. Must not know clocks.
"""

from __future__ import annotations

from typing import Any

__all__ = ["nanoseconds_of", "seconds_of", "time_fields"]


def nanoseconds_of(time: Any) -> int:
    """A builtin_interfaces Time or Duration in nanoseconds."""
    return int(time.sec) * 1_000_000_000 + int(time.nanosec)


def time_fields(nanoseconds: int) -> dict[str, int]:
    """The fields of a builtin_interfaces Time or Duration."""
    seconds, rest = divmod(nanoseconds, 1_000_000_000)
    return {"sec": seconds, "nanosec": rest}


def seconds_of(time: Any) -> float:
    """A builtin_interfaces Time or Duration in seconds."""
    return nanoseconds_of(time) / 1e9
