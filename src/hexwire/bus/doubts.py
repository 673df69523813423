"""Which answers may still come on a servo bus though nobody waits for them any more, and what was sent lately.

Owns the two memories that keep a wrong value out: `Doubts`, of requests that were given up, and `SentLately`, of
packets that an adapter may echo late, twice or damaged. Sans I/O; time comes as `now`.

**The rule.** An answer names its servo and its length, and nothing else. So as long as an answer of some length
may still come from a servo, nothing that is answered in that length is believed of it: registers are read with
their neighbours, in a length that is free. A request that was not answered is forgotten `LATEST` after it was given
up, or `AFTERMATH` after the servo has answered a later one: a servo answers in the order in which it is asked.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["AFTERMATH", "LATEST", "Doubts", "SentLately"]

LATEST = 1.0
"""Seconds after which nothing is on the way any more: no adapter holds bytes back that long."""
AFTERMATH = 0.25
"""Seconds that remain once the servo has answered a later request. A line that keeps its order needs none."""
_MOST_SENT = 256
_LAST_SENT = 64


@dataclass(slots=True)
class _Doubt:
    asked: float
    until: float
    request: bytes


class Doubts:
    """Answers that may still come, by servo and by parameter bytes.

    Attributes:
        servos: Whose; empty if nothing is on the way. The same object always, so that a look at it costs no call.
        ended: A doubt has ended by itself since somebody last reset this. What it was about may have come while
            nobody read: the line wants to be emptied.
    """

    def __init__(self) -> None:
        self.ended = False
        self.servos: dict[int, dict[int, _Doubt]] = {}

    def add(self, servo_id: int, params: int, request: bytes, asked: float, now: float) -> None:
        """A request was given up.

        Args:
            servo_id: Who was asked.
            params: Parameter bytes of the answer.
            request: What was asked.
            asked: When.
            now: The time.
        """
        lengths = self.servos.setdefault(servo_id, {})
        before = lengths.get(params)
        if before is not None and before.request != request:
            request = b""
        lengths[params] = _Doubt(asked, now + LATEST, request)

    def holds(self, servo_id: int, params: int, now: float, request: bytes = b"") -> bool:
        """Whether an answer of that length may be another request's than this one's, or any if none is given."""
        self._expire(servo_id, now)
        doubt = self.servos.get(servo_id, {}).get(params)
        return doubt is not None and (not request or doubt.request != request)

    def answered(self, servo_id: int, params: int, now: float) -> None:
        """A servo has answered in this length a request that came after those in doubt."""
        for length, doubt in self.servos.get(servo_id, {}).items():
            # In the same length it may have been the earlier one's answer, and then the later one's is on the way.
            if length != params:
                doubt.until = min(doubt.until, now + AFTERMATH)

    def late(self, servo_id: int, params: int) -> float | None:
        """When the request was sent whose answer has come after all; None if there was none."""
        doubt = self.servos.get(servo_id, {}).get(params)
        return None if doubt is None else doubt.asked

    def settled(self, servo_id: int, params: int) -> None:
        """No answer of that length is on the way from this servo: it has answered something else since."""
        lengths = self.servos.get(servo_id, {})
        lengths.pop(params, None)
        if not lengths:
            self.servos.pop(servo_id, None)

    def clear(self) -> None:
        """Nothing is on the way."""
        self.servos.clear()

    def _expire(self, servo_id: int, now: float) -> None:
        lengths = self.servos.get(servo_id)
        if lengths is None:
            return
        for params in [n for n, doubt in lengths.items() if doubt.until <= now]:
            del lengths[params]
            self.ended = True
        if not lengths:
            del self.servos[servo_id]


class SentLately:
    """Packets whose echo may still come. Most reads are not kept: `servo_answers` knows their echo by its form.

    The last few are kept however old they are: a host that stood still finds their echoes only now.
    """

    def __init__(self) -> None:
        self._when: dict[bytes, float] = {}
        self._prepared: set[bytes] = set()

    def prepare(self, packet: bytes) -> None:
        """A packet may go out at any time from now on without a word."""
        self._prepared.add(packet)

    def add(self, packet: bytes, now: float) -> None:
        """A packet goes out."""
        when = self._when
        when.pop(packet, None)
        when[packet] = now
        if len(when) > _MOST_SENT:
            self._when = self._recent(now)

    def packets(self, now: float) -> set[bytes]:
        """What was sent within the last `LATEST` seconds, the last few besides, and what was prepared."""
        lately = self._when if len(self._when) <= _LAST_SENT else self._recent(now)
        return self._prepared.union(lately)

    def _recent(self, now: float) -> dict[bytes, float]:
        old = len(self._when) - _LAST_SENT
        rows = enumerate(self._when.items())
        return {sent: at for place, (sent, at) in rows if place >= old or at > now - LATEST}
