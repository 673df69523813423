"""Counters of a servo bus. Knows nothing of how events are detected."""

from __future__ import annotations

from dataclasses import asdict, dataclass

__all__ = ["BusCounters"]


@dataclass(slots=True)
class BusCounters:
    """Counters of a bus since it was opened.

    Attributes:
        requests: Packets sent that expect an answer.
        answers: Status packets accepted.
        repeats: Requests repeated, to the servos without an answer only.
        lost: Answers that were late or damaged.
        given_up: Requests without an answer after all repeats.
        careful: Transactions that took the careful path.
        echoes: Echoes of requests.
        settled: Answers to another form of a request, used where a late answer could be taken for the new one.
        stray_bytes: Bytes that belonged to no answer.
    """

    requests: int = 0
    answers: int = 0
    repeats: int = 0
    lost: int = 0
    given_up: int = 0
    careful: int = 0
    echoes: int = 0
    settled: int = 0
    stray_bytes: int = 0

    def as_dict(self) -> dict[str, int]:
        """Return the counters by name."""
        return asdict(self)
