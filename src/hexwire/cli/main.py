"""The program `hexwire`: the table of commands, and the options of all of them.

Owns command names and one-line help texts, so that `hexwire --help` imports no command. A command's module is
imported when the command is used.
"""

from __future__ import annotations

import difflib
import importlib
import itertools
import sys
from collections.abc import Mapping
from typing import Any

import click

from .exits import INTERRUPTED, ends_like_ctrl_c, fill_standard_streams, note, run, show_more, warnings_shown

__all__ = ["COMMANDS", "LazyGroup", "cli", "main"]


class LazyGroup(click.Group):
    """A group some of whose commands are imported when they are used.

    Args:
        *args: As for `click.Group`.
        locations: Name -> location of the command (module:attribute) of those.
        **options: As for `click.Group`.
    """

    def __init__(self, *args: Any, locations: Mapping[str, str], **options: Any) -> None:
        super().__init__(*args, **options)
        self._locations = locations

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted({*self._locations, *self.commands})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in self._locations:
            return super().get_command(ctx, cmd_name)
        module, _, attribute = self._locations[cmd_name].partition(":")
        command: click.Command = getattr(importlib.import_module(module), attribute)
        return command


COMMANDS: dict[str, tuple[str, str]] = {
    "analyzers": ("hexwire.cli.trace:analyzers", "Install plug-ins for Wireshark, sigrok and Logic 2."),
    "bus": ("hexwire.cli.bus:bus", "Talk to bus servos through an adapter, without a board."),
    "cert": ("hexwire.cli.cert:cert", "Create certificates for TLS links in a lab."),
    "conf": ("hexwire.cli.channel:conf", "Check and convert channel configuration files (ipc_msg.conf)."),
    "demo": ("hexwire.cli.demo:demo", "Move an emulated arm there and back, with a live table."),
    "firmware": ("hexwire.cli.firmware:firmware", "Build, flash and identify the board's firmware."),
    "follow": ("hexwire.cli.teleop:follow", "Let an arm follow another one that is moved by hand."),
    "doctor": ("hexwire.cli.doctor:doctor", "Diagnose problems, from the USB port to the servos."),
    "fleet": ("hexwire.cli.fleet:fleet", "See, stop, record and play many shared arms; router and rights."),
    "gateway": ("hexwire.cli.channel:gateway", "Put several boards behind one TCP port."),
    "goto": ("hexwire.cli.motion:goto", "Move the tool tip to a position, as fast as allowed."),
    "grip": ("hexwire.cli.power:grip", "Open or close the gripper."),
    "ioctl": ("hexwire.cli.channel:ioctl", "Send one special command to the robot, byte for byte."),
    "joystick": ("hexwire.cli.teleop:joystick", "Read a joystick, or send its state over a channel."),
    "limits": ("hexwire.cli.look:limits", "Show how far and how fast each joint may move."),
    "line": ("hexwire.cli.motion:line", "Move the tool tip on a straight line."),
    "loopback": ("hexwire.cli.doctor:loopback", "Test a cable and adapter, with TX wired to RX."),
    "model": ("hexwire.cli.model:model", "Compute with the arm's geometry; no robot needed."),
    "move": ("hexwire.cli.motion:move", "Move joints to angles in degrees."),
    "ping": ("hexwire.cli.look:ping", "Check which servos answer."),
    "play": ("hexwire.cli.motion:play", "Play a recording or waypoints."),
    "ports": ("hexwire.cli.look:ports", "List serial ports and the devices they probably belong to."),
    "poses": ("hexwire.cli.look:poses", "List, save and delete poses by name."),
    "probe": ("hexwire.cli.look:probe", "Show the identity and condition of the board and its servos."),
    "pump": ("hexwire.cli.power:pump", "Control the suction cup: hold, release, off."),
    "record": ("hexwire.cli.record:record", "Inspect, convert and repair recordings."),
    "registers": ("hexwire.cli.look:registers", "Show the registers of a servo behind a board."),
    "resume": ("hexwire.cli.power:resume", "End a stop; the arm does not move."),
    "serve": ("hexwire.cli.serve:serve", "Share an arm with other programs and machines."),
    "sim": ("hexwire.cli.sim:sim", "Emulate a board on a pseudo-terminal."),
    "state": ("hexwire.cli.look:state", "Show all joints, once or live."),
    "stop": ("hexwire.cli.power:stop", "Stop the arm and keep it stopped."),
    "studio": ("hexwire.cli.studio:studio", "Show the arm, its servos and its wire in a browser."),
    "teach": ("hexwire.cli.motion:teach", "Record a motion made by moving the arm by hand."),
    "teleop": ("hexwire.cli.teleop:teleop", "Move an arm by joystick."),
    "tip": ("hexwire.cli.look:tip", "Show where the tip of the tool is."),
    "torque": ("hexwire.cli.power:torque", "Switch torque on (without moving the arm) or off."),
    "trace": ("hexwire.cli.trace:trace", "Decode recorded traffic."),
}
"""Name -> location of the command (module:attribute) and its one-line help."""

