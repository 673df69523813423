"""What every page, and the page Arms, asks of the server: opening, closing, control, resume, torque.

Owns these calls. Must not know sockets.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from hexwire.drivers.board_reset import RESET_WARNING
from hexwire.drivers.registry import DEFAULT_ROBOT
from hexwire.errors import UsageError

from . import plugged
from .access import Right
from .calls import Arguments, Asked, Named, Switched, call

__all__ = ["read_address"]

_LONGEST = 200
"""Letters of an address."""


class _Address(Arguments, frozen=True):
    url: str
    robot: str = ""


class _Bus(Arguments, frozen=True):
    url: str = ""


def read_address(url: str) -> str:
    """An address without blanks around it; raises `UsageError` if it is too long."""
    url = url.strip()
    if len(url) > _LONGEST:
        raise UsageError(f"an address has at most {_LONGEST} letters")
    return url


@call("ports", Arguments)
def _ports(asked: Asked, args: Arguments) -> dict[str, Any]:
    """What is plugged in, and what can be opened without hardware."""
    found = asked.studio.plugged = plugged.find_plugged()
    return _told(found)


@call("ports.known", Arguments)
def _known(asked: Asked, args: Arguments) -> dict[str, Any]:
    """What was there a moment ago: a table that comes later would push its neighbours away."""
    return _told(asked.studio.plugged)


def _told(found: list[plugged.Plugged] | None) -> dict[str, Any]:
    return {
        "plugged": None if found is None else [asdict(row) for row in found],
        "emulated": [asdict(row) for row in plugged.emulated()],
        "robots": [*plugged.robots()],
        "default": DEFAULT_ROBOT,
        "warning": RESET_WARNING,
    }


@call("open", _Address, right=Right.OPERATE)
def _open(asked: Asked, args: _Address) -> None:
    asked.studio.open(asked.tab, read_address(args.url), args.robot or None)


@call("fleet.arms", Arguments)
def _arms(asked: Asked, args: Arguments) -> dict[str, Any]:
    """What is open here, and the shared arms."""
    return asked.studio.arms()


@call("fleet.open", Named, right=Right.OPERATE)
def _open_shared(asked: Asked, args: Named) -> None:
    """Open a shared arm in place of what is open; it must be one that was seen, and no address from elsewhere."""
    asked.studio.open(asked.tab, asked.studio.fleet.known(args.name))


@call("open_bus", _Bus, right=Right.OPERATE)
def _open_bus(asked: Asked, args: _Bus) -> None:
    """Open a servo bus at an address, or that of the open arm, and take control of it."""
    asked.studio.open_bus(asked.tab, read_address(args.url))


@call("close", Arguments, right=Right.OPERATE)
def _close(asked: Asked, args: Arguments) -> None:
    asked.studio.close_source(asked.tab)


@call("take", Arguments, right=Right.OPERATE)
def _take(asked: Asked, args: Arguments) -> None:
    asked.studio.take(asked.tab, force=True)


@call("leave", Arguments)
def _leave(asked: Asked, args: Arguments) -> None:
    asked.studio.source.leave(asked.tab)


# A stop that comes before these two are carried out is judged by the arm: torque goes off all the same.


@call("resume", Arguments)
def _resume(asked: Asked, args: Arguments) -> None:
    asked.studio.need_control(asked.tab)
    if asked.studio.source.bus is not None:
        asked.bus.resume(asked.arrived)
    else:
        asked.arm.shared.resume(asked.arm.order(asked.tab, asked.arrived))


@call("torque", Switched)
def _torque(asked: Asked, args: Switched) -> None:
    asked.studio.need_control(asked.tab)
    if asked.studio.source.bus is not None:
        if args.on:
            asked.refuse_if_stopped_since()
        asked.bus.switch_torque(args.on)
    else:
        asked.arm.shared.torque(asked.arm.order(asked.tab, asked.arrived), args.on, None)
