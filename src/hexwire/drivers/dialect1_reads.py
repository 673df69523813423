"""Two-byte reads through a board that speaks dialect 1, and which of its answers to trust.

Owns the rules of PROTOCOL.md section 5 about late, damaged and mistaken answers of such a board. Must not know
joints, nor the meaning of the values.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from hexwire.errors import ReplyTimeoutError
from hexwire.ipc.session import Session
from hexwire.wire.command_frame import Command
from hexwire.wire.servo_packet import StatusPacket, find_status, make_read

__all__ = ["Dialect1Reader"]

_DOUBT = 1.0
"""Seconds for which a missing answer may still arrive."""
_ASKED_TWICE = 0.08
"""Seconds after which the board repeats a request; the first answer may still arrive."""
_CHECKS = 5
_ENOUGH = 3
_AGREE = 100
"""Counts by which two reads of a joint in motion may differ: 36 ms at 2800 counts/s."""


class Dialect1Reader:
    """Reader for one board.

    Args:
        session: A negotiated session.
        legacy: Whether each servo is of the legacy series, by id, as far as known.
    """

    def __init__(self, session: Session, legacy: Mapping[int, bool]) -> None:
        self._session = session
        self._legacy = legacy
        self._missed: dict[int, dict[int, float]] = {}

    def read(self, servo_id: int, address: int, *, urgent: bool = False, more: bool = True) -> StatusPacket | None:
        """Read two bytes of a servo; None if it, or the board, does not answer.

        The chapter's board keeps a late answer and returns it to the next request. The id exposes an answer of
        another servo, but not an answer of the same servo for another register. So after an unanswered read of
        another register, which the board requests twice, only three answers that agree are trusted.
        """
        now = self._session.now()
        missed = self._missed.get(servo_id, {})
        doubtful = any(other != address and now - when < _DOUBT for other, when in missed.items())
        status = self.read_once(servo_id, address, urgent=urgent, more=more)
        agreeing = 1
        for _ in range(_CHECKS if doubtful else 0):
            if status is None or agreeing == _ENOUGH:
                break
            again = self.read_once(servo_id, address, urgent=urgent, more=more)
            agrees = again is not None and abs(_value(again) - _value(status)) <= _AGREE
            status, agreeing = again, agreeing + 1 if agrees else 1
        return None if doubtful and agreeing < _ENOUGH else status

    def read_once(
        self, servo_id: int, address: int, *, urgent: bool, any_kind: bool = False, more: bool = True
    ) -> StatusPacket | None:
        try:
            reply = self._session.request(
                Command.READ, make_read(servo_id, address, 2), urgent=urgent, repeatable=True
            )
        except ReplyTimeoutError as error:
            self._missed.setdefault(servo_id, {})[address] = self._session.now()
            return self._read_beside(servo_id, address, urgent=urgent) if error.instead and more else None
        status, found = None, find_status(reply.body, servo_id, 2)
        # The board's form of "no answer"; a legacy servo with an error bit and value 0 looks the same.
        if found is not None and not (found[0].legacy and found[0].error == 1 and _value(found[0]) == 0):
            status = found[0] if any_kind or self.is_its_own(found[0]) else None
        if status is None or reply.rtt > _ASKED_TWICE:
            self._missed.setdefault(servo_id, {})[address] = self._session.now()
        return status

    def _read_beside(self, servo_id: int, address: int, *, urgent: bool) -> StatusPacket | None:
        """Read two bytes by the pairs before and after them, if the answer looks like the echo of its request.

        An HLS servo with error 2 at count 568 answers so. The high byte is read twice to match both bytes.
        """
        if self._legacy.get(servo_id, True):
            return None
        read = partial(self.read, servo_id, urgent=urgent, more=False)
        high = read(address + 1)
        low = high and read(address - 1)
        again = low and read(address + 1)
        if high is None or low is None or again is None or high.params[0] != again.params[0]:
            return None
        return low._replace(params=low.params[1:] + high.params[:1])

    def is_its_own(self, status: StatusPacket) -> bool:
        """Whether an answer has the header of this servo's series; a damaged echo has that of another."""
        return self._legacy.get(status.servo_id, status.legacy) == status.legacy


def _value(status: StatusPacket) -> int:
    return int.from_bytes(status.params, "little")
