"""`sim hand`: moves a joint of a running emulated arm by hand.

Owns the options and the words for what came of it. Must not know how a hand reaches the arm, nor how joints move.
"""

from __future__ import annotations

import click

from hexwire.units import decimal

from .common import early_port, json_option, resolve_url
from .numbers import FiniteFloat, NumbersCommand, number_option
from .output import answer

__all__ = ["hand"]

_NEAR = 1.0
"""Degrees within which the joint has gone all the way."""


@click.command(cls=NumbersCommand)
@click.argument("joint", metavar="JOINT|ID")
@click.argument("degrees", metavar="±DEGREES", type=FiniteFloat("degrees"))
@number_option("--duration", "SECONDS", "Duration of the motion (60 degrees a second).", above=0)
@number_option("--hold", "SECONDS", "Time to hold the joint at the end of the motion.", minimum=0, default=0.0)
@number_option(
    "--strength", "PERCENT", "Torque of the hand, as a percentage of the servo's maximum.", above=0, default=60.0
)
@click.option(
    "--port",
    metavar="URL",
    envvar="HEXWIRE_PORT",
    show_envvar=True,
    help="Port or address of the emulated arm. Optional if only one runs.",
)
@json_option
def hand(
    joint: str,
    degrees: float,
    duration: float | None,
    hold: float,
    strength: float,
    port: str | None,
    as_json: bool,
) -> None:
    """Move a joint of an emulated arm by hand, while other programs use the arm.

    A joint without torque follows; one with torque gives way a little and returns. It ends at the mechanical
    stops of the arm. JOINT is a name such as elbow_flex or J2, or a servo's id.

    --port is the port of 'hexwire sim board' or 'hexwire sim bus', or an address such as sim://so101 that another
    program of yours has open and reads, such as 'hexwire serve'. If several do, give each a name, as in
    sim://so101?name=left.
    """
    from hexwire.emulator.hand import HandOrder, usual_seconds
    from hexwire.emulator.serve_hand import move_by_hand

    port = early_port(port)
    if port is not None:
        port = resolve_url(port)
    seconds = usual_seconds(degrees) if duration is None else duration
    result = move_by_hand(port, HandOrder(joint, degrees, seconds, hold, strength / 100))
    moved = f"{decimal(result.moved)} deg"
    if result.torque:
        words = f"has torque: it gave way by {moved} and returns"
    elif result.blocked:
        words = f"moved by {moved}, to its stop"
    elif abs(result.moved - degrees) > _NEAR:
        words = f"moved by {moved}, not {decimal(degrees)}: the hand is too weak or too fast"
    else:
        words = f"moved by {moved}"
    row = {"joint": result.joint, "moved_deg": result.moved, "torque": result.torque, "blocked": result.blocked}
    answer(as_json, row, f"{result.joint} {words}")
