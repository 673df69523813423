"""`fleet`: many shared arms at once, the router between machines, and the rights in it.

Owns arguments, tables and lines. Must not know how arms are found, asked, stopped, recorded or moved together:
`hexwire.fleet` does.
"""

from __future__ import annotations

import functools
import json
import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import click

from hexwire.errors import LinkLostError, LinkNotFoundError, LinkPermissionError, UsageError

from .exits import ends_when_asked, note, shielded
from .options import (
    certificate_options,
    force_option,
    json_option,
    number_option,
    on_terminal,
    router_options,
)
from .output import Column, RowType, answer, print_json, say, wants_json

if TYPE_CHECKING:
    from threading import Event

    from hexwire.control.loop.shutdown import Shutdown
    from hexwire.fleet.network import Network
    from hexwire.fleet.node import Node
    from hexwire.fleet.overview import Overview, Stopped
    from hexwire.fleet.player import Played, PlayReport
    from hexwire.link.certs import CertFacts

__all__ = ["config", "fleet", "list_arms", "nobody", "play", "record", "router", "stop", "watch"]


@click.group()
def fleet() -> None:
    """Many shared arms: see, stop, record and play them at once; the router, and rights by certificate.

    The arms are those that 'hexwire serve' of this user shares on this machine, and those behind the router that
    --router or the file in HEXWIRE_FLEET names.
    """


_ARMS: RowType[Overview] = RowType(
    Column("name", "arm"),
    Column("robot", "robot", lambda row: row.robot or None),
    Column("host", "host", lambda row: row.host or None),
    Column("holder", "holder", lambda row: row.holder or None),
    Column("torque", "torque", lambda row: row.torque or None),
    Column("stopped"),
    Column("condition"),
    Column("age_s", "age ms", "age", scale=1000),
    Column("answers", get=lambda row: not row.silent),
    Column("local"),
    Column("", "condition", "condition"),
)
_STOPPED: RowType[Stopped] = RowType(
    *map(Column, ("name", "confirmed", "joints", "error", "seconds", "kept")),
    Column("**", get=lambda row: asdict(row.torques)),
)
_ANSWERS = 1.0
"""Time-out for the condition of an arm, seconds."""
_SOON = 0.4
"""The same for `watch`: with two updates a second, an arm that is cut off shows within a second."""
_SETTLE = 4.0
"""Seconds until all routes have been tried; a server that hangs takes 3 s."""
_NONE = "no arm is served on this machine by this user"
_DO = (
    "start one with 'hexwire serve', or name the router of the fleet (--router tls/HOST:7447, or a file in "
    "HEXWIRE_FLEET)"
)


_stop_options = functools.partial(router_options, stops=True)


@fleet.command("list", short_help="List the arms that this program may see.")
@click.argument("pattern", default="**")
@router_options
@json_option
def list_arms(pattern: str, router: Network | None) -> None:
    """List the arms that this program may see; PATTERN such as 'lab/*' selects some.

    An arm that does not answer is listed with the reason, and the exit status is 1.
    """
    from hexwire.fleet.overview import look
    from hexwire.fleet.roster import Roster

    with Roster(pattern, router) as roster:
        roster.settle(_SETTLE)
        rows = look(roster, _ANSWERS)
    if rows or wants_json():
        _ARMS.show(rows)
    else:
        say(f"{nobody(pattern, router)}: {_DO}" if router is None else nobody(pattern, router))
    if silent := [row.name for row in rows if row.silent]:
        raise LinkLostError(f"no answer from {', '.join(silent)}")


@fleet.command(short_help="Follow the arms until interrupted.")
@click.argument("pattern", default="**")
@number_option("--rate", "HZ", "Updates per second.", above=0, default=2.0)
@router_options
@json_option
def watch(pattern: str, rate: float, router: Network | None) -> None:
    """Follow the arms until interrupted: a live table on a terminal, otherwise a line for each change.

    An arm that appears or vanishes is shown at once, without waiting for the next update, and so is one that
    does not answer within 0.4 s. --json prints one line per update, with all arms.
    """
    import threading

    from hexwire.fleet.overview import look
    from hexwire.fleet.roster import Roster

    changed = threading.Event()
    show = (
        _json_lines if wants_json() else _Table(pattern, router) if on_terminal() else _ChangeLines(pattern, router)
    )
    with Roster(pattern, router, on_change=lambda name, there: changed.set()) as roster:
        roster.settle(_SETTLE)
        with show if isinstance(show, _Table) else nullcontext():
            _follow(functools.partial(look, roster), show, rate, changed)


