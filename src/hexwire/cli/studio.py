"""`studio`: the arm, its servos and its wire in a browser.

Owns the command line, and the start and end of the program.
"""

from __future__ import annotations

import importlib
import os
import sys
import tempfile
import threading
import webbrowser
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from enum import Enum
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hexwire.errors import HexwireError, UsageError

from .exits import note
from .options import (
    arm_settings,
    camera_option,
    early_port,
    early_robot,
    host_timed_option,
    is_typed,
    links_option,
    table_options,
)
from .output import say

if TYPE_CHECKING:
    from hexwire.control.loop.shutdown import Shutdown
    from hexwire.studio.app import Studio
    from hexwire.studio.cameras import Cameras
    from hexwire.studio.server import Server

__all__ = ["studio"]

_PATIENCE = 12.0
"""Seconds from the signal in which the arm must be safe."""
_MOST_NOTES = 8
"""Meshes that the terminal tells of; the page tells of all."""
_SWITCH = 0.00002
"""Seconds for which one thread may run while others wait: the owner of the arm waits for no page. Much less
than `hexwire serve` sets, since pages keep their thread busy for longer; `make bench` measures how late the
owner's cycles are."""
_MISSING = "the studio is not installed: pip install 'hexwire[studio]'"


@dataclass(frozen=True, slots=True)
class _Protection:
    """Where the page is served, how it is protected, and what else it shows; all as typed."""

    listen: str
    cert: str
    key: str
    ca: str
    password_file: str
    foxglove: bool
    origins: frozenset[str]
    cameras: tuple[str, ...]


class _Demo(Enum):
    """Which emulated arm is started, with what the page says of it."""

    NONE = ""
    PLAIN = (
        "An emulated arm: its joints move, but have no weight. "
        "'hexwire studio --demo --physics' gives it weight where MuJoCo is installed."
    )
    PHYSICS = "An emulated arm with the physics of MuJoCo: it has weight, and sinks to its table without torque."


@click.command()
@click.option("--demo", is_flag=True, help="Open an emulated Hex7Bot; no hardware is needed.")
@click.option("--physics", is_flag=True, help="With --demo: give the arm weight, and a table, by MuJoCo.")
@click.option(
    "--port",
    metavar="URL",
    envvar="HEXWIRE_PORT",
    show_envvar=True,
    help="Device, link, shared or emulated arm. Without it, the page shows what is plugged in.",
)
@click.option("--robot", metavar="NAME", help="Type of robot on the port.")
@click.option("--take", is_flag=True, help="Command a shared arm even if another program holds its lease.")
@click.option(
    "--listen",
    metavar="[HOST:]PORT",
    default="127.0.0.1:0",
    help="Where the page is served; at other addresses than 127.0.0.1 it needs TLS.  [default: a free port]",
)
@click.option("--cert", default="", metavar="FILE", help="Certificate of the page, for TLS.")
@click.option("--key", default="", metavar="FILE", help="Its key.")
@click.option("--ca", default="", metavar="FILE", help="Only browsers with a certificate of this authority.")
@click.option("--password-file", default="", metavar="FILE", help="Whoever knows the password in it may operate.")
@click.option(
    "--recordings",
    metavar="DIR",
    type=click.Path(file_okay=False),
    help="Folder of recordings.  [default: ~/.local/share/hexwire/recordings]",
)
@click.option(
    "--foxglove",
    is_flag=True,
    help="Also show it to Foxglove: states, targets, log, 3D scene and cameras, for watching.",
)
@click.option(
    "--foxglove-origin",
    "origins",
    multiple=True,
    metavar="URL",
    help="With --foxglove: a web page that may connect, as https://app.foxglove.dev.",
)
@camera_option("pages and --foxglove, also to whoever only watches")
@click.option(
    "--urdf",
    metavar="FOLDER",
    type=click.Path(exists=True),
    help="Draw the robot of the URDF in this folder, with meshes (STL, glTF), in place of the arm's own picture.",
)
@click.option("--no-browser", is_flag=True, help="Only print the address.")
@host_timed_option
@links_option
@table_options
def studio(
    demo: bool,
    physics: bool,
    port: str | None,
    robot: str | None,
    take: bool,
    listen: str,
    cert: str,
    key: str,
    ca: str,
    password_file: str,
    recordings: str | None,
    foxglove: bool,
    origins: tuple[str, ...],
    cameras: tuple[str, ...],
    urdf: str | None,
    no_browser: bool,
    host_timed: bool,
    links: str,
    table: float | None,
) -> None:
    """Show the arm, its servos and its wire in a browser on this machine.

    Prints two addresses with keys: whoever knows the first can command the arm, the second is for watching. Nothing
    moves until somebody takes control. A jog ends when its button is released, and every motion when its page is
    hidden, closed or without a connection. Ctrl-C ends the studio; the joints keep their torque.
    """
    if find_spec("uvicorn") is None:
        raise UsageError(_MISSING)
    port = early_port(port)
    robot = early_robot(robot)
    if demo and port and is_typed("port"):
        raise UsageError("--demo has an arm of its own; leave out --port")
    if physics and not demo:
        raise UsageError("--physics is for --demo; for an arm on a port of its own there is 'hexwire sim board'")
    settings = arm_settings(links, table) | {"host_timed": host_timed}
    if take and not (port or "").startswith("zenoh:"):
        raise UsageError("--take is for a shared arm, as in --port zenoh:lab/arm1")
    if take and port:
        port = f"{port}{'&' if '?' in port else '?'}take=1"
    _check_typed("" if demo else port or "", robot, settings)
    if origins and not foxglove:
        raise UsageError("--foxglove-origin is for --foxglove")
    protection = _Protection(
        listen, cert, key, ca, password_file, foxglove, frozenset(map(str.lower, origins)), cameras
    )
    folder = None if recordings is None else Path(recordings)
    kind = _Demo.PHYSICS if physics else _Demo.PLAIN if demo else _Demo.NONE
    _run(kind, None if demo else port, robot, settings, protection, folder, urdf, browser=not no_browser)


