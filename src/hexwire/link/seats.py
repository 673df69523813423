"""Who may stay when more callers come than a server has room for.

Owns the places of a server and the order in which they are given up: whoever commands never loses his. Pure: time
comes in as `now`. Must not know sockets, nor what makes a request good.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Generic, TypeVar

__all__ = ["Seats"]

K = TypeVar("K", bound=Hashable)


@dataclass(slots=True)
class _Guest:
    host: str
    came: float
    heard: float | None = None
    commanded: float | None = None


class Seats(Generic[K]):
    """The places of a server.

    When there is none left, in all or for one host, a place is taken from, in this order:

    1. whoever has never sent a good request, the oldest first, whatever bytes came from him;
    2. whoever has sent none for `idle` seconds, the most silent first, unless he or somebody else from his host
       commanded last: the channels of a robot that happen to be quiet belong to him who moves it.

    If that leaves nobody, the newcomer is turned away.

    Args:
        most: Places in all.
        per_host: Places for one host, of which it takes from its own only.
        idle: Seconds without a good request after which a guest may have to go.
    """

    def __init__(self, most: int = 64, *, per_host: int = 32, idle: float = 60.0) -> None:
        self.most = most
        self.per_host = per_host
        self.idle = idle
        self.turned_away = 0
        self._guests: dict[K, _Guest] = {}

    def __len__(self) -> int:
        return len(self._guests)

    def admit(self, key: K, host: str, now: float) -> tuple[bool, K | None]:
        """Give a newcomer a place.

        Returns:
            Whether he has one, and who has to go for it.
        """
        out = None
        mine = [k for k, guest in self._guests.items() if guest.host == host]
        if len(mine) >= self.per_host or len(self._guests) >= self.most:
            out = self._weakest(mine if len(mine) >= self.per_host else list(self._guests), now)
            if out is None:
                self.turned_away += 1
                return False, None
            self.leave(out)
        self._guests[key] = _Guest(host, now)
        return True, out

    def heard(self, key: K, now: float, *, commanded: bool = False) -> None:
        """Note a good request, and whether it changed something."""
        guest = self._guests.get(key)
        if guest is not None:
            guest.heard = now
            if commanded:
                guest.commanded = now

    def leave(self, key: K) -> None:
        """A guest is gone. Harmless if he was none."""
        self._guests.pop(key, None)

    def _weakest(self, keys: list[K], now: float) -> K | None:
        strangers = [k for k in keys if self._guests[k].heard is None]
        if strangers:
            return min(strangers, key=lambda k: self._guests[k].came)
        commander = self._commander()
        silent = [
            (guest.heard, i)
            for i, guest in enumerate(self._guests[k] for k in keys)
            if guest.heard is not None and now - guest.heard > self.idle and guest.host != commander
        ]
        return keys[min(silent)[1]] if silent else None

    def _commander(self) -> str | None:
        """The host that commanded last, if any that is here did."""
        rows = [(guest.commanded, guest.host) for guest in self._guests.values() if guest.commanded is not None]
        return max(rows)[1] if rows else None
