"""`sim bus`: emulated servos on a pseudo-terminal, for any program that uses bus servos.

Owns the options. Must not know how a servo works.
"""

from __future__ import annotations

import os
import re
import sys
import threading
import time
from typing import TYPE_CHECKING

import click

from hexwire.bus.ids import parse_ids
from hexwire.errors import UsageError

from .common import is_typed
from .exits import note
from .output import say_document
from .sim_serve import no_terminals, serve_on_tcp, tcp_option
from .sim_view import shown, view_option

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel

__all__ = ["bus"]

_ARM_BAUD = 1_000_000
"""Factory setting of the servos of an arm."""
_NUMBER = "[0-9]{1,9}"
_SHOWN = 40
"""Number of typed characters that an error text repeats."""


def _parse_rates(text: str) -> list[int]:
    parts = [part.strip() for part in text.split(",")]
    if not all(re.fullmatch(_NUMBER, part) for part in parts):
        raise UsageError(
            f"{text[:_SHOWN]!r} is not a list of rates: write 1000000, or 1000000,500000 with one for each id"
        )
    rates = [int(part) for part in parts]
    if 0 in rates and len(rates) > 1:
        raise UsageError("a rate of 0 matches any rate: give it alone, for all servos")
    return rates


@click.command()
@click.option(
    "--arm",
    type=click.Choice(("so100", "so101")),
    help="The six servos of this arm, assembled but not calibrated, with its mechanical stops.",
)
@click.option("--leader", is_flag=True, help="With --arm, a leader arm, whose gears a hand moves easily.")
@click.option("--physics", is_flag=True, help="With --arm, simulate weight, friction and a table with MuJoCo.")
@view_option
@click.option(
    "--series",
    default="sts_sms",
    show_default=True,
    metavar="S[,S...]",
    help="sts, sms, scs, hls or seven_bot: one for all, or one for each id.",
)
@click.option(
    "--ids", default="1-6", show_default=True, metavar="IDS", help="Such as 1-6 or 1,2,9; duplicate ids collide."
)
@click.option(
    "--baud",
    default="1000000",
    show_default=True,
    metavar="N[,N...]|0",
    help="Rate of the servos: one for all, or one for each id; 0 takes no time and matches any rate.",
)
@click.option(
    "--fault", "faults", multiple=True, metavar="SPEC", help="Fault to inject, such as silent:4; repeatable."
)
@click.option("--echo", is_flag=True, help="The adapter echoes what it sends.")
@click.option("--seed", type=int, default=1, metavar="N", help="Seed of the random generator.")
@tcp_option
@click.option("--link", metavar="PATH", help="Create a symbolic link to the terminal, as a fixed name.")
@click.option(
    "--until-eof", is_flag=True, help="End at the end of standard input, so that the bus does not outlive its user."
)
def bus(
    arm: str | None,
    leader: bool,
    physics: bool,
    view: bool,
    series: str,
    ids: str,
    baud: str,
    faults: tuple[str, ...],
    echo: bool,
    seed: int,
    tcp: str | None,
    link: str | None,
    until_eof: bool,
) -> None:
    """Emulate servos on a bus adapter: prints the port to open, and runs until stopped.

    'hexwire sim hand' moves them by hand.
    """
    from hexwire.bus.servos import as_series
    from hexwire.emulator.bus_device import BusDevice, make_servos
    from hexwire.emulator.faults import FaultPlan
    from hexwire.emulator.so_arms import make_so_arm

    rates = _parse_rates(baud)
    model: ArmModel | None = None
    twin = None
    if arm is not None:
        if wrong := [f"--{name}" for name in ("series", "ids") if is_typed(name)]:
            raise UsageError(f"the servos of {arm} are known; leave out {' and '.join(wrong)}")
        if rates not in ([0], [_ARM_BAUD]):
            raise UsageError(f"the servos of {arm} are set to {_ARM_BAUD} baud; leave out --baud, or make it 0")
        made = make_so_arm(arm, leader=leader, seed=seed, start=time.monotonic())
        servos, model = made.servos, made.model
        if physics:
            from hexwire.emulator.physics import PhysicsTwin

            twin = PhysicsTwin(servos, model)
    elif leader or physics:
        raise UsageError(f"{'--leader' if leader else '--physics'} needs --arm")
    else:
        kinds = [as_series(name.strip()) for name in series.split(",")]
        servos = make_servos(kinds, parse_ids(ids), baud=rates, seed=seed, start=time.monotonic())
    plan = FaultPlan.for_bus(faults, seed=seed, start=time.monotonic())
    ended = threading.Event()
    if until_eof:
        threading.Thread(target=_wait_for_eof, args=(ended,), daemon=True).start()
    with shown(twin, servos, ended.is_set, view=view) as (_, stop):
        if tcp is not None:
            device = BusDevice(servos, paced=bool(rates[0]), faults=plan, echo=echo)
            serve_on_tcp(device, tcp, link=link, baud=0, stop=stop, announce=_announce)
            return
        try:
            from hexwire.emulator.serve_bus import serve_bus
        except ImportError:
            no_terminals()
        serve_bus(
            servos,
            baud=rates[0],
            stop=stop,
            announce=_announce,
            link=link,
            faults=plan,
            echo=echo,
            arm=model,
        )


def _announce(path: str) -> None:
    say_document(path)
    if sys.stdout.isatty():
        note(f"try 'hexwire bus scan --port {path}' in another terminal; Ctrl-C ends the bus")


def _wait_for_eof(ended: threading.Event) -> None:
    # Not through sys.stdin: a thread that holds its lock would abort the interpreter's shutdown.
    while os.read(0, 4096):
        pass
    ended.set()