def _check_typed(port: str, robot: str | None, settings: dict[str, object]) -> None:
    """Refuse what can never be opened; opens nothing. Whatever else fails is shown on the page."""
    from hexwire.control.requests.setting import Faults
    from hexwire.control.requests.settings_reader import read_settings
    from hexwire.drivers.registry import is_address, load_driver

    if robot:
        load_driver(robot)
    # What a shared arm is, only its server knows.
    if port and not is_address(port):
        read_settings({"port": port} | ({"robot": robot} if robot else {}) | settings, Faults())


def _run(
    demo: _Demo,
    port: str | None,
    robot: str | None,
    settings: dict[str, object],
    protection: _Protection,
    recordings: Path | None,
    urdf: str | None,
    *,
    browser: bool,
) -> None:
    from concurrent.futures import ThreadPoolExecutor

    from hexwire.control.loop.shutdown import Shutdown
    from hexwire.studio.memory import pass_by_hand

    sys.setswitchinterval(_SWITCH)
    shutdown = Shutdown(_PATIENCE)
    shutdown.interrupts = True
    shutdown.listen()
    with ExitStack() as stack:
        made, listen = _make(protection, recordings)
        if urdf is not None:
            from hexwire.studio.urdf_folder import UrdfFolder

            # Before the arm is open: reading many files keeps it waiting for nothing.
            made.urdf = UrdfFolder(urdf)
            faults = made.urdf.faults
            for fault in faults[:_MOST_NOTES]:
                note(f"not shown: {fault}")
            if len(faults) > _MOST_NOTES:
                note(f"not shown: {len(faults) - _MOST_NOTES} more")
        # The web server takes a moment to import: meanwhile the emulator starts.
        importing = stack.enter_context(ThreadPoolExecutor(1, "import"))
        imported = importing.submit(importlib.import_module, "hexwire.studio.server")
        if demo is not _Demo.NONE:
            from .demo import board_process

            port = stack.enter_context(board_process(physics=demo is _Demo.PHYSICS))
            made.demo = (port, demo.value)
        # Before the board ends: the arm is made safe first.
        stack.callback(made.close)
        try:
            module: Any = imported.result()
        except ImportError as error:
            raise UsageError(f"{_MISSING} ({error})") from None
        made.settings = settings
        server = _serve(module, made, protection, listen)

        first = "/move" if port else "/"

        def started() -> None:
            # Not before: an import keeps other threads waiting longer than a watchdog does.
            pass_by_hand()
            if port:
                opening = threading.Thread(
                    target=_open, args=(made, port, robot, settings), name="opening", daemon=True
                )
                opening.start()
                stack.callback(opening.join)
            lines = [
                f"operate: {module.url_of(server, made.access.operate_token, first)}",
                f"watch:   {module.url_of(server, made.access.watch_token, first)}",
            ]
            if made.foxglove is not None:
                lines.append(f"foxglove: {module.socket_of(server)}")
            for line in lines:
                say(line, flush=True)
            if browser:
                _show(module.url_of(server, made.access.operate_token, first), stack)

        # From here on a signal only asks for the end, so that no second one can interrupt what makes the arm safe.
        shutdown.interrupts = False
        ender = threading.Thread(target=_end_on_signal, args=(shutdown, made, server), name="signals", daemon=True)
        ender.start()
        try:
            server.run(started)
        finally:
            shutdown.request()
            ender.join()
    note("the studio has ended")


