"""`studio`: the arm, its servos and its wire in a browser.

Owns the command line, and the start and end of the program. Must not know what the pages show.
"""

from __future__ import annotations

import sys
import threading
from contextlib import ExitStack
from typing import TYPE_CHECKING

import click

from hexwire.errors import HexwireError, UsageError

from .common import early_port
from .exits import note
from .output import say

if TYPE_CHECKING:
    from hexwire.control.shutdown import Shutdown
    from hexwire.studio.server import Server

__all__ = ["studio"]

_PATIENCE = 12.0
"""Seconds from the signal in which the arm must be safe."""
_SWITCH = 0.001
"""Seconds for which one thread may run while others wait: the owner of the arm waits for no page."""


@click.command()
@click.option("--demo", is_flag=True, help="Open an emulated Hex7Bot; no hardware is needed.")
@click.option(
    "--port",
    metavar="URL",
    envvar="HEXWIRE_PORT",
    show_envvar=True,
    help="Device, link, shared or emulated arm. Without it, the page shows what is plugged in.",
)
@click.option("--robot", metavar="NAME", help="Type of robot on the port.")
@click.option(
    "--at", "http_port", type=click.IntRange(0, 65535), default=0, metavar="PORT", help="Port of the page."
)
def studio(demo: bool, port: str | None, robot: str | None, http_port: int) -> None:
    """Show the arm, its servos and its wire in a browser on this machine.

    Prints an address with a key; whoever knows it can command the arm. Nothing moves until somebody takes control
    and holds a button. Ctrl-C ends it; the joints keep their torque.
    """
    port = early_port(port)
    robot = robot or click.get_current_context().find_root().params.get("robot")
    if demo and port:
        raise UsageError("--demo has an arm of its own; leave out --port")
    _run(demo, port, robot, http_port)


def _run(demo: bool, port: str | None, robot: str | None, http_port: int) -> None:
    from hexwire.control.shutdown import Shutdown

    sys.setswitchinterval(_SWITCH)
    shutdown = Shutdown(_PATIENCE)
    shutdown.interrupts = True
    shutdown.listen()
    with ExitStack() as stack:
        if demo:
            from .board_process import board_process

            port = stack.enter_context(board_process())
        try:
            from hexwire.studio.access import Access
            from hexwire.studio.app import Studio
            from hexwire.studio.server import Server, url_of
        except ImportError as error:
            raise UsageError(f"the studio is not installed ({error}); pip install hexwire[studio]") from None
        made = Studio(Access(frozenset()))
        stack.callback(made.close)
        server = Server(made, port=http_port)
        number = server.bind()
        made.access.hosts = frozenset({f"127.0.0.1:{number}", f"localhost:{number}"})

        def open_port() -> None:
            try:
                made.source.open(str(port), robot)
            except HexwireError as error:
                note(f"{port} is not open: {error}")

        if port:
            threading.Thread(target=open_port, name="opening", daemon=True).start()

        def started() -> None:
            say(f"operate: {url_of(server, made.access.operate_token)}", flush=True)
            say(f"watch:   {url_of(server, made.access.watch_token)}", flush=True)

        # From here on a signal only asks for the end, so that no second one can interrupt what makes the arm safe.
        shutdown.interrupts = False
        ender = threading.Thread(target=_end_on_signal, args=(shutdown, server), name="signals", daemon=True)
        ender.start()
        try:
            server.run(started)
        finally:
            shutdown.request()
            ender.join()
    note("the studio has ended")


def _end_on_signal(shutdown: Shutdown, server: Server) -> None:
    while not shutdown.wait(0.1):
        pass
    server.end()
