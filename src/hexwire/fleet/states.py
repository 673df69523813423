"""The states of a shared arm as they arrive in a client.

Owns the newest state, waiting for the next one, and the conversion to this program's clock. Must not know leases,
orders or Zenoh.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable

from hexwire.errors import LinkLostError, RemoteProtocolError
from hexwire.model.state import JointState

from . import messages as m
from .clock import ClockOffset
from .rows import joint_state

__all__ = ["ArrivedStates"]


_SILENT = 1.0
"""Seconds of silence of a server after which one that was there before it counts again."""
_SERVERS = 8
"""Servers of before that are remembered."""


class ArrivedStates:
    """The newest state of an arm. One thread adds, any thread reads.

    Args:
        url: Address of the arm, for error texts.
        clock: Offset of the owner's clock.
        now: This program's monotonic clock, seconds.

    Attributes:
        newest: The newest message, or None.
        arrived: When it arrived, seconds of this program's monotonic clock.
        seen: Number of messages.
        lost: Number of messages that did not arrive.
        damaged: Number of payloads that are not states.
    """

    def __init__(self, url: str, clock: ClockOffset, *, now: Callable[[], float] = time.monotonic) -> None:
        self.newest: m.State | None = None
        self.arrived = -math.inf
        self.seen = self.lost = self.damaged = 0
        self._url, self._clock, self._now = url, clock, now
        self._done = 0
        # Servers of before, which may still be there: two of one name.
        self._former: dict[int, None] = {}
        self._changed = threading.Condition()
        self._closed = False

    def add(self, payload: bytes) -> None:
        """Take what arrived."""
        arrived = self._now()
        try:
            state = m.decode(payload, m.State)
        except RemoteProtocolError:
            self.damaged += 1
            return
        if not all(map(math.isfinite, (state.stamp, state.sent, state.wall))):
            self.damaged += 1
            return
        with self._changed:
            before = self.newest
            if before is not None and state.server != before.server:
                if state.server in self._former and arrived - self.arrived < _SILENT:
                    # It was overtaken by the first state of a server that was started since.
                    return
                # Another server counts anew, and perhaps by another clock.
                self._former.pop(state.server, None)
                self._former = dict.fromkeys([*self._former, before.server][-_SERVERS:])
                self._done = 0
            elif before is not None:
                if state.sequence <= before.sequence:
                    # It was overtaken on its way, or comes on two ways.
                    return
                self.lost += state.sequence - before.sequence - 1
            self.seen += 1
            self.newest, self.arrived = state, arrived
            self._changed.notify_all()

    def require(self, done: int) -> None:
        """Ignore states from before an order was done.

        Args:
            done: Number of orders done, as its answer says.
        """
        with self._changed:
            self._done = max(self._done, done)

    def close(self) -> None:
        """End the wait of other threads."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def next(self, since: float, patience: float) -> JointState | None:
        """Wait for the first state that arrives after a time.

        Args:
            since: Seconds; may be in the future.
            patience: Seconds to wait after it.

        Returns:
            None if none arrives.

        Raises:
            LinkLostError: The server has lost its robot; or the driver was detached.
        """
        deadline = max(self._now(), since) + patience
        with self._changed:
            while not self._closed:
                state = self.newest
                # One without joints only says that the server lives and its robot is busy, unless it is lost.
                tells = state is not None and (state.names or state.error) and state.done >= self._done
                if state is not None and tells and self.arrived > since:
                    return self._as_joint_state(state, self.arrived)
                left = deadline - self._now()
                if left <= 0:
                    return None
                self._changed.wait(left)
        raise LinkLostError(f"{self._url} was detached", url=self._url)

    def _as_joint_state(self, state: m.State, arrived: float) -> JointState:
        url = self._url
        if state.error:
            raise LinkLostError(f"{url}: {state.error}", url=url)
        offset, _ = self._clock.at(arrived)
        try:
            # Not after its arrival, whatever the uncertainty.
            return joint_state(state, min(state.stamp - offset, arrived))
        except RemoteProtocolError as error:
            raise RemoteProtocolError(f"{url}: {error}") from None
