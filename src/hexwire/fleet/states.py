"""The states of a shared arm as they arrive in a client.

Owns the newest state, waiting for the next one, and the conversion to this program's clock. Must not know leases,
orders or Zenoh.

A thread that waits for a state receives it itself, since a handover to another thread would take half as
long again. If several threads wait, one receives for all.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from typing import Protocol

from hexwire.errors import LinkClosedError, LinkLostError, RemoteProtocolError
from hexwire.model.state import JointState

from . import messages as m
from .clock import ClockOffset
from .rows import joint_state

__all__ = ["ArrivedStates", "StateInbox"]

_SILENT = 1.0
"""Seconds of silence after which the states of an earlier server count again."""
_TAKING = 1.0
"""Time-out for another thread that takes what has arrived, seconds."""
_SERVERS = 8
"""Number of earlier servers that are remembered."""


class StateInbox(Protocol):
    """Where states arrive. One thread at a time calls `wait` or `poll`."""

    def wait(self) -> bytes:
        """The next payload; empty after `wake`. Raises `LinkClosedError` if there will be none."""

    def poll(self) -> bytes | None:
        """The next payload; None if there is none yet. Raises as `wait`."""

    def wake(self) -> None:
        """End a `wait` in another thread."""


class ArrivedStates:
    """The newest state of an arm. Any thread may call its methods.

    Args:
        url: Address of the arm, for error texts.
        clock: Offset of the owner's clock.
        inbox: Where they arrive; None if the caller passes them to `add`.
        now: This program's monotonic clock, seconds.

    Attributes:
        newest: The newest message taken, or None; see `refresh`.
        arrived: When it was taken, seconds of this program's monotonic clock.
        seen: Number of messages.
        lost: Number of messages that did not arrive.
        damaged: Number of payloads that are not states.
    """

    def __init__(
        self,
        url: str,
        clock: ClockOffset,
        inbox: StateInbox | None = None,
        *,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.newest: m.State | None = None
        self.arrived = -math.inf
        # The newest that tells of joints, or why there are none, and when it was taken.
        self._telling: tuple[m.State, float] | None = None
        self.seen = self.lost = self.damaged = 0
        self._url, self._clock, self._inbox, self._now = url, clock, inbox, now
        self._done, self._dealt = 0, (0, 0)
        # Earlier servers, which may still run: two of the same name.
        self._former: dict[int, None] = {}
        # Taken by itself, since the condition takes it by a method of its own each time.
        self._lock = threading.RLock()
        self._changed = threading.Condition(self._lock)
        self._closed = False
        # The thread that receives, 0 for none, and when its wait is over; infinite while it does not wait.
        self._receiver, self._until = 0, math.inf

    def add(self, payload: bytes) -> None:
        """Take what arrived."""
        arrived, state = self._now(), self._decoded(payload)
        if state is not None:
            with self._lock:
                self._put(state, arrived)
                self._changed.notify_all()

    def _end_wait(self, payload: bytes, outer: tuple[int, float]) -> None:
        """Take what arrived, in one step with the end of receiving: the caller waits for it."""
        arrived, state = self._now(), self._decoded(payload)
        with self._lock:
            if state is not None:
                self._put(state, arrived)
            self._receiver, self._until = outer
            self._changed.notify_all()

    def _decoded(self, payload: bytes) -> m.State | None:
        if not payload:
            # From `wake`.
            return None
        try:
            state = m.decode(payload, m.State)
        except RemoteProtocolError:
            self.damaged += 1
            return None
        if not (math.isfinite(state.stamp) and math.isfinite(state.sent) and math.isfinite(state.wall)):
            self.damaged += 1
            return None
        return state

    def _put(self, state: m.State, arrived: float) -> None:
        before = self.newest
        if before is not None and state.server != before.server:
            if state.server in self._former and arrived - self.arrived < _SILENT:
                # A state of a newer server overtook it.
                return
            # A new server restarts its count, and may use another clock.
            self._former.pop(state.server, None)
            self._former = dict.fromkeys([*self._former, before.server][-_SERVERS:])
            self._done, self._dealt, self._telling = 0, (0, 0), None
        elif before is not None:
            if state.sequence <= before.sequence:
                # A newer one overtook it, or it arrived by two routes.
                return
            self.lost += state.sequence - before.sequence - 1
        self.seen += 1
        self.newest, self.arrived = state, arrived
        # One without joints and error only says that the server runs and its robot is busy.
        if state.names or state.error:
            self._telling = state, arrived

    def require(self, done: int) -> None:
        """Ignore states from before an order was done.

        Args:
            done: Number of orders done, as its answer says.
        """
        with self._lock:
            self._done = max(self._done, done)

    def require_dealt(self, lease: int, sequence: int) -> None:
        """Ignore states from before a published order was dealt with; see `messages.Stream`.

        Args:
            lease: Number of the lease; 0 for no such order.
            sequence: Number of the order.
        """
        self._dealt = lease, sequence

    def _is_after(self, state: m.State) -> bool:
        """Whether its values are from after all orders."""
        lease, sequence = self._dealt
        stream = state.stream
        pending = stream is not None and stream.lease == lease and stream.dealt < sequence
        return state.done >= self._done and not pending

    def refresh(self) -> None:
        """Take what has arrived, and end waits that have timed out. Call it regularly."""
        if self._inbox is None:
            return
        with self._lock:
            if receiving := self._is_receiving():
                # Let the other thread finish taking what arrived earlier.
                self._changed.wait_for(lambda: not self._is_receiving() or self._until < math.inf, _TAKING)
                receiving = self._is_receiving()
            late = self._now() >= self._until
        if not receiving:
            self._receive(None)
        elif late:
            self._inbox.wake()

    def close(self) -> None:
        """End the wait of all threads."""
        with self._lock:
            self._closed = True
            self._changed.notify_all()
        if self._inbox is not None:
            self._inbox.wake()

    def latest(self) -> JointState | None:
        """The newest state, without waiting for one; None if none has arrived yet. Raises as `next`."""
        self.refresh()
        with self._lock:
            if self._closed:
                raise self._detached()
            return None if self._telling is None else self._as_joint_state(*self._telling)

    def next(self, since: float, patience: float) -> JointState | None:
        """Wait for the first state that arrives after a time.

        Args:
            since: Seconds; may be in the future.
            patience: Seconds to wait after it, or up to the next call of `refresh`.

        Returns:
            None if none arrives.

        Raises:
            LinkLostError: The server has lost its robot; or the driver was detached.
        """
        deadline = max(self._now(), since) + patience
        while True:
            with self._lock:
                if self._closed:
                    break
                state = self.newest
                tells = state is not None and (state.names or state.error) and self._is_after(state)
                if state is not None and tells and self.arrived > since:
                    return self._as_joint_state(state, self.arrived)
                left = deadline - self._now()
                if left <= 0:
                    return None
                if self._inbox is None or self._is_receiving():
                    self._changed.wait(left)
                    continue
            self._receive(deadline)
        raise self._detached()

    def _detached(self) -> LinkLostError:
        return LinkLostError(f"{self._url} was detached", url=self._url)

    def _is_receiving(self) -> bool:
        """Whether another thread receives."""
        return self._receiver not in (0, threading.get_ident())

    def _receive(self, until: float | None) -> None:
        """Take what has arrived; if there is nothing and a time is given, wait for it until then."""
        inbox, me = self._inbox, threading.get_ident()
        assert inbox is not None
        outer = 0, math.inf
        try:
            with self._lock:
                if self._is_receiving():
                    return
                # In a signal handler: the wait that it interrupted goes on afterwards, and must end in time.
                outer = self._receiver, self._until
                self._receiver, self._until = me, math.inf
            payload = inbox.poll()
            if payload is None and until is not None:
                with self._lock:
                    self._until = until
                    self._changed.notify_all()
                self._end_wait(inbox.wait(), outer)
            while payload is not None:
                self.add(payload)
                payload = inbox.poll()
        except LinkClosedError:
            self._closed = True
        finally:
            # A signal handler may raise at any line: let another thread receive in any case.
            if self._receiver == me:
                self._receiver, self._until = outer
                with self._lock:
                    self._changed.notify_all()

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
