"""What happened on a servo bus, in numbers. Knows nothing of how it is found out."""

from __future__ import annotations

from dataclasses import asdict, dataclass

__all__ = ["BusCounters"]


@dataclass(slots=True)
class BusCounters:
    """What happened on a bus since it was opened.

    Attributes:
        requests: Packets sent that want an answer.
        answers: Status packets taken.
        repeats: Requests sent again, for those servos only that had not answered.
        lost: Answers that did not come in time, or came damaged.
        given_up: Questions without an answer after all repeats.
        careful: Transactions that the fast path did not recognise at a glance.
        echoes: Requests that came back.
        settled: Answers got by asking in another way, since one to an earlier request might have come instead.
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
        """By name."""
        return asdict(self)
