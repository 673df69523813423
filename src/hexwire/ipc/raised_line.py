"""The host line of a board at a raised rate (PROTOCOL.md section 6.8): raised, checked, kept, and lowered again.

Owns which of the two rates the port has, and the request that keeps the board at the raised one. Must not know
joints.

The board goes back to its own rate by itself, after a reset or when this program stalls. So a request that gets no
answer twice is repeated at the board's own rate, and from its answer on the port stays there: the rate is not
raised again, because something may move by then.
"""

from __future__ import annotations

import contextlib
import logging
import threading
from typing import TYPE_CHECKING, Any

from hexwire.errors import HexwireError, LinkError, ReplyTimeoutError, UsageError
from hexwire.session.connection import Connection
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Status, status_name

if TYPE_CHECKING:
    from collections.abc import Callable

    from hexwire.link.serial_port import SerialPortLink
    from hexwire.session.events import Reply
    from hexwire.wire.commands import Identity

__all__ = ["RaisedLine", "raise_line"]

_log = logging.getLogger(__name__)

_ANSWER = 0.8
"""Seconds in which the board answers: it reads positions twice, 0.1 s apart, and silent servos take longer."""
_SWITCHED = 0.02
_CHECK = 0.1
"""Seconds for the answer to a check."""
_LONG = 200
_CHECKS = 3 * (b"", bytes(_LONG), b"\xff" * _LONG, b"\x55" * _LONG, b"\x33\xcc" * (_LONG // 2))
"""Bodies of STATS. Its reply is long; with a body it is refused, which shows that a long frame arrived whole."""
_KEEP = 0.5
"""Seconds between two requests that keep the rate: a fraction of the board's 2 s."""
_BACK = tables.HOST_BAUD_TRIAL + tables.HOST_BAUD_SILENCE + 0.5
"""Seconds in which a board is back at its own rate, whatever it heard last."""
_RAISED_TRIES = 2


def raise_line(
    link: Any, identity: Identity | None, request: Callable[..., Reply], now: Callable[[], float]
) -> RaisedLine | None:
    """Raise the rate of a line, if its address asks for that.

    Args:
        link: The open link.
        identity: The board's; None if it speaks dialect 1.
        request: As `Session.request`.
        now: As `Session.now`.

    Returns:
        The raised line; None if it stays as it is, and why is said in one line.

    Raises:
        LinkError: The port was lost.
        ReplyTimeoutError: The board answers at neither rate.
    """

    def ask(cmd: int, body: bytes, window: float | None) -> int:
        return request(cmd, body, window=window, attempts=None if window is None else 1).status

    if not getattr(link, "raise_to", 0) or link.raise_to == link.baud:
        return None
    line = RaisedLine(link, ask, now)
    return line if line.raise_rate(0 if identity is None else identity.capabilities) else None


class RaisedLine:
    """The rate of one open port.

    Args:
        port: The link.
        ask: Sends a request once and waits so many seconds for the answer; with None as often and long as usual.
            Returns the status; raises HexwireError.
        now: Monotonic seconds, the clock of the link's deadlines.

    Attributes:
        is_raised: Whether the rate is raised, and not known to have gone back.
    """

    def __init__(
        self,
        port: SerialPortLink,
        ask: Callable[[int, bytes, float | None], int],
        now: Callable[[], float],
    ) -> None:
        self._port = port
        self._ask, self._now = ask, now
        self.own, self.wanted = self._port.baud, self._port.raise_to
        self.is_raised = False
        self._misses = self._failed = self._frames = self._replies = 0
        self._ended = threading.Event()

    # -- raising ------------------------------------------------------------------------------------

    def raise_rate(self, capabilities: int) -> bool:
        """Raise the rate and check it; if that fails, say so in one line and use the board's own.

        Args:
            capabilities: Of the board.

        Returns:
            Whether it is raised.

        Raises:
            LinkError: The port was lost.
            ReplyTimeoutError: The board answers at neither rate.
        """
        problem = self._ask_board(capabilities)
        if problem:
            return self._stays(problem)
        try:
            self._port.set_rate(self.wanted)
        except UsageError as error:
            return self._go_back(str(error))
        end = self._now() + _SWITCHED
        while self._now() < end:
            # What comes meanwhile was heard at a wrong rate.
            self._port.read(end)
        lost = sum(not self._answers(body) for body in _CHECKS)
        if lost:
            return self._go_back(f"{lost} of {len(_CHECKS)} exchanges failed")
        self.is_raised = True
        threading.Thread(target=self._keep, name="hexwire line rate", daemon=True).start()
        _log.info("%s: raised to %d baud", self._port.url, self.wanted)
        return True

    def _ask_board(self, capabilities: int) -> str:
        """Have the board change its rate; returns why it does not."""
        if not capabilities & tables.CAPABILITY_HOST_BAUD:
            return "the board cannot change it"
        try:
            status = self._ask(Command.HOST_BAUD, self.wanted.to_bytes(4, "little"), _ANSWER)
        except ReplyTimeoutError:
            # The board may have changed its rate, and only the answer was lost.
            self._await_board()
            return "the board did not answer the request for it"
        if status == Status.BUSY:
            return "something moves"
        return "" if status == Status.OK else f"the board refuses it ({status_name(status)})"

    def _answers(self, body: bytes) -> bool:
        try:
            return self._ask(Command.STATS, body, _CHECK) == (Status.BAD_LENGTH if body else Status.OK)
        except ReplyTimeoutError:
            return False

    def _stays(self, why: str) -> bool:
        text = "%s: the rate stays at %d baud instead of %d: %s"
        _log.warning(text, self._port.url.partition("?")[0], self.own, self.wanted, why)
        return False

    def _go_back(self, why: str) -> bool:
        self._port.set_rate(self.own)
        self._await_board()
        return self._stays(why)

    def _await_board(self) -> None:
        """Wait until the board is back at its own rate."""
        end = self._now() + _BACK
        while not self._answers(b""):
            if self._now() >= end:
                self._ask(Command.STATS, b"", None)
                return
            self._port.flush_input()

    # -- while it is raised -------------------------------------------------------------------------

    def watch(self, connection: Connection) -> None:
        """Choose the rate for the bytes that are written next."""
        if not self.is_raised:
            return
        counters, frames = connection.counters, connection.decoder.counters.frames
        failed = counters.retries + counters.timeouts
        self._replies = counters.replies
        if frames != self._frames:
            self._frames, self._misses = frames, 0
            if self._port.baud == self.own:
                self._went_back()
                return
        elif failed != self._failed:
            self._misses += 1
        self._failed = failed
        own = self._misses >= _RAISED_TRIES and self._misses % 2 == 0
        rate = self.own if own else self.wanted
        if self._port.baud != rate:
            self._port.set_rate(rate)
            # A frame that is read from now on was received at this rate.
            self._port.flush_input()

    def _went_back(self) -> None:
        self._end()
        text = "%s: the board is back at %d baud: it was reset, or this program stalled"
        _log.warning(text, self._port.url.partition("?")[0], self.own)

    def _keep(self) -> None:
        """Keep the board at the raised rate while this program asks nothing else."""
        replies = -1
        while not self._ended.wait(_KEEP):
            if self._replies == replies:
                try:
                    self._ask(Command.HOST_BAUD, self.wanted.to_bytes(4, "little"), None)
                except LinkError:
                    return
                except HexwireError as error:
                    _log.debug("%s: %s", self._port.url, error)
            replies = self._replies

    # -- the end ------------------------------------------------------------------------------------

    def lower(self) -> None:
        """Put the board back to its own rate, so that the next program finds it there at once."""
        if not self.is_raised:
            return
        self._end()
        try:
            self._ask(Command.HOST_BAUD, self.own.to_bytes(4, "little"), _CHECK)
        except HexwireError as error:
            # It goes back by itself.
            _log.debug("%s: %s", self._port.url, error)

    def forget(self) -> None:
        """The port is closed, or about to be: it opens at its own rate."""
        self._end()
        with contextlib.suppress(HexwireError):
            self._port.set_rate(self.own)

    def _end(self) -> None:
        self.is_raised = False
        self._ended.set()
