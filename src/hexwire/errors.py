"""Every exception hexwire raises, in one tree.

Owns the names and the wording rule: the text says what happened, to what, and what to do about it, on one
line. Knows nothing of the layers that raise them.

    HexwireError
    ├── UsageError (ValueError)             the caller: a bad argument, an unknown name
    │   ├── ConfigError                     a file that people write: file, line, column
    │   ├── LimitError                      a target outside the limits; nothing was sent
    │   └── GoalError                       a goal that cannot be followed, and the reason in one word
    ├── ProtocolError                       bytes that break the format
    │   ├── LocalProtocolError              we were about to send them
    │   └── RemoteProtocolError             the peer sent them
    ├── LinkError (OSError)                 the line between us
    │   ├── LinkNotFoundError               no such port, host or queue
    │   ├── LinkPermissionError             it exists, but not for this user
    │   ├── LinkBusyError                   another program owns it
    │   ├── LinkLostError                   it was open and went away
    │   ├── LinkClosedError                 we closed it
    │   └── LinkTimeoutError (TimeoutError) it took no bytes by the deadline
    └── DeviceError                         the board, a servo, or the arm
        ├── ReplyTimeoutError (TimeoutError)  no answer; carries what was asked, how often, what came instead
        │   └── WrongDeviceError            no answer, since another kind of device is there
        ├── CommandRefusedError             the board answered with a status other than ok
        │   └── StoppedError                refused, or not even sent, because the arm is stopped
        ├── ServoError                      a servo is silent or reports a fault
        ├── NotSupportedError               this board or dialect cannot do it
        └── PreemptedError                  a stop took the line from a request that was sent
"""

from __future__ import annotations

from typing import Self

__all__ = [
    "CommandRefusedError",
    "ConfigError",
    "DeviceError",
    "GoalError",
    "HexwireError",
    "LimitError",
    "LinkBusyError",
    "LinkClosedError",
    "LinkError",
    "LinkLostError",
    "LinkNotFoundError",
    "LinkPermissionError",
    "LinkTimeoutError",
    "LocalProtocolError",
    "NotSupportedError",
    "PreemptedError",
    "ProtocolError",
    "RemoteProtocolError",
    "ReplyTimeoutError",
    "ServoError",
    "StoppedError",
    "UsageError",
    "WrongDeviceError",
]


_LONGEST = 1600
"""Characters of an error that quotes a file; what is in the middle of a longer one is left out."""


class HexwireError(Exception):
    """Base of everything hexwire raises on purpose."""


class UsageError(HexwireError, ValueError):
    """The caller asked for something that makes no sense; nothing was sent."""


class ConfigError(UsageError):
    """A file that people write is wrong.

    Attributes:
        file: Path as the caller gave it.
        line: Line from 1, or 0 where the fault is in no single line.
        column: Column from 1, or 0.
    """

    def __init__(self, message: str, *, file: str = "", line: int = 0, column: int = 0) -> None:
        where = file
        if line:
            where += f":{line}"
            if column:
                where += f":{column}"
        super().__init__(_one_line(f"{where}: {message}" if where else message))
        self.file = file
        self.line = line
        self.column = column


def _one_line(text: str) -> str:
    """A text that quotes a file, which may hold anything: printable, and not much longer than a screen is wide."""
    if len(text) > _LONGEST:
        half = _LONGEST // 2
        text = f"{text[:half]} ... {text[-half:]}"
    return text if text.isprintable() else "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


class LimitError(UsageError):
    """A target is outside the limits of the arm; nothing was sent."""


class GoalError(UsageError):
    """A goal cannot be followed; nothing was sent.

    Attributes:
        reason: The kind of fault, for programs; whoever raises it owns the list.
    """

    def __init__(self, message: str, *, reason: str = "malformed") -> None:
        super().__init__(message)
        self.reason = reason


class ProtocolError(HexwireError):
    """Bytes that break the format."""


class LocalProtocolError(ProtocolError):
    """We were about to send a frame the peer could not accept."""


class RemoteProtocolError(ProtocolError):
    """The peer sent bytes that break the format."""


class LinkError(HexwireError, OSError):
    """The line between host and board is at fault.

    Attributes:
        url: The link's address, as in ``serial:///dev/ttyUSB0?baud=115200``.
    """

    def __init__(self, message: str, *, url: str = "") -> None:
        super().__init__(message)
        self.url = url


class LinkNotFoundError(LinkError):
    """There is no such port, host or queue."""


class LinkPermissionError(LinkError):
    """The port exists, but this user may not open it."""


class LinkBusyError(LinkError):
    """Another program owns the port."""


class LinkLostError(LinkError):
    """The link was open and went away: unplugged, peer closed, reset."""


class LinkClosedError(LinkError):
    """The link was closed on this side, perhaps while a call was waiting on it."""


class LinkTimeoutError(LinkError, TimeoutError):
    """The link took no bytes before the deadline."""


class DeviceError(HexwireError):
    """The board, a servo or the arm is at fault."""


class ReplyTimeoutError(DeviceError, TimeoutError):
    """No answer came in time.

    Attributes:
        asked: What was asked, in words.
        attempts: How often it was sent.
        instead: What arrived in its place, in words; empty if nothing did.
    """

    def __init__(self, asked: str, *, attempts: int = 1, instead: str = "", advice: str = "") -> None:
        text = f"no answer to {asked} after {attempts} attempt{'s' if attempts != 1 else ''}"
        text += f"; instead: {instead}" if instead else "; nothing arrived"
        if advice:
            text += f" ({advice})"
        super().__init__(text)
        self.asked = asked
        self.attempts = attempts
        self.instead = instead


class WrongDeviceError(ReplyTimeoutError):
    """No answer, since another kind of device is behind the port: a servo bus for a board, or a board for one."""

    def __init__(self, message: str) -> None:
        DeviceError.__init__(self, message)
        self.asked, self.attempts, self.instead = "who is there", 1, message


class CommandRefusedError(DeviceError):
    """The board answered, but would not do it.

    Attributes:
        command: Name of the command.
        status: Numeric status code of the reply.
    """

    def __init__(self, command: str, status: int, reason: str) -> None:
        super().__init__(f"the board refused {command}: {reason}")
        self.command = command
        self.status = status
        self.reason = reason


class StoppedError(CommandRefusedError):
    """The arm is stopped; nothing but reads is accepted until resume."""

    @classmethod
    def unsent(cls, command: str, status: int, reason: str) -> Self:
        """The error for what a stop kept from being sent: no board has refused it."""
        error = cls(command, status, reason)
        error.args = (f"{command} was not sent: {reason}",)
        return error


class ServoError(DeviceError):
    """A servo is silent or reports a fault.

    Attributes:
        servo_id: Bus id of the servo.
        status: Its error byte, 0 if it was silent.
    """

    def __init__(self, message: str, *, servo_id: int = -1, status: int = 0) -> None:
        super().__init__(message)
        self.servo_id = servo_id
        self.status = status


class NotSupportedError(DeviceError):
    """This board, dialect or servo series cannot do what was asked."""


class PreemptedError(DeviceError):
    """A stop took the line from a request that was sent: it may have been done before the stop, but not after."""