def _follow(
    look: Callable[[float], Sequence[Overview]],
    show: Callable[[Sequence[Overview]], object],
    rate: float,
    changed: Event,
    now: Callable[[], float] = time.monotonic,
) -> NoReturn:
    """Show the arms so many times a second, and when `changed` is set; `look` gets the time-out of an answer."""
    while True:
        begun = now()
        changed.clear()
        show(look(_SOON))
        # An arm that does not answer does not slow the updates down.
        changed.wait(max(0.0, begun + 1.0 / rate - now()))


@fleet.command(short_help="Stop many arms at once.")
@click.argument("pattern", required=False)
@click.option("--all", "every", is_flag=True, help="Stop every arm that this program may stop.")
@click.option("--torque-off", is_flag=True, help="Switch torque off as well: the arms may fall.")
@_stop_options
@json_option
def stop(pattern: str | None, every: bool, torque_off: bool, router: Network | None) -> None:
    """Stop all arms that PATTERN names, such as lab/arm1 or 'lab/*', at the same time. It needs no lease.

    Prints a line for each arm. The exit status is 1 unless every arm has confirmed that it is stopped; one that
    hangs delays no other. Nothing moves until 'hexwire --port zenoh:NAME resume'.
    """
    from hexwire.drivers.values import StopMode
    from hexwire.fleet.overview import stop_all
    from hexwire.fleet.remote import whoami
    from hexwire.fleet.roster import Roster

    if (pattern is None) != every:
        raise UsageError(
            "nothing was stopped: write 'hexwire fleet stop --all' for every arm, or name some, as in "
            "'hexwire fleet stop \"lab/*\"'"
        )
    with Roster(pattern or "**", router) as roster:
        mode = StopMode.TORQUE_OFF if torque_off else StopMode.HOLD
        rows = _STOPPED.tell(stop_all(roster, whoami(), mode))
    failed = [row.name for row in rows if not row.confirmed]
    kept = [row.name for row in rows if row.confirmed and row.with_torque]
    if not rows:
        raise LinkNotFoundError(f"nothing was stopped: {nobody(pattern or '**', router)}; see 'hexwire fleet list'")
    if failed:
        raise LinkLostError(f"not confirmed by {', '.join(failed)}: switch the power off if they may move")
    if kept:
        raise LinkPermissionError(f"stopped, but torque is still on: {', '.join(kept)}")


def nobody(pattern: str, router: Network | None, silent: Mapping[str, str] | None = None) -> str:
    """Error text that no arm was found.

    Args:
        pattern: The arms.
        router: Router to those of other machines.
        silent: Routes without an answer and the reason; see `Roster.silent`.
    """
    where = _NONE if router is None else f"{_NONE} or behind {', '.join(router.connect)}"
    named = where if pattern == "**" else f"{where} under the name {pattern}"
    return "; ".join(
        [named, *(f"{route}: {why.removeprefix(f'{route}: ')}" for route, why in (silent or {}).items())]
    )


def _json_lines(rows: Sequence[Overview]) -> None:
    print_json({"time": time.time(), "arms": [_ARMS.as_json(row) for row in rows]}, one_line=True)


