"""Values of a robot as plain rows in messages, and back.

Owns the conversion of arm models and probe reports. Must not know Zenoh.
"""

from __future__ import annotations

from dataclasses import asdict, astuple, fields
from typing import Any

import msgspec

from hexwire.drivers.values import JointProbe, ProbeReport
from hexwire.errors import RemoteProtocolError
from hexwire.model.arm import ArmModel, JointModel

from . import messages as m

__all__ = ["arm_model", "as_probe_report", "as_probe_rows", "joints_of"]

_MOST_JOINTS = 64


def joints_of(model: ArmModel) -> tuple[m.Joint, ...]:
    """The joints of an arm's model."""
    return tuple(m.Joint(*astuple(joint)) for joint in model.joints)


def arm_model(facts: m.Facts) -> ArmModel:
    """The arm's model.

    Raises:
        RemoteProtocolError: It is not one.
    """
    try:
        return ArmModel(facts.robot, tuple(JointModel(*msgspec.structs.astuple(joint)) for joint in facts.joints))
    except ValueError as error:
        raise RemoteProtocolError(f"not the model of an arm: {error}") from None


def as_probe_rows(report: ProbeReport) -> dict[str, Any]:
    """A probe report as a table."""
    return asdict(report)


def as_probe_report(rows: object, link: str) -> ProbeReport:
    """The probe report of a table.

    Args:
        rows: What arrived.
        link: Address of the arm for this program.

    Raises:
        RemoteProtocolError: It is not the table of a probe report.
    """
    try:
        if not isinstance(rows, dict) or len(rows["joints"]) > _MOST_JOINTS:
            raise TypeError
        known = {field.name for field in fields(JointProbe)}
        joints = []
        for row in rows["joints"]:
            values = {str(key): value for key, value in row.items() if key in known}
            if values.get("supply") is not None:
                low, high = values["supply"]
                values["supply"] = (float(low), float(high))
            joints.append(JointProbe(**values))
        given = {field.name: rows[field.name] for field in fields(ProbeReport) if field.name in rows}
        return ProbeReport(
            **{
                **given,
                "link": link,
                "joints": tuple(joints),
                "capabilities": tuple(map(str, rows["capabilities"])),
                "counters": {str(key): int(value) for key, value in rows["counters"].items()},
            }
        )
    except (AttributeError, KeyError, TypeError, ValueError):
        raise RemoteProtocolError("not a probe report") from None
