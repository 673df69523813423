"""The slots of a server: which clients may stay when there are more than the server accepts.

Owns the slots and the order in which they are taken away: the commanding client never loses its slot. Pure: time
comes in as `now`. Must not know sockets, nor what makes a request valid.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Generic, TypeVar

__all__ = ["ClientSlots"]

K = TypeVar("K", bound=Hashable)

_TOGETHER = 2.0
"""Most seconds between the first messages of the channels that one program opens."""


@dataclass(slots=True)
class _Guest:
    host: str
    came: float
    heard: float | None = None
    commanded: float | None = None


class ClientSlots(Generic[K]):
    """The slots of a server.

    When no slot is left, in total or for one host, one is taken from, in this order:

    1. a client that has never sent a valid request, the oldest first, whatever bytes it has sent;
    2. a client that has sent none for `idle` seconds, the longest silent first, unless it or another client on its
       host commanded last: quiet channels of a robot belong to the host that moves it;
    3. where the new client's host has all its slots: one of its clients that has sent none for `own_idle` seconds,
       the longest silent first, but neither the one that commanded last nor those that came together with it. Over
       datagrams nobody is seen to leave, so a host would fill its slots with programs that have ended.

    If there is no such client, the new one is refused.

    Args:
        most: Total number of slots.
        per_host: Places for one host; a host beyond that loses one of its own.
        idle: Seconds without a valid request after which a client may lose its slot.
        own_idle: The same, for a new client of the same host.
    """

    def __init__(self, most: int = 64, *, per_host: int = 32, idle: float = 60.0, own_idle: float = 1.0) -> None:
        self.most = most
        self.per_host = per_host
        self.idle = idle
        self.own_idle = own_idle
        self.turned_away = 0
        self._guests: dict[K, _Guest] = {}

    def __len__(self) -> int:
        return len(self._guests)

    def admit(self, key: K, host: str, now: float) -> tuple[bool, K | None]:
        """Give a new client a slot.

        Returns:
            Whether it has one, and the client that loses its slot for it.
        """
        out = None
        mine = [k for k, guest in self._guests.items() if guest.host == host]
        host_full = len(mine) >= self.per_host
        if host_full or len(self._guests) >= self.most:
            out = self._weakest(mine if host_full else list(self._guests), now)
            if out is None and host_full:
                out = self._oldest_own(mine, now)
            if out is None:
                self.turned_away += 1
                return False, None
            self.leave(out)
        self._guests[key] = _Guest(host, now)
        return True, out

    def heard(self, key: K, now: float, *, commanded: bool = False) -> None:
        """Record a valid request, and whether it was a command."""
        guest = self._guests.get(key)
        if guest is not None:
            guest.heard = now
            if commanded:
                guest.commanded = now

    def leave(self, key: K) -> None:
        """A client has left. Harmless if it has no slot."""
        self._guests.pop(key, None)

    def _weakest(self, keys: list[K], now: float) -> K | None:
        strangers = [k for k in keys if self._guests[k].heard is None]
        if strangers:
            return min(strangers, key=lambda k: self._guests[k].came)
        commander = self._commander()
        host = commander.host if commander is not None else None
        return self._longest_silent([k for k in keys if self._guests[k].host != host], now, self.idle)

    def _oldest_own(self, keys: list[K], now: float) -> K | None:
        commander = self._commander()
        if commander is not None and commander.host == self._guests[keys[0]].host:
            keys = [k for k in keys if abs(self._guests[k].came - commander.came) > _TOGETHER]
        return self._longest_silent(keys, now, self.own_idle)

    def _longest_silent(self, keys: list[K], now: float, idle: float) -> K | None:
        silent = {k: heard for k in keys if (heard := self._guests[k].heard) is not None and now - heard > idle}
        return min(silent, key=silent.__getitem__, default=None)

    def _commander(self) -> _Guest | None:
        """The client that commanded last, among the connected ones."""
        commanded = {k: guest.commanded for k, guest in self._guests.items() if guest.commanded is not None}
        return self._guests[max(reversed(commanded), key=commanded.__getitem__)] if commanded else None
