"""`sim://hex7bot`: an emulated arm inside the program that opens it, behind an ordinary link.

Owns the link; whoever reads it drives the emulator, so there is no thread, process or terminal. The entry-point
group ``hexwire.links`` names it: no other room imports it.
"""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING

from hexwire.errors import LinkBusyError, LinkClosedError, UsageError
from hexwire.link.base import Link, LinkKind

from .board import make_hex7bot_board

if TYPE_CHECKING:
    from hexwire.link.url import LinkUrl

    from .serve import ServedDevice

__all__ = ["SimLink", "make_sim_link"]

_ROBOT = "hex7bot"
_SERVO_BAUD = 115200
"""Rate of the emulated servo bus, as set by the chapter's sketch."""
_STEP = 0.0005
"""Shortest wait between two steps of the emulator, seconds."""


def make_sim_link(url: LinkUrl) -> SimLink:
    """Make the link of ``sim://hex7bot``, with the options ``dialect`` (1 or 2) and ``seed``.

    Raises:
        UsageError: There is no such emulated arm, or an option is wrong.
    """
    if url.netloc != _ROBOT or url.path not in ("", "/"):
        raise UsageError(f"{url.text}: there is no such emulated arm; write sim://{_ROBOT}")
    url.check_keys(("dialect", "seed"))
    dialect, seed = url.integer("dialect", 2, 1, 2), url.integer("seed", 0, 0, 2**31)
    device = make_hex7bot_board(dialect=dialect, baud=_SERVO_BAUD, seed=seed, start=time.monotonic())
    return SimLink(url.text, device)


class SimLink(Link):
    """A link to a device in this process, in real time. The device lives on while the link is closed.

    Args:
        url: What the link calls itself.
        device: The emulated board.
    """

    kind = LinkKind.STREAM
    max_message = None

    def __init__(self, url: str, device: ServedDevice) -> None:
        self.url, self.device = url, device
        self._open = self._woken = False
        self._unread = b""
        # Guards the device and all of the above.
        self._changed = threading.Condition()

    @property
    def is_open(self) -> bool:
        return self._open

    def open(self) -> None:
        with self._changed:
            if self._open:
                raise LinkBusyError(f"{self.url} is open already", url=self.url)
            self._open, self._woken = True, False
            # What was sent to nobody is lost.
            self._run()
            self._unread = b""

    def close(self) -> None:
        with self._changed:
            self._open = False
            self._changed.notify_all()

    def wake(self) -> None:
        with self._changed:
            self._woken = True
            self._changed.notify_all()

    def flush_input(self) -> int:
        with self._changed:
            self._run()
            unread, self._unread = self._unread, b""
            return len(unread)

    def write(self, data: bytes, deadline: float | None = None) -> None:
        with self._changed:
            self._check()
            # What was due before these bytes comes first: a watchdog that has expired is not fed by them.
            self._run()
            if data:
                self.device.receive(data, time.monotonic())
                self._changed.notify_all()

    def read(self, deadline: float | None) -> bytes:
        with self._changed:
            while True:
                self._check()
                self._run()
                if self._unread:
                    unread, self._unread = self._unread, b""
                    return unread
                if self._woken:
                    self._woken = False
                    return b""
                now = time.monotonic()
                if deadline is not None and now >= deadline:
                    return b""
                due = [t for t in (deadline, self.device.next_event_time()) if t is not None]
                self._changed.wait(max(min(due) - now, _STEP) if due else None)

    def _run(self) -> None:
        self.device.step(time.monotonic())
        self._unread += self.device.data_to_send()

    def _check(self) -> None:
        if not self._open:
            raise LinkClosedError(f"{self.url} is closed", url=self.url)