def _make(protection: _Protection, recordings: Path | None) -> tuple[Studio, tuple[str, int]]:
    """A studio with its rules of access, and where it listens; checks all options."""
    from hexwire.studio import listening
    from hexwire.studio.access import Access
    from hexwire.studio.app import Studio

    host, number = listening.parse_listen(protection.listen)
    password = listening.read_password(protection.password_file) if protection.password_file else ""
    cert, key, ca = protection.cert, protection.key, protection.ca
    listening.check_protected(host, cert=cert, key=key, ca=ca, password=bool(password))
    if cert:
        listening.check_tls(cert, key, ca)
    access = Access(frozenset(), secure=bool(cert), password=password, origins=protection.origins)
    cameras, foxglove = _cameras(protection.cameras), None
    if protection.foxglove:
        from hexwire.studio.foxglove import Foxglove

        foxglove = Foxglove("hexwire studio", cameras=cameras)
    return Studio(access, recordings, foxglove, cameras), (host, number)


def _cameras(devices: tuple[str, ...]) -> Cameras | None:
    """The cameras that are asked for; imported now, while no arm waits for the interpreter."""
    if not devices:
        return None
    from hexwire.studio.v4l2 import find_cameras

    return find_cameras(devices)


def _serve(module: Any, made: Studio, protection: _Protection, listen: tuple[str, int]) -> Server:
    from hexwire.studio import listening

    cert, host = protection.cert, listen[0]
    files = (cert, protection.key) if cert else None
    make = partial(module.make_app, made)
    server: Server = module.Server(
        make, made.access, host, listen[1], files, protection.ca or None, listening.right_of
    )
    made.access.hosts = listening.host_names(host, server.bind(), cert, secure=bool(cert))
    return server


def _open(made: Studio, port: str, robot: str | None, settings: dict[str, object]) -> None:
    try:
        made.source.open(port, robot, **settings)
    except HexwireError as error:
        note(f"{port} is not open: {error}")


def _show(url: str, stack: ExitStack) -> None:
    """Open the address in a browser, if there is a screen."""
    has_screen = sys.platform in ("darwin", "win32") or "DISPLAY" in os.environ or "WAYLAND_DISPLAY" in os.environ
    if not has_screen or not sys.stdout.isatty():
        return
    # Through a file that only this user can read: other users see the arguments of the browser, but not this key.
    number, name = tempfile.mkstemp(suffix=".html", prefix="hexwire-studio-")
    with os.fdopen(number, "w", encoding="utf-8") as file:
        file.write(f'<!doctype html><meta charset="utf-8"><meta http-equiv="refresh" content="0;url={url}">')
    stack.callback(_remove, name)
    threading.Thread(target=webbrowser.open, args=(Path(name).as_uri(),), name="browser", daemon=True).start()


def _remove(name: str) -> None:
    with suppress(OSError):
        Path(name).unlink()


def _end_on_signal(shutdown: Shutdown, made: Studio, server: Server) -> None:
    while not shutdown.wait(0.1):
        pass
    made.end_motions("the studio ends")
    server.end()
