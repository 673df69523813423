"""A studio that is served in this process, as the tests use it."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hexwire.emulator.servo import EmulatedServo
    from hexwire.studio.app import Studio

__all__ = ["PATIENCE", "RunningStudio", "until"]

PATIENCE = 20.0
"""Seconds in which what a test waits for must happen, also on a busy machine."""

_names = itertools.count(1)


def until(true: Callable[[], object], what: str, seconds: float = PATIENCE) -> None:
    """Wait until something is true, at most so long."""
    deadline = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < deadline, f"not in time: {what}"
        time.sleep(0.01)


class RunningStudio:
    """A studio that is served, and the servos of the emulated arm that it has open.

    Attributes:
        studio: The studio.
        url: Its address, without a token.
    """

    def __init__(self, studio: Studio, url: str) -> None:
        self.studio, self.url = studio, url

    @property
    def operate_url(self) -> str:
        """The address for somebody who may take control."""
        return f"{self.url}/?token={self.studio.access.operate_token}"

    @property
    def watch_url(self) -> str:
        """The address for somebody who only watches."""
        return f"{self.url}/?token={self.studio.access.watch_token}"

    def open(self, kind: str = "hex7bot", *, silence: float = 5.0, **options: object) -> None:
        """Open a fresh emulated arm in the studio.

        Args:
            kind: ``hex7bot`` (with a board), ``so101`` or ``so100``.
            silence: Seconds without a beat after which a hold ends; more than in earnest, for a busy machine.
            **options: Further options of the address.
        """
        self.studio.source.silence = silence
        rows = "&".join([f"name=studio{next(_names)}", *(f"{key}={value}" for key, value in options.items())])
        self.studio.source.open(f"sim://{kind}?{rows}")
        self.until(lambda: self.arm.owner.state is not None, "a state")

    @property
    def arm(self) -> Any:
        """The `Arm`."""
        source = self.studio.source.arm
        assert source is not None
        return source.arm

    @property
    def servos(self) -> dict[int, EmulatedServo]:
        """The emulated servos by id."""
        link: Any = _link_of(self.arm.owner.robot)
        device = link.device
        servos = device.wire.servos if hasattr(device, "wire") else device.servos
        return {servo.servo_id: servo for servo in servos}

    def until(self, true: Callable[[], object], what: str, seconds: float = PATIENCE) -> None:
        """Wait until something is true, at most so long."""
        until(true, what, seconds)


def _link_of(robot: Any) -> Any:
    for name in ("_session", "_bus", "session", "bus"):
        found = getattr(robot, name, None)
        if found is not None:
            return found.link
    raise AssertionError(f"no link in {robot!r}")
