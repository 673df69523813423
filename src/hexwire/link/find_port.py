"""Finds the name of a port by unplugging its cable and plugging it in again.

Owns what the changes in the list of ports mean. Pure: lists of ports and times in, words out. Must not know where
the lists come from.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .ports import PortInfo

__all__ = ["PortFinder"]

_QUIET = 0.5
"""Seconds after a change in which further ports of the same device come or go."""


class PortFinder:
    """Compares lists of ports.

    A device that is unplugged takes all its ports with it, and they may have other names when it is back. A device
    that is plugged in for the first time is found too.

    Args:
        ports: The ports at the beginning.

    Attributes:
        gone: The ports that have gone, once one has.
        found: The ports of the device, at the end.
        over: They are known.
    """

    def __init__(self, ports: Sequence[PortInfo]) -> None:
        self._known = {port.device: port for port in ports}
        self._here = dict(self._known)
        self._changed_at: float | None = None
        self.gone: tuple[PortInfo, ...] = ()
        self.found: tuple[PortInfo, ...] = ()
        self.over = False

    def receive(self, ports: Sequence[PortInfo], now: float) -> None:
        """Take the ports that are here at a time, in seconds."""
        here = {port.device: port for port in ports}
        if here.keys() != self._here.keys():
            self._changed_at = now
        self._here = here
        self.gone = tuple(port for name, port in self._known.items() if name not in here) or self.gone
        free = {port.device for port in self.gone}
        came = tuple(port for name, port in here.items() if name not in self._known or name in free)
        settled = self._changed_at is not None and now - self._changed_at >= _QUIET
        if came and settled:
            self.found, self.over = came, True

    @property
    def asks(self) -> str:
        """What to do next; empty at the end."""
        if self.over:
            return ""
        if self.gone:
            names = ", ".join(port.device for port in self.gone)
            return f"{names} is gone: plug it in again"
        return "unplug the USB cable of the arm; or plug it in, if it is not yet"
