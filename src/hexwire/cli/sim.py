"""`sim`: emulated hardware for other programs.

Owns the options of the emulator and when it ends. Must not know how a board works.
"""

from __future__ import annotations

import os
import sys
import threading
import time

import click

from hexwire.errors import UsageError

from .exits import note
from .numbers import number_option
from .output import say_document
from .sim_bus import bus
from .sim_hand import hand
from .sim_puma import puma260
from .sim_serve import queue_link, queue_option, serve_device, tcp_option
from .sim_view import shown, view_option

__all__ = ["sim"]

_SERVO_BAUD = 115200
"""Rate of the emulated servo bus if the line is paced, as set by the chapter's sketch."""


@click.group()
def sim() -> None:
    """Emulate hardware for other programs."""


sim.add_command(bus)
sim.add_command(hand)
sim.add_command(puma260)


@sim.command()
@click.option("--link", metavar="PATH", help="Create a symbolic link to the terminal, as a fixed name.")
@click.option(
    "--baud",
    type=click.IntRange(min=0),
    default=115200,
    show_default=True,
    metavar="N|0",
    help="Simulate this line rate; 0 means as fast as possible.",
)
@click.option(
    "--dialect",
    type=click.IntRange(1, 2),
    default=2,
    show_default=True,
    metavar="1|2",
    help="1 for the chapter's board, 2 for hexwire's firmware.",
)
@click.option(
    "--fault", "faults", multiple=True, metavar="SPEC", help="Fault to inject, such as silent:4; repeatable."
)
@click.option("--seed", type=int, default=0, metavar="N", help="Seed of the random generator.")
@click.option("--physics", is_flag=True, help="Simulate weight, sag and a table with MuJoCo.")
@number_option("--payload", "GRAMS", "With --physics, the payload of the tool.", minimum=0)
@view_option
@tcp_option
@queue_option
@click.option("--reset-on-open", is_flag=True, help="Reset the board when the port is opened, like a real Mega.")
@click.option(
    "--until-eof",
    is_flag=True,
    help="End at the end of standard input, so that the board does not outlive its user.",
)
def board(
    link: str | None,
    baud: int,
    dialect: int,
    faults: tuple[str, ...],
    seed: int,
    physics: bool,
    payload: float | None,
    view: bool,
    tcp: str | None,
    queue: str | None,
    reset_on_open: bool,
    until_eof: bool,
) -> None:
    """Emulate a Hex7Bot: prints the port to open, and runs until stopped."""
    from hexwire.emulator.board import make_hex7bot_board
    from hexwire.emulator.hand import Hands
    from hexwire.emulator.serve_tcp import serve_queue
    from hexwire.ipc.connections import random_number
    from hexwire.model.hex7bot import HEX7BOT

    if queue is not None and (tcp is not None or link is not None or reset_on_open):
        raise UsageError("--queue offers a queue instead of a port: leave out --tcp, --link and --reset-on-open")
    if queue is not None and dialect == 1:
        raise UsageError("--queue: the chapter's board has no conversations; it needs a serial line or --tcp")
    messages = None if queue is None else queue_link(queue)
    device = make_hex7bot_board(
        dialect=dialect,
        baud=_SERVO_BAUD if baud else 0,
        faults=faults,
        seed=seed,
        start=time.monotonic(),
        # Only a terminal has a rate that a host can change.
        host_rate=baud if tcp is None and queue is None else 0,
        numbers=None if queue is None else random_number,
    )
    twin = None
    if physics:
        from hexwire.emulator.physics import PhysicsTwin
        from hexwire.model.hex7bot_kinematics import Hex7BotModel

        twin = PhysicsTwin(device.wire.servos, Hex7BotModel(), payload=(payload or 0.0) / 1000)
    elif payload is not None:
        raise UsageError("--payload needs --physics")
    ended = threading.Event()
    if until_eof:
        threading.Thread(target=_wait_for_eof, args=(ended,), daemon=True).start()
    with shown(twin, device.wire.servos, ended.is_set, view=view) as (window, stop):
        served = device if window is None else window.with_device(device)
        if messages is not None:
            serve_queue(served, messages, stop=stop, announce=_announce)
            return
        serve_device(
            served,
            tcp=tcp,
            link=link,
            baud=baud,
            reset_on_open=reset_on_open,
            hands=Hands(device.wire.servos, HEX7BOT),
            rate=(lambda: device.host_rate) if device.host_rate else None,
            stop=stop,
            announce=_announce,
        )


def _announce(path: str) -> None:
    say_document(path)
    if sys.stdout.isatty():
        note(f"try 'hexwire state --port {path}' in another terminal; Ctrl-C ends the board")


def _wait_for_eof(ended: threading.Event) -> None:
    # Not through sys.stdin: a thread that holds its lock would abort the interpreter's shutdown.
    while os.read(0, 4096):
        pass
    ended.set()
