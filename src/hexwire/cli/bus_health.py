"""`bus health`: the condition of servos in words.

Owns the output and the exit status. Must not know what is healthy: `hexwire.bus.health` judges.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING

import click

from hexwire.bus.ids import parse_ids
from hexwire.errors import ServoError, UsageError

from .bus_group import BusOptions, bus, bus_options, open_bus, refuse_if_stopped
from .common import confirm, json_option
from .exits import note, shielded
from .output import print_json, say

if TYPE_CHECKING:
    from hexwire.bus.health import HealthFinding, ServoSamples
    from hexwire.bus.servo_bus import ServoBus

__all__ = ["health"]

_MARKS = {"ok": "ok   ", "hint": "hint ", "bad": "BAD  "}


@bus.command()
@click.argument("ids")
@click.option("--backlash", is_flag=True, help="Measure the backlash too: each servo moves by 3 degrees!")
@click.option("--yes", is_flag=True, help="Do not ask.")
@bus_options
@json_option
def health(ids: str, backlash: bool, yes: bool, options: BusOptions, as_json: bool) -> None:
    """Say how servos are, as in `health 1-6`, in the order of the chain from the adapter on.

    Judges faults, supply against voltage class, temperature, current at rest, firmware with known problems, and
    lost answers by their place in the chain. Put the arm down first. Nothing moves without --backlash.

    The exit status is 0 if nothing is BAD, 1 if something is. Hints do not count.
    """
    from hexwire.bus.health import Rank, check_health, judge_health

    wanted = parse_ids(ids)
    if options.series:
        raise UsageError("--series does not apply: the servos are asked")
    with open_bus(options) as opened:
        if backlash:
            refuse_if_stopped(opened, "a motion")
            confirm("Each servo moves by 3 deg to either side. Is the arm put down and free to move?", yes)
        servos = check_health(opened, wanted)
        if backlash:
            servos = [_with_backlash(opened, servo) for servo in servos]
        findings = judge_health(servos)
        if as_json:
            print_json({"healthy": _healthy(findings), "findings": [_json(row) for row in findings]})
        else:
            _show(findings)
        if not _healthy(findings):
            bad = sum(row.rank is Rank.BAD for row in findings)
            raise ServoError(f"{bad} problem{'s' if bad > 1 else ''} found, marked BAD above")


def _healthy(findings: list[HealthFinding]) -> bool:
    from hexwire.bus.health import Rank

    return all(row.rank is not Rank.BAD for row in findings)


def _json(row: HealthFinding) -> dict[str, object]:
    return {
        "level": row.rank.value,
        "ids": row.servo_ids,
        "topic": row.topic,
        "text": row.text,
        "advice": row.advice,
    }


def _show(findings: list[HealthFinding]) -> None:
    from hexwire.bus.health import Rank

    for row in findings:
        who = ", ".join(map(str, row.servo_ids))
        about = f"servo {who}: " if row.rank is not Rank.OK and who and not row.text.startswith("no ") else ""
        say(f"{_MARKS[row.rank.value]} {row.topic:12} {about}{row.text}")
        if row.advice:
            say(f"      -> {row.advice}")


def _with_backlash(opened: ServoBus, servo: ServoSamples) -> ServoSamples:
    from hexwire.control.servo_backlash import measure_backlash

    if not servo.answers:
        return servo
    note(f"servo {servo.servo_id} moves")
    try:
        found = measure_backlash(opened, servo.servo_id, clock=time.monotonic, sleep=time.sleep, shield=shielded)
    except UsageError as error:
        note(f"warning: its backlash is unknown: {error}")
        return servo
    return replace(servo, backlash=found)
