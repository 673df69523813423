"""The tree of all exceptions that this package raises.

RosError
├── UsageError (ValueError)               the caller: an invalid name, type, setting or value
├── ProtocolError                         bytes that break the format
│   ├── LocalProtocolError                this program was about to send them
│   └── RemoteProtocolError               a peer sent them
├── SessionError (OSError)                the Zenoh session cannot be opened
│   ├── RouterNotFoundError               no router answers
│   └── SessionClosedError                it is closed, or was never open
└── ServiceTimeoutError (TimeoutError)    a service gives no answer
"""

from __future__ import annotations

__all__ = [
    "LocalProtocolError",
    "ProtocolError",
    "RemoteProtocolError",
    "RosError",
    "RouterNotFoundError",
    "ServiceTimeoutError",
    "SessionClosedError",
    "SessionError",
    "UsageError",
]


class RosError(Exception):
    """Base of all exceptions that this package raises on purpose."""


class UsageError(RosError, ValueError):
    """What the caller asks for is invalid; nothing was sent."""


class ProtocolError(RosError):
    """Bytes that break the format."""


class LocalProtocolError(ProtocolError):
    """This program was about to send a message that does not fit its type."""


class RemoteProtocolError(ProtocolError):
    """A peer sent bytes that break the format."""


class SessionError(RosError, OSError):
    """The Zenoh session cannot be opened."""


class RouterNotFoundError(SessionError):
    """There is no router in the given time."""


class SessionClosedError(SessionError):
    """The session is closed, or was never open."""


class ServiceTimeoutError(RosError, TimeoutError):
    """A service gives no answer in time."""