class _ChangeLines:
    """Prints a line for each change."""

    def __init__(self, pattern: str, router: Network | None) -> None:
        self._none = nobody(pattern, router)
        self._before: dict[str, str] | None = None

    def __call__(self, rows: Sequence[Overview]) -> None:
        now = {row.name: self._words(row) for row in rows}
        clock = time.strftime("%H:%M:%S")
        before = self._before
        if before is None and not now:
            say(f"{clock}  {self._none}; waiting", flush=True)
        for name, words in now.items():
            if before is None or before.get(name) != words:
                say(f"{clock}  {name}: {words}", flush=True)
        for name in sorted(set(before or ()) - set(now)):
            say(f"{clock}  {name}: gone", flush=True)
        self._before = now

    @staticmethod
    def _words(row: Overview) -> str:
        if row.silent:
            return row.condition
        holder = f", {row.holder} holds the lease" if row.holder else ""
        return f"{row.robot} at {row.host}, torque {row.torque or 'unknown'}{holder}, {row.condition}"


class _Table:
    """Draws a table in place."""

    def __init__(self, pattern: str, router: Network | None) -> None:
        from .draw import live

        self._none, self._live = nobody(pattern, router), live()
        self._gone: dict[str, float] = {}
        self._there: set[str] = set()

    def __enter__(self) -> None:
        self._live.__enter__()

    def __exit__(self, *ended: Any) -> None:
        self._live.__exit__(*ended)

    def __call__(self, rows: Sequence[Overview]) -> None:
        from rich.console import Group
        from rich.text import Text

        from .draw import JointTable

        now, there = time.time(), {row.name for row in rows}
        self._gone |= dict.fromkeys(self._there - there, now)
        self._gone = {name: when for name, when in self._gone.items() if name not in there}
        self._there = there
        parts: list[Any] = []
        if rows:
            parts.append(
                JointTable(_ARMS.titles, [_ARMS.cells(r) for r in rows], [r.condition != "ok" for r in rows])
            )
        else:
            parts.append(Text(self._none))
        if self._gone:
            words = ", ".join(
                f"{name} ({time.strftime('%H:%M:%S', time.localtime(when))})" for name, when in self._gone.items()
            )
            parts.append(Text(f"gone: {words}", style="bold red"))
        counted = f"{len(rows)} arm{'' if len(rows) == 1 else 's'}"
        parts.append(Text(f"{counted}, {time.strftime('%H:%M:%S')}; Ctrl-C ends", style="dim"))
        self._live.update(Group(*parts), refresh=True)


_SLICE = 0.5
"""Seconds between two looks at signals."""
_KEEPERS = {"board": "board", "host": "server"}


@fleet.command(short_help="Record all arms in one file.")
@click.argument("file", metavar="OUT.mcap")
@click.argument("pattern", default="**")
@number_option("--duration", "SECONDS", "End after this time; otherwise Ctrl-C ends it.", above=0)
@force_option
@router_options
@json_option
def record(file: str, pattern: str, duration: float | None, force: bool, router: Network | None) -> None:
    """Record the states of all arms in one file, each on a topic of its own, with their clocks related.

    Arms that appear or vanish meanwhile are noted, here and in the file. 'hexwire record info' shows what it has,
    'hexwire fleet play' plays it.
    """
    from hexwire.fleet.recorder import FleetRecorder
    from hexwire.trace.recording import RecordingWriter, check_recording_name

    check_recording_name(file)
    end = math.inf if duration is None else duration
    with RecordingWriter(file, force=force) as writer, ends_when_asked() as ended:
        with FleetRecorder(writer, pattern, router, tell=note) as recorder:
            began = time.monotonic()
            if not recorder.counts:
                note(f"{nobody(pattern, router, recorder.silent)}; waiting for one")
            while not ended() and (left := began + end - time.monotonic()) > 0:
                recorder.run(min(left, _SLICE))
            counts = recorder.counts
            silent = recorder.silent
            if recorder.overflows:
                note(f"warning: the disk was too slow; {recorder.overflows} states are missing")
        if not counts:
            writer.discard()
            raise LinkNotFoundError(f"nothing was recorded: {nobody(pattern, router, silent)}")
    rows = [{"name": name, "states": states, "lost": lost} for name, (states, lost) in counts.items()]
    lines = [f"{row['name']}: {row['states']} states, {row['lost']} lost" for row in rows]
    answer({"file": file, "arms": rows}, *lines, f"recorded in {file}")


