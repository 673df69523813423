"""Late replies that may still arrive on a servo bus, and recently sent packets.

Owns the two records that prevent wrong values: `LateReplies`, of requests that were given up, and `SentLately`, of
packets that an adapter may echo late, twice or damaged. No I/O; time comes in as `now`.

**The rule.** An answer identifies only its servo and its length. So while a late answer of some length may still
arrive from a servo, no answer of that length from that servo is trusted: registers are read with their neighbours,
in a length that is free. A request without an answer is forgotten `LATEST` after it was given up, or `AFTERMATH`
after the servo has answered a later one, since a servo answers requests in order.
"""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["AFTERMATH", "LATEST", "LateReplies", "SentLately"]

LATEST = 1.0
"""Seconds after which no late answer can arrive: no adapter delays bytes that long."""
AFTERMATH = 0.25
"""Seconds left after the servo has answered a later request. A line that keeps the order of bytes needs none."""
_MOST_SENT = 256
_LAST_SENT = 64


@dataclass(slots=True)
class _LateReply:
    asked: float
    until: float
    request: bytes


class LateReplies:
    """Late answers that may still arrive, by servo and by number of parameter bytes.

    Attributes:
        servos: Servos of which one may arrive; empty if there are none. Always the same object, so that checking it
            needs no call.
        ended: The time of one is over since this was last reset. It may have arrived unread: drain the line.
    """

    def __init__(self) -> None:
        self.ended = False
        self.servos: dict[int, dict[int, _LateReply]] = {}

    def add(self, servo_id: int, params: int, request: bytes, asked: float, now: float) -> None:
        """Record a request that was given up.

        Args:
            servo_id: The servo.
            params: Parameter bytes of the answer.
            request: The request.
            asked: Time of the request.
            now: Present time.
        """
        lengths = self.servos.setdefault(servo_id, {})
        before = lengths.get(params)
        if before is not None and before.request != request:
            request = b""
        lengths[params] = _LateReply(asked, now + LATEST, request)

    def holds(self, servo_id: int, params: int, now: float, request: bytes = b"") -> bool:
        """Whether an answer of that length may belong to an earlier request, and to another than `request`."""
        self._expire(servo_id, now)
        reply = self.servos.get(servo_id, {}).get(params)
        return reply is not None and (not request or reply.request != request)

    def answered(self, servo_id: int, params: int, now: float) -> None:
        """Record an answer of this length to a request after those that were given up."""
        for length, reply in self.servos.get(servo_id, {}).items():
            # An answer of the same length may be that of the earlier request; the later one's may still arrive.
            if length != params:
                reply.until = min(reply.until, now + AFTERMATH)

    def late(self, servo_id: int, params: int) -> float | None:
        """Return the time of the request that a late answer belongs to; None without one."""
        reply = self.servos.get(servo_id, {}).get(params)
        return None if reply is None else reply.asked

    def settled(self, servo_id: int, params: int) -> None:
        """Expect no late reply of a length any more: the servo has answered another request since."""
        lengths = self.servos.get(servo_id, {})
        lengths.pop(params, None)
        if not lengths:
            self.servos.pop(servo_id, None)

    def clear(self) -> None:
        """Expect no late reply any more."""
        self.servos.clear()

    def _expire(self, servo_id: int, now: float) -> None:
        lengths = self.servos.get(servo_id)
        if lengths is None:
            return
        for params in [n for n, reply in lengths.items() if reply.until <= now]:
            del lengths[params]
            self.ended = True
        if not lengths:
            del self.servos[servo_id]


class SentLately:
    """Packets whose echo may still arrive. Most reads are not kept: `servo_answers` recognises their echo.

    The last few are kept however old they are: a host that stalled receives their echoes late.
    """

    def __init__(self) -> None:
        self._when: dict[bytes, float] = {}
        self._prepared: set[bytes] = set()

    def prepare(self, packet: bytes) -> None:
        """Register a packet that may be sent at any time from now on without a call of `add`."""
        self._prepared.add(packet)

    def add(self, packet: bytes, now: float) -> None:
        """Record a packet that is sent now."""
        when = self._when
        when.pop(packet, None)
        when[packet] = now
        if len(when) > _MOST_SENT:
            self._when = self._recent(now)

    def packets(self, now: float) -> set[bytes]:
        """Return the packets of the last `LATEST` seconds, the last few, and the prepared ones."""
        lately = self._when if len(self._when) <= _LAST_SENT else self._recent(now)
        return self._prepared.union(lately)

    def _recent(self, now: float) -> dict[bytes, float]:
        old = len(self._when) - _LAST_SENT
        rows = enumerate(self._when.items())
        return {sent: at for place, (sent, at) in rows if place >= old or at > now - LATEST}
