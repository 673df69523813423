"""`fleet record` and `fleet play`: the motions of many arms in one file.

Owns arguments and lines. Must not know how arms are recorded or moved together.
"""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hexwire.errors import LinkNotFoundError, UsageError

from .common import force_option, json_option
from .exits import ends_when_asked, note, shielded
from .fleet_ops import nobody
from .fleet_options import router_options
from .numbers import FiniteFloat, number_option
from .output import answer, print_json, say

if TYPE_CHECKING:
    from hexwire.fleet.network import Network
    from hexwire.fleet.player import Report

__all__ = ["play", "record"]

_SLICE = 0.5
"""Seconds between two looks at signals."""
_SETTLE = 4.0
_KEEPERS = {"board": "board", "host": "server"}


@click.command()
@click.argument("file", metavar="OUT.mcap")
@click.argument("pattern", default="**")
@number_option("--duration", "SECONDS", "End after this time; otherwise Ctrl-C ends it.", above=0)
@force_option
@router_options
@json_option
def record(
    file: str, pattern: str, duration: float | None, force: bool, router: Network | None, as_json: bool
) -> None:
    """Record the states of all arms in one file, each on a topic of its own, with their clocks related.

    Arms that appear or vanish meanwhile are noted, here and in the file. 'hexwire record info' shows what it has,
    'hexwire fleet play' plays it.
    """
    from hexwire.fleet.recorder import FleetRecorder
    from hexwire.trace.recording import RecordingWriter

    if Path(file).suffix.lower() != ".mcap":
        raise UsageError(f"{file}: the name of a recording must end in .mcap")
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
    answer(as_json, {"file": file, "arms": rows}, *lines, f"recorded in {file}")


@click.command()
@click.argument("file", metavar="FILE")
@click.option("--on", "on", multiple=True, metavar="PATTERN", help="The arms that move, as in 'lab/*'; repeatable.")
@click.option(
    "--map", "pairs", multiple=True, metavar="RECORDED=ARM", help="Play the recording of one arm on another."
)
@number_option("--speed", "FACTOR", "2 plays twice as fast.", above=0, default=1.0)
@click.option("--take", is_flag=True, help="Take the leases from other holders, if this program's role may.")
@click.option("--dry-run", is_flag=True, help="Have each arm check its motion, and move nothing.")
@click.option(
    "--max-doubt",
    type=FiniteFloat("ms", above=0),
    default=10.0,
    show_default=True,
    metavar="MS",
    help="Refuse an arm whose clock is known less well.",
)
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
    as_json: bool,
) -> None:
    """Play a recording (.mcap) or waypoints (.json) on several arms, with a common start time.

    A recording of a fleet is played arm by arm; any other file plays on every arm. All arms move slowly to their
    first point, and then begin together. Each follows its motion by itself, so that the network cannot disturb it;
    boards that keep the time begin to a millisecond, the servers of others up to a period of targets late.
    If one refuses, none begins. Ctrl-C or the failure of one arm stops all of them: 'hexwire resume' ends the stop.
    """
    from hexwire.fleet.address import address_text
    from hexwire.fleet.player import Arm, attached_to, play_together
    from hexwire.fleet.score import assign, read_motions

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
                [Arm(robots[name], given[name]) for name in arms],
                take=take,
                dry_run=dry_run,
                most_doubt=max_doubt / 1000,
                tell=note if as_json else say,
                shield=shielded,
            )
        except KeyboardInterrupt:
            note("stop sent to all arms; 'hexwire --port zenoh:NAME resume' ends a stop")
            raise
    _tell(report, arms, dry_run, as_json)


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


def _tell(report: Report, arms: list[str], dry_run: bool, as_json: bool) -> None:
    if as_json:
        rows: list[dict[str, Any]] = [
            {
                "name": name,
                "moved_s": row.moved,
                "clock_uncertainty_s": row.doubt,
                "time_kept_by": row.kept_by,
                "start_uncertainty_s": row.doubt + row.late,
                "stalls": row.slips,
                "off": row.off,
            }
            for name, row in report.arms.items()
        ]
        figures = {"duration_s": report.duration, "dry_run": dry_run, "skew_s": report.skew}
        print_json({**figures, "starts_within_s": report.apart, "arms": rows})
        return
    if dry_run:
        say(f"{', '.join(arms)}: the motion of {report.duration:.2f} s is allowed; nothing moved")
        return
    for name, row in report.arms.items():
        moved = "did not move" if math.isnan(row.moved) else f"moved {1000 * row.moved:.1f} ms after the start"
        stalls = f", {row.slips} stalls" if row.slips else ""
        off = f"; arrived, {row.off}" if row.off else ""
        to = f"start known to {1000 * (row.doubt + row.late):.2f} ms, time kept by its {_KEEPERS[row.kept_by]}"
        say(f"{name}: {moved}, {to}{stalls}{off}")
    words = f"played {report.duration:.2f} s on {len(arms)} arm{'' if len(arms) == 1 else 's'}"
    if math.isfinite(report.skew):
        words += f"; first movements within {1000 * report.skew:.1f} ms (clocks: {1000 * report.doubt:.2f} ms)"
    if len(arms) > 1:
        words += f"; starts within {1000 * report.apart:.1f} ms"
    say(words)