@fleet.command(short_help="Play a motion on several arms, with a common start.")
@click.argument("file", metavar="FILE")
@click.option("--on", "on", multiple=True, metavar="PATTERN", help="The arms that move, as in 'lab/*'; repeatable.")
@click.option(
    "--map", "pairs", multiple=True, metavar="RECORDED=ARM", help="Play the recording of one arm on another."
)
@number_option("--speed", "FACTOR", "2 plays twice as fast.", above=0, default=1.0)
@click.option("--take", is_flag=True, help="Take the leases from other holders, if this program's role may.")
@click.option("--dry-run", is_flag=True, help="Have each arm check its motion, and move nothing.")
@number_option("--max-doubt", "MS", "Refuse an arm whose clock is known less well.", above=0, default=10.0)
@router_options
@json_option
def play(
    file: str,
    on: tuple[str, ...],
    pairs: tuple[str, ...],
    speed: float,
    take: bool,
    dry_run: bool,
    max_doubt: float,
    router: Network | None,
) -> None:
    """Play a recording (.mcap) or waypoints (.json) on several arms, with a common start time.

    A recording of a fleet is played arm by arm; any other file plays on every arm. All arms move slowly to their
    first point, and then begin together. Each follows its motion by itself, so that the network cannot disturb it;
    boards that execute trajectories begin to a millisecond, the servers of others up to a period of targets late.
    If one refuses, none begins. Ctrl-C or the failure of one arm stops all of them: 'hexwire resume' ends the stop.
    """
    from hexwire.fleet.address import address_text
    from hexwire.fleet.player import PlayedArm, assign, attached_to, play_together, read_motions

    mapped = _pairs(pairs)
    if not on and not mapped:
        raise UsageError("name the arms to move: --on 'lab/*', or --map RECORDED=ARM")
    motions = read_motions(file, speed)
    arms = sorted({*_arms(on, router), *mapped})
    given = assign(motions, file, arms, mapped)
    if unused := sorted({*motions} - {mapped.get(arm, arm) for arm in arms} - {""}):
        note(f"not played: {', '.join(unused)}")
    with attached_to({name: address_text(name, router) for name in arms}) as robots:
        try:
            report = play_together(
                [PlayedArm(robots[name], given[name]) for name in arms],
                take=take,
                dry_run=dry_run,
                most_doubt=max_doubt / 1000,
                tell=note if wants_json() else functools.partial(say, flush=True),
                shield=shielded,
            )
        except KeyboardInterrupt:
            note("stop sent to all arms; 'hexwire --port zenoh:NAME resume' ends a stop")
            raise
    _tell(report, arms, dry_run)


def _pairs(words: tuple[str, ...]) -> dict[str, str]:
    """Arm -> name in the file."""
    from hexwire.fleet.names import check_name

    pairs: dict[str, str] = {}
    for word in words:
        recorded, equals, arm = word.partition("=")
        if not equals:
            raise UsageError(f"--map {word}: write RECORDED=ARM, as in lab/arm1=lab/arm2")
        if check_name(arm) in pairs:
            raise UsageError(f"--map names {arm} twice")
        pairs[arm] = check_name(recorded)
    return pairs


def _arms(patterns: tuple[str, ...], router: Network | None) -> set[str]:
    """Names of the arms that are there.

    Raises:
        LinkNotFoundError: A pattern matches none.
    """
    from hexwire.fleet.names import check_pattern, is_name, matches
    from hexwire.fleet.roster import Roster

    for pattern in patterns:
        check_pattern(pattern)
    if not patterns:
        return set()
    with Roster("**", router) as roster:
        roster.settle(_SETTLE)
        # One that hangs is refused later, by name.
        silent = roster.silent()
        names = {name for name in (*roster.seen(), *silent) if is_name(name)}
    found: set[str] = set()
    for pattern in patterns:
        some = {name for name in names if matches(pattern, name)}
        if not some:
            words = nobody(pattern, router, {route: why for route, why in silent.items() if route not in names})
            raise LinkNotFoundError(f"no arm moved: {words}; see 'hexwire fleet list'")
        found |= some
    return found