GROUPS: dict[str, tuple[str, ...]] = {
    "without an arm": ("demo", "sim", "studio", "model"),
    "look": ("ports", "probe", "ping", "state", "tip", "limits", "poses", "registers"),
    "move": ("move", "goto", "line", "play", "teach", "grip", "pump", "joystick", "teleop", "follow"),
    "stop, power": ("stop", "resume", "torque"),
    "share": ("serve", "fleet", "gateway", "cert", "conf"),
    "set up, mend": ("bus", "firmware", "doctor", "loopback", "trace", "record", "ioctl", "analyzers"),
}
"""Every command once, by what it is for, as the help names them."""

SPELLED = {"home": "goto home", "open": "grip open", "close": "grip close", "read": "state", "send": "move"}
"""Verbs of `hexwire.Arm` that a command does under another name."""

_WITHOUT_HARDWARE = "To try it without hardware, run 'hexwire sim board'; it prints the port of an emulated arm."
_ANYWHERE = ("--trace", "--explain")
_RECORD = ("--record", "--record-ros2")


class _Program(LazyGroup):
    """The group of all commands, run as a program."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, locations={name: at for name, (at, _) in COMMANDS.items()}, **options)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        # Not from the commands, which would all be imported. Their lines do not fit one screen.
        if ctx.params.get("verbose"):
            for title, names in GROUPS.items():
                with formatter.section(title.capitalize()):
                    formatter.write_dl([(name, COMMANDS[name][1]) for name in names])
            formatter.write_paragraph()
            formatter.write_text(_WITHOUT_HARDWARE)
        else:
            with formatter.section("Commands ('hexwire -v --help' has a line for each)"):
                formatter.write_dl([(title, " ".join(names)) for title, names in GROUPS.items()])

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        # Users type `hexwire state --trace`, so these options are accepted at any position.
        end = args.index("--") if "--" in args else len(args)
        front, rest = [], []
        words = iter(args[:end])
        for arg in words:
            if arg in _RECORD:
                front += [arg, *itertools.islice(words, 1)]
            elif arg in _ANYWHERE or arg.partition("=")[0] in _RECORD:
                front.append(arg)
            else:
                rest.append(arg)
        if "--force" in rest and any(arg.partition("=")[0] in _RECORD for arg in front):
            rest.remove("--force")
            front.append("--force")
        return super().parse_args(ctx, [*front, *rest, *args[end:]])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and args[0] not in COMMANDS and not args[0].startswith("-") and not ctx.resilient_parsing:
            near = [SPELLED[args[0]]] if args[0] in SPELLED else difflib.get_close_matches(args[0], COMMANDS, n=1)
            ctx.fail(f"no command {args[0]!r}" + (f"; did you mean {near[0]!r}?" if near else ""))
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt:
            if sys.stderr.isatty():
                note("")  # end the line after the terminal's own ^C
            raise click.exceptions.Exit(INTERRUPTED) from None

    def main(self, *args: Any, **options: Any) -> Any:
        """Run as a program: raises SystemExit with the exit status."""
        options["standalone_mode"] = False
        parent_main = super().main
        with warnings_shown():
            status = run(lambda: parent_main(*args, **options))
        sys.exit(status)


@click.command(
    cls=_Program,
    help="Control a robot arm, from joint commands down to the bytes on the wire. "
    "Exit status: 0 success, 1 device or line, 2 usage, 130 interrupted.",
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.option("-v", "--verbose", count=True, is_eager=True, help="Report events on the line; twice: all details.")
@click.option("--trace", is_flag=True, envvar="HEXWIRE_TRACE", help="Print every byte that goes over the line.")
@click.option("--explain", is_flag=True, help="The same, with the meaning of each byte.")
@click.option("--record", metavar="FILE", help="Record traffic, frames and joint states to FILE.mcap.")
@click.option("--record-ros2", metavar="FOLDER", help="The same to a bag of ROS 2, with the arm's URDF.")
@click.option("--force", is_flag=True, help="With --record or --record-ros2, overwrite.")
@click.option("--robot", metavar="NAME", help="Robot, for every command that takes --robot.")
@click.option("--port", metavar="URL", help="Its port, for every command that takes --port.")
@click.version_option(None, "-V", "--version", package_name="hexwire", message="%(prog)s %(version)s", hidden=True)
@click.help_option("-h", "--help", help="Show this message; -V, --version: the version.")
@click.pass_context
def cli(
    ctx: click.Context,
    verbose: int,
    trace: bool,
    explain: bool,
    record: str | None,
    record_ros2: str | None,
    force: bool,
    robot: str | None,
    port: str | None,
) -> None:
    """Apply the options of all commands."""
    show_more(verbose)
    if trace or explain:
        from .trace import tracing

        ctx.with_resource(tracing(explain=explain))
    if record is not None and record_ros2 is not None:
        raise click.UsageError(
            "use --record or --record-ros2; 'hexwire record ros2' converts a recording later", ctx
        )
    # A failing recording must not prevent a stop.
    optional = ctx.invoked_subcommand == "stop"
    if record is not None:
        from .record import capturing

        ctx.with_resource(capturing(record, force=force, optional=optional))
    elif record_ros2 is not None:
        from .record import bag_recording

        ctx.with_resource(bag_recording(record_ros2, force=force, optional=optional))
    elif force:
        raise click.UsageError("--force before a command needs --record", ctx)


def main() -> None:
    """Entry point of the program."""
    fill_standard_streams()
    ends_like_ctrl_c()
    cli.main(prog_name="hexwire")
