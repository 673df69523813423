"""`serve`: share arms with other programs and machines.

Owns the command line, and the loop until a signal ends it.
"""

from __future__ import annotations

import platform
from typing import TYPE_CHECKING, Any

import click

from hexwire.errors import UsageError

from .exits import note
from .options import (
    DEFAULT_ROBOT,
    arm_settings,
    camera_option,
    certificate_options,
    early_port,
    early_robot,
    host_timed_option,
    is_typed,
    links_option,
    number_option,
    table_options,
)
from .output import say

if TYPE_CHECKING:
    from collections.abc import Callable

    from hexwire.fleet.network import Network
    from hexwire.fleet.service_file import ServedArm
    from hexwire.studio.viewers import Viewers

__all__ = ["serve"]

_PATIENCE = 12.0
"""Seconds from the signal in which all arms must be safe."""
_LOOK = 0.1
"""Seconds between two checks of the arms."""
_SWITCH = 0.001
"""Seconds for which one thread may run while others wait: the owner of an arm waits for no answer to a client."""


@click.command()
@click.option("--robot", metavar="NAME", help=f"Type of robot; sim: an emulated one.  [default: {DEFAULT_ROBOT}]")
@click.option("--port", metavar="URL", envvar="HEXWIRE_PORT", show_envvar=True, help="Device or link of the robot.")
@click.option("--name", metavar="NAME", help="Name to share it under, such as lab/arm1.  [default: its model]")
@click.option("--config", "file", metavar="FILE", help="A file with several arms, and the settings of the network.")
@click.option("--wait", is_flag=True, help="Wait for a port that is not there yet, instead of failing after 10 s.")
@click.option("--listen", multiple=True, metavar="ENDPOINT", help="Also listen there, as in tls/0.0.0.0:7447.")
@click.option("--router", multiple=True, metavar="ENDPOINT", help="Also connect to this router.")
@certificate_options("this arm")
@click.option("--access", metavar="FILE", help="Rights by certificate, as 'hexwire fleet config' writes them.")
@number_option("--lease", "SECONDS", "Silence after which a lease is lost.", minimum=0.1, default=0.5)
@click.option(
    "--foxglove",
    is_flag=False,
    flag_value="127.0.0.1:0",
    metavar="[[HOST:]PORT]",
    help="Also show the arms to Foxglove on this machine: states, targets, log and 3D scene, for watching.",
)
@click.option(
    "--foxglove-origin",
    "origins",
    multiple=True,
    metavar="URL",
    help="With --foxglove: a web page that may connect, as https://app.foxglove.dev.",
)
@camera_option("--foxglove")
@host_timed_option
@links_option
@table_options
def serve(
    robot: str | None,
    port: str | None,
    name: str | None,
    file: str | None,
    wait: bool,
    listen: tuple[str, ...],
    router: tuple[str, ...],
    ca: str,
    cert: str,
    key: str,
    access: str | None,
    reachable_without_certificates: bool,
    lease: float,
    foxglove: str | None,
    origins: tuple[str, ...],
    cameras: tuple[str, ...],
    host_timed: bool,
    links: str,
    table: float | None,
) -> None:
    """Share an arm: any number of programs read it, one at a time commands it, and each can stop it.

    Others open it as zenoh:NAME. Without --listen and --router only programs of this user on this machine reach it.
    Nothing is sent that moves it until a program commands it. Ctrl-C and every other signal that ends it first
    stop a motion; the joints keep their torque, so the arm does not fall. If the port is lost, the arm is stopped,
    and it is shared again when the port returns; 'hexwire resume' then ends the stop.
    """
    from hexwire.fleet.node import load_zenoh
    from hexwire.fleet.service_file import read_arms, read_service_file

    # Before a port is looked for: without it nothing is served.
    load_zenoh()
    network: dict[str, Any] = {}
    if file is not None:
        typed = [
            option
            for option in ("robot", "port", "name", "links", "table", "no_table", "host_timed")
            if is_typed(option)
        ]
        if typed:
            wrong = ", ".join(f"--{option.replace('_', '-')}" for option in typed)
            raise UsageError(f"--config names the arms and their settings; leave out {wrong}")
        arms, network = read_service_file(file, lease=lease)
    else:
        given = _given(robot, early_port(port), links, table) | {"host_timed": host_timed}
        arms = read_arms({name or "": given}, lease=lease)
    rows = {"listen": listen, "connect": router, "ca": ca, "cert": cert, "key": key, "access": access}
    network |= {row: value for row, value in rows.items() if value}
    if reachable_without_certificates:
        network["reachable_without_certificates"] = True
    if origins and foxglove is None:
        raise UsageError("--foxglove-origin is for --foxglove")
    if cameras and foxglove is None:
        raise UsageError("--camera is for --foxglove")
    viewers = None if foxglove is None else _viewers(foxglove, origins, cameras)
    _run(arms, _network(network), wait, viewers)


def _viewers(listen: str, origins: tuple[str, ...], cameras: tuple[str, ...]) -> Viewers:
    try:
        from hexwire.studio.v4l2 import find_cameras
        from hexwire.studio.viewers import Viewers
    except ImportError as error:
        raise UsageError(f"--foxglove needs the studio: pip install 'hexwire[studio]' ({error})") from None
    found = find_cameras(cameras) if cameras else None
    return Viewers(listen, frozenset(map(str.lower, origins)), found)


def _given(robot: str | None, port: str | None, links: str, table: float | None) -> dict[str, object]:
    """The settings of the only arm."""
    from hexwire.fleet.service_file import SIMULATED

    robot = early_robot(robot)
    rows = arm_settings(links, table)
    if robot:
        rows["robot"] = robot
    if port and not (robot == SIMULATED and not is_typed("port")):
        rows["port"] = port
    return rows


def _network(rows: dict[str, Any]) -> Network:
    from hexwire.fleet.network import Network, read_access

    if "access" in rows:
        rows["access"] = read_access(rows["access"])
    return Network(**rows)


def _run(arms: list[ServedArm], network: Network, wait: bool, viewers: Viewers | None) -> None:
    import sys
    from contextlib import ExitStack

    from hexwire.control.loop.shutdown import Shutdown
    from hexwire.fleet.remote import whoami
    from hexwire.fleet.service import Service

    sys.setswitchinterval(_SWITCH)
    shutdown = Shutdown(_PATIENCE)
    # From here on a signal only asks for the end, so that no second one can interrupt what makes an arm safe.
    shutdown.listen()
    server = f"{whoami()}, Python {platform.python_version()}"
    service = Service(arms, network, wait=wait, server=server, watch=None if viewers is None else viewers.watch)
    with ExitStack() as stack:
        stack.callback(service.close)
        # What ends the program if the end hangs: then the boards' watchdogs stop the arms.
        stack.callback(shutdown.request)
        if viewers is not None:
            say(f"foxglove: {viewers.start()}", flush=True)
            stack.callback(viewers.end)
        service.start()
        while not shutdown.wait(_LOOK):
            _tell(service.news)
            service.check()
    note("the arms are no longer shared")


def _tell(news: Callable[[], list[str]]) -> None:
    for line in news():
        say(line, flush=True)
