"""One thread for all callbacks of a node: what arrives waits in bounded inboxes and is handled in order of arrival.

Owns that thread. Must not know Zenoh, nor what arrives.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable
from typing import Any, Generic, TypeVar

__all__ = ["Callbacks", "Inbox"]

_log = logging.getLogger(__name__)
_T = TypeVar("_T")
_PATIENCE = 5.0
"""Most seconds for the callback that runs when the node is closed."""


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
        with self._owner.changed:
            if self._owner.stopping:
                return item
            old = None
            if len(self._items) >= self._depth:
                old = self._items.popleft()
                self.dropped += 1
            else:
                # As many entries as items: whoever drops one keeps the entry for the next.
                self._owner.ready.append(self)
            self._items.append(item)
            self._owner.changed.notify()
            return old

    def take(self) -> Callable[[], object]:
        """The next item with its callback; only with the lock."""
        item = self._items.popleft()
        return lambda: self._handle(item)


class Callbacks:
    """The thread that runs callbacks. A callback that raises is logged and changes nothing for the others."""

    def __init__(self, name: str) -> None:
        self.changed = threading.Condition()
        self.ready: deque[Inbox[Any]] = deque()
        self.stopping = False
        self._thread = threading.Thread(target=self._run, name=f"callbacks of {name}", daemon=True)

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

    def stop(self) -> None:
        """End the thread; what waits is dropped."""
        with self.changed:
            self.stopping = True
            self.ready.clear()
            self.changed.notify_all()
        if self._thread.ident is not None and self._thread is not threading.current_thread():
            self._thread.join(_PATIENCE)

    @property
    def is_current(self) -> bool:
        """Whether this is the thread of callbacks."""
        return self._thread is threading.current_thread()

    def _run(self) -> None:
        while True:
            with self.changed:
                while not self.ready and not self.stopping:
                    self.changed.wait()
                if self.stopping:
                    return
                call = self.ready.popleft().take()
            try:
                call()
            except Exception:  # noqa: BLE001  # logged; a faulty callback must not end the node
                _log.exception("a callback failed")
