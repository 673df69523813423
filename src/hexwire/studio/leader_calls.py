"""What the page Move asks of the server about a leader arm: which there are, connect and disconnect one.

Owns these calls. Following itself is held over the live socket. Must not know sockets, nor decide about motion.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from hexwire.model.arms import record_of

from . import plugged
from .access import Right
from .calls import Arguments, Asked, call
from .present_calls import read_address

__all__: list[str] = []


class _Leader(Arguments, frozen=True):
    url: str
    robot: str = ""
    mirror: bool = False


@call("arm.leaders", Arguments, right=Right.OPERATE)
def _leaders(asked: Asked, args: Arguments) -> dict[str, Any]:
    """The ports of this machine, and an emulated leader for the open arm."""
    kind = asked.arm.settings.model.kind
    found = asked.studio.plugged = plugged.find_plugged()
    return {
        "ports": [asdict(row) for row in found],
        "emulated": _emulated(kind),
        "robots": [*plugged.robots()],
        "robot": kind,
    }


def _emulated(kind: str) -> str:
    """Address of an emulated leader for an arm of a kind; empty if there is none."""
    record = record_of(kind)
    if record is None or not record.simulated:
        return ""
    joints = () if record.assembly is None else record.assembly.joints
    geared = any(joint.leader_gears for joint in joints)
    return f"{record.emulated}?name=leader{'&leader=1' if geared else ''}"


@call("arm.lead", _Leader, control=True)
def _lead(asked: Asked, args: _Leader) -> None:
    asked.arm.choose_leader(read_address(args.url), args.robot, mirror=args.mirror)


@call("arm.unlead", Arguments, control=True)
def _unlead(asked: Asked, args: Arguments) -> None:
    asked.arm.forget_leader()
