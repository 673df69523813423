"""The tree of all exceptions that this package raises.

RosError
├── UsageError (ValueError)               the caller: an invalid name, type, setting or value
│   └── ConfigError                       a file of settings
├── RefusedError                          raised by a callback of yours, to refuse what a client asks
├── ProtocolError                         bytes that break the format
│   ├── LocalProtocolError                this program was about to send them
│   └── RemoteProtocolError               a peer sent them
├── SessionError (OSError)                the Zenoh session cannot be opened
│   ├── RouterNotFoundError               no router answers
│   └── SessionClosedError                it is closed, or was never open
└── NoAnswerError (TimeoutError)          a service gives no answer
"""

from __future__ import annotations

__all__ = [
    "ConfigError",
    "LocalProtocolError",
    "NoAnswerError",
    "ProtocolError",
    "RefusedError",
    "RemoteProtocolError",
    "RosError",
    "RouterNotFoundError",
    "SessionClosedError",
    "SessionError",
    "UsageError",
]


class RosError(Exception):
    """Base of all exceptions that this package raises on purpose."""


class UsageError(RosError, ValueError):
    """What the caller asks for is invalid; nothing was sent."""


class ConfigError(UsageError):
    """A file of settings cannot be used.

    Attributes:
        file: Its path as it was given.
        reason: What is wrong with it.
    """

    def __init__(self, file: str, reason: str) -> None:
        super().__init__(f"{file}: {reason}")
        self.file, self.reason = file, reason


class RefusedError(RosError):
    """Raised by a callback, to refuse what a client asks; the client is told the text, or the log is."""


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


class NoAnswerError(RosError, TimeoutError):
    """A service gives no answer in time."""
