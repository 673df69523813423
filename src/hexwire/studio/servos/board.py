"""The servos of an arm that is open, as its protocol tells of them.

Owns what a page is told of them. Registers need an adapter on the bus: a board answers for its servos.
"""

from __future__ import annotations

from typing import Any

from hexwire.studio.calls import Arguments, Asked, call

__all__: list[str] = []

_SERIES = {"seven_bot": "7Bot", "scs": "SCS", "sts_sms": "STS", "hls": "HLS"}
"""Series of servos as their makers write them."""


@call("board.servos", Arguments)
def _servos(asked: Asked, args: Arguments) -> dict[str, Any]:
    """The joints with their servos, and whether these can be reached without the arm."""
    joints = asked.arm.settings.model.joints
    return {
        "bare": asked.arm.driver.servo_link is not None,
        "joints": [{"name": joint.name, "servo": joint.servo_id} for joint in joints],
    }


@call("board.ask", Arguments)
def _ask(asked: Asked, args: Arguments) -> dict[str, Any]:
    """What each servo is, and the counters that are not 0."""
    arm = asked.arm
    report = arm.ask("probe", arm.shared.probe)
    counters = {f"this computer: {name}": count for name, count in arm.driver.host_counters().items()}
    counters |= {f"board: {name}": n for name, n in (arm.ask("counters", arm.shared.board_counters) or {}).items()}
    rows = [
        (
            joint.name,
            str(joint.servo_id),
            _SERIES.get(joint.series, joint.series),
            "yes" if joint.present else "no answer",
            "" if joint.supply is None else f"{joint.supply[0]:.1f} to {joint.supply[1]:.1f} V",
            joint.remarks,
        )
        for joint in report.joints
    ]
    return {
        "servos": rows,
        "firmware": f"Firmware {report.firmware}, dialect {report.dialect}." if report.firmware else "",
        "counters": [(name.replace("_", " "), str(count)) for name, count in counters.items() if count],
    }


@call("board.ping", Arguments)
def _ping(asked: Asked, args: Arguments) -> list[tuple[str, str, str]]:
    arm = asked.arm

    def ping() -> list[tuple[str, str, str]]:
        rows = []
        for joint in arm.settings.model.joints:
            status = arm.shared.ping(joint.servo_id)
            words = "no answer" if status is None else "ok" if not status else f"status {status:#04x}"
            rows.append((joint.name, str(joint.servo_id), words))
        return rows

    return arm.ask("pings", ping)
