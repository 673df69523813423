"""Errors in messages between the server of an arm and its clients.

Owns which errors travel, and that an error in a client reads like the one at the server. Must not know bytes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hexwire import errors
from hexwire.errors import (
    CommandRefusedError,
    DeviceError,
    HexwireError,
    LeaseError,
    LinkError,
    LinkLostError,
    RemoteProtocolError,
    ServoError,
    StoppedError,
)

__all__ = ["describe", "restore"]

_TRAVEL = {
    kind.__name__: kind
    for kind in (
        DeviceError,
        LinkError,
        LinkLostError,
        RemoteProtocolError,
        errors.LimitError,
        errors.LinkNotFoundError,
        errors.NotSupportedError,
        errors.PreemptedError,
        errors.UsageError,
    )
}
"""Errors with only a text, by name."""


def describe(error: HexwireError) -> tuple[str, str, dict[str, Any]]:
    """Name, text and details of an error."""
    text = str(error)[:4000]
    if isinstance(error, LeaseError):
        return "LeaseError", error.reason[:4000], {"holder": error.holder, "lost": error.lost}
    if isinstance(error, CommandRefusedError):
        kind = "StoppedError" if isinstance(error, StoppedError) else "CommandRefusedError"
        return kind, text, {"command": error.command, "status": error.status, "reason": error.reason}
    if isinstance(error, ServoError):
        return "ServoError", text, {"servo_id": error.servo_id, "status": error.status}
    if isinstance(error, errors.GoalError):
        return "GoalError", text, {"reason": str(error.reason)}
    for base in type(error).__mro__:
        if base.__name__ in _TRAVEL:
            return base.__name__, text, {}
    return "DeviceError", text, {}


def restore(kind: str, text: str, details: Mapping[str, Any]) -> HexwireError:
    """The error that was described; a `DeviceError` with its text if it is of no known kind."""
    if kind == "LeaseError":
        return LeaseError(text, holder=str(details.get("holder", "")), lost=details.get("lost") is not False)
    status = details.get("status", 0)
    number = status if isinstance(status, int) else 0
    if kind in ("StoppedError", "CommandRefusedError"):
        refused = StoppedError if kind == "StoppedError" else CommandRefusedError
        error = refused(str(details.get("command", "")), number, str(details.get("reason", "")))
        error.args = (text,)
        return error
    if kind == "ServoError":
        servo_id = details.get("servo_id", -1)
        return ServoError(text, servo_id=servo_id if isinstance(servo_id, int) else -1, status=number)
    if kind == "GoalError":
        return errors.GoalError(text, reason=str(details.get("reason", "malformed")))
    return _TRAVEL.get(kind, DeviceError)(text)
