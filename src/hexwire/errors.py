"""The tree of all exceptions that hexwire raises.

Owns the names and the wording rule: one line says what happened, to what, and what to do about it. Knows nothing of
the layers that raise them.

    HexwireError
    ├── UsageError (ValueError)             the caller: an invalid argument, an unknown name
    │   ├── ConfigError                     a file that people write: file, line, column
    │   ├── LimitError                      a target outside the limits; nothing was sent
    │   └── GoalError                       a goal that cannot be followed, and the reason in one word
    ├── ProtocolError                       bytes that break the format
    │   ├── LocalProtocolError              this program was about to send them
    │   └── RemoteProtocolError             the peer sent them
    ├── LinkError (OSError)                 the line between host and device
    │   ├── LinkNotFoundError               no such port, host or queue
    │   ├── LinkPermissionError             it exists, but not for this user
    │   ├── LinkBusyError                   another program owns it
    │   ├── LinkLostError                   it was open and is lost
    │   ├── LinkClosedError                 this program closed it
    │   └── LinkTimeoutError (TimeoutError) it accepted no bytes by the deadline
    └── DeviceError                         the board, a servo, or the arm
        ├── ReplyTimeoutError (TimeoutError)  no answer; carries the request, the attempts, what arrived instead
        │   └── WrongDeviceError            no answer, because the device is of another kind
        ├── CommandRefusedError             the board answered with a status other than ok
        │   ├── StoppedError                refused, or not even sent, because the arm is stopped
        │   └── LeaseError                  refused, because another program commands the arm, or the lease was lost
        ├── ServoError                      a servo is silent or reports a fault
        ├── NotSupportedError               this board or dialect does not support it
        └── PreemptedError                  a stop interrupted a request that was sent
"""

from __future__ import annotations

from typing import ClassVar, Self

__all__ = [
    "CommandRefusedError",
    "ConfigError",
    "DeviceError",
    "GoalError",
    "HexwireError",
    "LeaseError",
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
"""Characters of an error that quotes a file; the middle of a longer text is left out."""


class HexwireError(Exception):
    """Base of all exceptions that hexwire raises on purpose."""


class UsageError(HexwireError, ValueError):
    """The caller's request is invalid; nothing was sent."""


class ConfigError(UsageError):
    """A file that people write is invalid.

    Attributes:
        file: Path as the caller gave it.
        line: Line from 1, or 0 if the fault is not in a single line.
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
    """Make a text that quotes a file printable, and shorten it if it is very long."""
    if len(text) > _LONGEST:
        half = _LONGEST // 2
        text = f"{text[:half]} ... {text[-half:]}"
    return text if text.isprintable() else "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


class LimitError(UsageError):
    """A target is outside the limits of the arm; nothing was sent."""


class GoalError(UsageError):
    """A goal cannot be followed; nothing was sent.

    Attributes:
        reason: The kind of fault, for programs; the module that raises it owns the list.
    """

    def __init__(self, message: str, *, reason: str = "malformed") -> None:
        super().__init__(message)
        self.reason = reason


class ProtocolError(HexwireError):
    """Bytes that break the format."""


class LocalProtocolError(ProtocolError):
    """This program was about to send a frame that the peer cannot accept."""


class RemoteProtocolError(ProtocolError):
    """The peer sent bytes that break the format."""


class LinkError(HexwireError, OSError):
    """The line between host and board has a fault.

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
    """The link was open and is lost: unplugged, closed by the peer, reset."""


class LinkClosedError(LinkError):
    """This program closed the link, perhaps while a call was waiting on it."""


class LinkTimeoutError(LinkError, TimeoutError):
    """The link accepted no bytes before the deadline."""


class DeviceError(HexwireError):
    """The board, a servo or the arm has a fault."""


class ReplyTimeoutError(DeviceError, TimeoutError):
    """No answer arrived in time.

    Attributes:
        asked: The request, in words.
        attempts: Number of times that it was sent.
        instead: What arrived instead, in words; empty if nothing arrived.
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
    """No answer, because the port leads to another kind of device: a servo bus, not a board, or vice versa."""

    def __init__(self, message: str) -> None:
        DeviceError.__init__(self, message)
        self.asked, self.attempts, self.instead = "who is there", 1, message


class CommandRefusedError(DeviceError):
    """The board answered, but refused the command.

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
    """The arm is stopped; only reads are accepted until resume.

    The text says so, and not which command of the wire met it: `command` does.
    """

    STATUS: ClassVar[int] = 5
    """Status `stopped` of PROTOCOL.md section 6.2, also of a request that was not sent."""

    def __init__(self, command: str, status: int, reason: str) -> None:
        super().__init__(command, status, reason)
        self.args = (reason,)

    @classmethod
    def unsent(cls, command: str, status: int, reason: str) -> Self:
        """Make the error for a request that was not sent because of a stop, and that no board has refused."""
        error = cls(command, status, reason)
        error.args = (f"{'the request' if command.isupper() else command} was not sent: {reason}",)
        return error


class LeaseError(CommandRefusedError):
    """A shared arm refused an order, because of its lease: its sender does not hold it, or the order came late.

    Attributes:
        holder: Who holds it, in words; empty if nobody does.
        lost: The sender does not hold it; False if only this order was refused, for example because it came late.
    """

    def __init__(self, reason: str, *, holder: str = "", lost: bool = True) -> None:
        super().__init__("an order", 0, reason)
        self.args = (f"not done: {reason}",)
        self.holder, self.lost = holder, lost


class ServoError(DeviceError):
    """A servo is silent or reports a fault.

    Attributes:
        servo_id: Bus id of the servo.
        status: Its error byte; 0 if it was silent.
    """

    def __init__(self, message: str, *, servo_id: int = -1, status: int = 0) -> None:
        super().__init__(message)
        self.servo_id = servo_id
        self.status = status


class NotSupportedError(DeviceError):
    """This board, dialect or servo series does not support the request."""


class PreemptedError(DeviceError):
    """A stop interrupted a request that was sent: the board may have executed it before the stop, but not after."""
