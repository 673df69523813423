"""One thread for all callbacks of a node: what arrives waits in bounded inboxes and is handled in order of arrival.

Owns that thread, and its relief: where a callback hangs in an answer to a client that takes nothing, another thread
goes on with the rest, a stop among them. Must not know Zenoh, nor what arrives.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Generic, TypeVar

__all__ = ["Callbacks", "Inbox"]

_log = logging.getLogger(__name__)
_T = TypeVar("_T")
_PATIENCE = 5.0
"""Most seconds for the callback that runs when the node is closed."""
_RELIEF = 0.05
"""Seconds after which another thread goes on."""
_MOST_STUCK = 8
"""Most threads that hang at the same time."""


class Inbox(Generic[_T]):
    """What waits for one callback; when it is full, the oldest is dropped.

    Attributes:
        dropped: How many were dropped.
    """

    def __init__(self, owner: Callbacks, depth: int, handle: Callable[[_T], object]) -> None:
        self._owner, self._depth, self._handle = owner, depth, handle
        self._items: deque[_T] = deque()
        self.dropped = 0

    def put(self, item: _T) -> _T | None:
        """Add an item; does not wait. Returns the oldest one if it was dropped for it."""
        owner = self._owner
        with owner.changed:
            if owner.stopping:
                return item
            old = None
            if len(self._items) >= self._depth:
                old = self._items.popleft()
                self.dropped += 1
            else:
                # As many entries as items: whoever drops one keeps the entry for the next.
                owner.ready.append(self)
            self._items.append(item)
            owner.changed.notify()
            owner.watch()
            return old

    def take(self) -> Callable[[], object]:
        """The next item with its callback; only with the lock."""
        item = self._items.popleft()
        return lambda: self._handle(item)


class Callbacks:
    """The thread that runs callbacks. A callback that raises is logged and changes nothing for the others.

    Attributes:
        changed: The lock of all this, notified when something waits.
        ready: An entry for each item that waits; only with the lock.
        stopping: Whether it has ended.
    """

    def __init__(self, name: str) -> None:
        self.changed = threading.Condition()
        self.ready: deque[Inbox[Any]] = deque()
        self.stopping = False
        self._name = name
        self._thread = self._new_thread()
        self._hanging: object | None = None
        self._stuck = 0
        self._watched, self._ended = threading.Event(), threading.Event()
        self._relief = threading.Thread(target=self._relieve, name=f"relief of {name}", daemon=True)

    def inbox(self, depth: int, handle: Callable[[_T], object]) -> Inbox[_T]:
        """A new inbox.

        Args:
            depth: Most items that wait.
            handle: Gets each item, in the thread of callbacks.
        """
        return Inbox(self, max(1, depth), handle)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()
        self._relief.start()

    def stop(self) -> None:
        """End the thread; what waits is dropped."""
        with self.changed:
            self.stopping = True
            self.ready.clear()
            self.changed.notify_all()
            threads = [self._thread, self._relief]
        self._ended.set()
        self._watched.set()
        for thread in threads:
            if thread.ident is not None and thread is not threading.current_thread():
                thread.join(_PATIENCE)

    @property
    def is_current(self) -> bool:
        """Whether this is the thread of callbacks."""
        return self._thread is threading.current_thread()

    @contextmanager
    def may_hang(self) -> Iterator[None]:
        """Whatever is done inside may hang: if it does, another thread runs the callbacks from then on."""
        if not self.is_current:
            yield
            return
        token = object()
        with self.changed:
            self._hanging = token
            self.watch()
        try:
            yield
        finally:
            with self.changed:
                if self._hanging is token:
                    self._hanging = None

    def watch(self) -> None:
        """Have the relief look, if something waits for a thread that may hang; only with the lock."""
        if self._hanging is not None and self.ready and not self._watched.is_set():
            self._watched.set()

    def _new_thread(self) -> threading.Thread:
        return threading.Thread(target=self._run, name=f"callbacks of {self._name}", daemon=True)

    def _run(self) -> None:
        while True:
            with self.changed:
                while self.is_current and not self.ready and not self.stopping:
                    self.changed.wait()
                if self.stopping or not self.is_current:
                    self._stuck -= not self.is_current
                    return
                call = self.ready.popleft().take()
            try:
                call()
            except Exception:  # noqa: BLE001  # logged; a faulty callback must not end the node
                _log.exception("a callback failed")

    def _relieve(self) -> None:
        while not self.stopping:
            self._watched.wait()
            with self.changed:
                seen = self._hanging
            self._ended.wait(_RELIEF)
            with self.changed:
                self._watched.clear()
                if seen is None or self._hanging is not seen or self.stopping:
                    # What waits by then may wait for another one that hangs.
                    self.watch()
                    continue
                if self._stuck < _MOST_STUCK:
                    self._hanging = None
                    self._stuck += 1
                    self._thread = self._new_thread()
                    self._thread.start()