def _played_words(arm: tuple[str, Played]) -> str:
    name, row = arm
    moved = "did not move" if math.isnan(row.moved) else f"moved {1000 * row.moved:.1f} ms after the start"
    stalls = f", {row.slips} stalls" if row.slips else ""
    off = f"; arrived, {row.off}" if row.off else ""
    to = f"start known to {1000 * (row.doubt + row.late):.2f} ms, time kept by its {_KEEPERS[row.kept_by]}"
    return f"{name}: {moved}, {to}{stalls}{off}"


_PLAYED: RowType[tuple[str, Played]] = RowType(
    Column("name", get=lambda arm: arm[0]),
    Column("moved_s", get=lambda arm: arm[1].moved),
    Column("clock_uncertainty_s", get=lambda arm: arm[1].doubt),
    Column("time_kept_by", get=lambda arm: arm[1].kept_by),
    Column("start_uncertainty_s", get=lambda arm: arm[1].doubt + arm[1].late),
    Column("stalls", get=lambda arm: arm[1].slips),
    Column("off", get=lambda arm: arm[1].off),
    words=_played_words,
)


def _tell(report: PlayReport, arms: list[str], dry_run: bool) -> None:
    if wants_json():
        figures = {"duration_s": report.duration, "dry_run": dry_run, "skew_s": report.skew}
        rows = [_PLAYED.as_json(arm) for arm in report.arms.items()]
        print_json({**figures, "starts_within_s": report.apart, "arms": rows})
        return
    if dry_run:
        say(f"{', '.join(arms)}: the motion of {report.duration:.2f} s is allowed; nothing moved")
        return
    _PLAYED.tell(report.arms.items())
    words = f"played {report.duration:.2f} s on {len(arms)} arm{'' if len(arms) == 1 else 's'}"
    if math.isfinite(report.skew):
        words += f"; first movements within {1000 * report.skew:.1f} ms (clocks: {1000 * report.doubt:.2f} ms)"
    if len(arms) > 1:
        words += f"; starts within {1000 * report.apart:.1f} ms"
    say(words)


_FILE = "ZENOH_ROUTER_CONFIG_URI"
"""The environment variable of `rmw_zenoh` for a router's settings."""
_PATIENCE = 5.0
"""Seconds from the signal in which the router must have ended."""
_LOOK = 0.2
"""Seconds between two looks for the end."""


@fleet.command(short_help="Relay messages between arms and their clients.")
@click.option(
    "--listen",
    multiple=True,
    default=("tcp/127.0.0.1:7447",),
    show_default=True,
    metavar="ENDPOINT",
    help="Where arms and clients connect, as in tls/0.0.0.0:7447; repeatable.",
)
@click.option("--router", "connect", multiple=True, metavar="ENDPOINT", help="Another router to connect to.")
@certificate_options("this router")
@click.option("--access", metavar="FILE", help="Rights by certificate, as 'hexwire fleet config' writes them.")
@click.option(
    "--zenoh-config",
    metavar="FILE",
    help="Zenoh's own settings in JSON5 instead of all other options; without any option, those of the file that "
    "ZENOH_ROUTER_CONFIG_URI names, as for a router of ROS 2. They may let anybody in.",
)
@click.pass_context
def router(
    context: click.Context,
    listen: tuple[str, ...],
    connect: tuple[str, ...],
    ca: str,
    cert: str,
    key: str,
    access: str | None,
    reachable_without_certificates: bool,
    zenoh_config: str | None,
) -> None:
    """Relay messages between arms and their clients until Ctrl-C.

    Arms connect with 'hexwire serve --router', clients with 'zenoh:NAME?router='. Nodes of ROS 2 on this machine
    (hexwire-ros2, or any with rmw_zenoh) find its default endpoint without an option. It moves nothing by itself;
    while it is gone, arms go on, and those that a client of it commanded hold.
    """
    from hexwire.control.loop.shutdown import Shutdown
    from hexwire.fleet.network import Network, open_router_file, read_access

    shutdown = Shutdown(_PATIENCE)
    shutdown.listen()
    default = click.core.ParameterSource.DEFAULT
    given = [name for name in context.params if context.get_parameter_source(name) is not default]
    if not given and (named := os.environ.get(_FILE, "").removeprefix("file://")):
        note(f"settings from {named}, which {_FILE} names")
        zenoh_config = named
    if zenoh_config:
        if given not in ([], ["zenoh_config"]):
            raise UsageError("--zenoh-config has all settings of the router; leave out the other options")
        _relay(*open_router_file(zenoh_config), shutdown)
        return
    network = Network(
        listen=listen,
        connect=connect,
        ca=ca,
        cert=cert,
        key=key,
        router=True,
        reachable_without_certificates=reachable_without_certificates,
        access=read_access(access) if access else None,
    )
    if cert:
        _check_certificate(cert)
    _relay(network.open(wait=False), listen, shutdown)


