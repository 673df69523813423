"""`sim bus`: emulated servos on a pseudo-terminal, for any program that speaks to bus servos.

Owns the options. Must not know how a servo works.
"""

from __future__ import annotations

import os
import sys
import threading
import time

import click

from hexwire.errors import UsageError

from .exits import note

__all__ = ["bus", "parse_ids"]


def parse_ids(text: str) -> list[int]:
    """Servo ids from ``1-7``, ``1,2,5`` or both mixed.

    Raises:
        UsageError: It is neither.
    """
    ids: list[int] = []
    for part in text.split(","):
        first, dash, last = part.strip().partition("-")
        if not first.isdecimal() or (dash and not last.isdecimal()):
            raise UsageError(f"{text!r} names no servo ids: write 1-7 or 1,2,5")
        low, high = int(first), int(last or first)
        if high > 253 or low > high:
            raise UsageError(f"{part.strip()!r} names no servo ids: they are from 0 to 253")
        ids.extend(range(low, high + 1))
    return ids


@click.command()
@click.option(
    "--series",
    default="sts_sms",
    show_default=True,
    metavar="S[,S...]",
    help="seven_bot, scs, sts_sms or hls: one for all, or one for each id.",
)
@click.option(
    "--ids", default="1-6", show_default=True, metavar="IDS", help="As 1-6 or 1,2,9; twice the same collides."
)
@click.option(
    "--baud",
    type=click.IntRange(min=0),
    default=1_000_000,
    show_default=True,
    metavar="N|0",
    help="Rate the servos are set to; 0 costs no time and is heard at any rate.",
)
@click.option("--fault", "faults", multiple=True, metavar="SPEC", help="What goes wrong, as silent:4; repeatable.")
@click.option("--echo", is_flag=True, help="The adapter hears itself.")
@click.option("--seed", type=int, default=1, metavar="N", help="For everything random.")
@click.option("--link", metavar="PATH", help="Make a symbolic link to the terminal: a name that stays.")
@click.option("--until-eof", is_flag=True, help="End when standard input does, so that no bus outlives its user.")
def bus(
    series: str,
    ids: str,
    baud: int,
    faults: tuple[str, ...],
    echo: bool,
    seed: int,
    link: str | None,
    until_eof: bool,
) -> None:
    """Emulate servos on a bus adapter: prints the port to open, and runs until it is stopped."""
    from hexwire.emulator.bus_device import make_servos
    from hexwire.emulator.faults import FaultPlan
    from hexwire.emulator.serve_bus import serve_bus
    from hexwire.ipc.bus_orders import as_series

    kinds = [as_series(name.strip()) for name in series.split(",")]
    servos = make_servos(kinds, parse_ids(ids), baud=baud, seed=seed, start=time.monotonic())
    plan = FaultPlan(faults, seed=seed)
    ended = threading.Event()
    if until_eof:
        threading.Thread(target=_wait_for_eof, args=(ended,), daemon=True).start()
    serve_bus(servos, baud=baud, stop=ended.is_set, announce=_announce, link=link, faults=plan, echo=echo)


def _announce(path: str) -> None:
    print(path, flush=True)
    if sys.stdout.isatty():
        note(f"try 'hexwire bus scan --port {path}' in another terminal; Ctrl-C ends the bus")


def _wait_for_eof(ended: threading.Event) -> None:
    # Not through sys.stdin: a thread that holds its lock would abort the interpreter's end.
    while os.read(0, 4096):
        pass
    ended.set()
