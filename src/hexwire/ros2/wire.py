"""What hexwire adds to `zenoh_ros2`, on whose wire its node is: exceptions, log, router, ends of connections.

Owns which exception of that package is which of hexwire. Must not know nodes, nor arms.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from hexwire import errors
from hexwire.closing_links import close_at_once
from hexwire.inputs import read_text
from zenoh_ros2 import ZenohSettings
from zenoh_ros2 import errors as ros
from zenoh_ros2.zenoh_session import load_zenoh

__all__ = ["LOGGERS", "RouterSettings", "own_errors"]

LOGGERS = ("hexwire", "zenoh_ros2")
"""Names of the loggers whose records are the log of a node."""

_KINDS: dict[type[ros.RosError], type[errors.HexwireError]] = {
    ros.RouterNotFoundError: errors.LinkNotFoundError,
    ros.SessionClosedError: errors.LinkClosedError,
    ros.SessionError: errors.LinkPermissionError,
    ros.ServiceTimeoutError: errors.LinkTimeoutError,
    ros.LocalProtocolError: errors.LocalProtocolError,
    ros.RemoteProtocolError: errors.RemoteProtocolError,
    ros.ProtocolError: errors.ProtocolError,
    ros.UsageError: errors.UsageError,
}
"""Exceptions of the wire and those of hexwire that say the same; the first that fits counts."""


@contextmanager
def own_errors() -> Iterator[None]:
    """In this context, an exception of the wire becomes that of hexwire, with its text.

    Raises:
        HexwireError: One of the wire.
    """
    try:
        yield
    except ros.RosError as error:
        kind = next((own for theirs, own in _KINDS.items() if isinstance(error, theirs)), errors.HexwireError)
        raise kind(str(error)) from None


@dataclass(frozen=True, slots=True)
class RouterSettings(ZenohSettings):
    """Settings of a session, with hexwire's bounds for files, and its router."""

    def read_config_file(self) -> str:
        """The text of `config_file`.

        Raises:
            ConfigError: It cannot be read.
        """
        return read_text(self.config_file)

    def opened(self, session: Any) -> Sequence[threading.Thread]:
        """Let no connection of a session wait when it ends: a stop would wait with it."""
        return (close_at_once(session, load_zenoh().handlers.RingChannel(1)),)

    @property
    def how_to_start_a_router(self) -> str:
        """What to do without a router, for the log."""
        return "start one with `hexwire fleet router` or `ros2 run rmw_zenoh_cpp rmw_zenohd`"