def _relay(node: Node, listen: tuple[str, ...], shutdown: Shutdown) -> None:
    try:
        say(f"passing on at {', '.join(listen)}", flush=True)
        while not shutdown.wait(_LOOK):
            pass
    finally:
        shutdown.request()
        node.close()
    note("the router has ended")


def _check_certificate(cert: str) -> None:
    from hexwire.fleet.address import rights_of
    from hexwire.fleet.rights import Kind

    rights = rights_of(cert)
    if rights is None or rights.kind is not Kind.ROUTER:
        what = f"is for the role {rights}" if rights is not None else "names no role"
        raise UsageError(f"{cert} {what}; a router needs one from 'hexwire cert issue --role router'")


@fleet.command(short_help="Write the rights of a lab from its certificates.")
@click.argument("folder", metavar="DIR")
@click.argument("certificates", nargs=-1, metavar="[CERT]...")
@click.option("--output", "-o", metavar="FILE", help="The file to write.  [default: DIR/access.json]")
@force_option
def config(folder: str, certificates: tuple[str, ...], output: str | None, force: bool) -> None:
    """Write the rights of a lab from its certificates: those in DIR, or those named.

    DIR has the authority's certificate, ca.pem. A router or server that is started with --access FILE enforces the
    rights: a certificate that is not in the file gives none. To revoke a certificate, remove it, run this again
    with --force, and restart the router.
    """
    from hexwire.fleet.address import rights_of
    from hexwire.fleet.rights import access_control
    from hexwire.link.certs import AUTHORITY
    from hexwire.new_file import OutputFile

    ca = Path(folder) / f"{AUTHORITY}.pem"
    paths = [Path(name) for name in certificates] or sorted(Path(folder).glob("*.pem"))
    rows, lines = [], []
    for facts in _read_certificates(paths, ca, named=bool(certificates)):
        rights = rights_of(str(facts.path))
        if rights is None:
            lines.append(f"{facts.path}: no role, no rights")
            continue
        rows.append((facts.common_name, rights))
        lines.append(f"{facts.path}: {rights}, until {facts.expires:%Y-%m-%d}")
    if not rows:
        raise UsageError(f"{folder} has no certificate with a role; 'hexwire cert issue {folder} NAME' creates one")
    text = json.dumps(access_control(rows), indent=1) + "\n"
    target = Path(output) if output else Path(folder) / "access.json"
    with OutputFile(target, force=force) as file:
        file.file.write(text.encode())
    say(*lines, f"{target}: rights of {len(rows)} certificates")


def _read_certificates(paths: list[Path], ca: Path, *, named: bool) -> list[CertFacts]:
    """The certificates that count.

    Raises:
        UsageError: One that was named is of another authority.
    """
    from datetime import UTC, datetime

    from hexwire.link.certs import read_certificate

    found = []
    for path in paths:
        facts = read_certificate(path, ca)
        if facts.authority:
            continue
        if not facts.signed:
            if named:
                raise UsageError(f"{path} was not signed by the authority {ca}")
            note(f"{path} was not signed by the authority {ca}; left out")
        elif facts.expires < datetime.now(UTC):
            note(f"{path} expired on {facts.expires:%Y-%m-%d}; left out")
        else:
            found.append(facts)
    return found
