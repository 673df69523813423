"""`fleet list`, `watch` and `stop`: many shared arms at once.

Owns arguments, tables and lines. Must not know how arms are found, asked or stopped.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

from hexwire.errors import LinkLostError, LinkNotFoundError, LinkPermissionError, UsageError

from .common import json_option, on_terminal
from .fleet_options import router_options
from .numbers import number_option
from .output import print_json, say, say_table

if TYPE_CHECKING:
    from hexwire.fleet.network import Network
    from hexwire.fleet.overview import Overview

__all__ = ["list_arms", "nobody", "stop", "watch"]

_HEAD = ("arm", "robot", "host", "holder", "torque", "age ms", "condition")
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


@click.command("list")
@click.argument("pattern", default="**")
@router_options
@json_option
def list_arms(pattern: str, router: Network | None, as_json: bool) -> None:
    """List the arms that this program may see; PATTERN such as 'lab/*' selects some.

    An arm that does not answer is listed with the reason, and the exit status is 1.
    """
    from hexwire.fleet.overview import look
    from hexwire.fleet.roster import Roster

    with Roster(pattern, router) as roster:
        roster.settle(_SETTLE)
        rows = look(roster, _ANSWERS)
    if as_json:
        print_json([_as_json(row) for row in rows])
    elif rows:
        say_table(_HEAD, [_cells(row) for row in rows])
    else:
        say(f"{nobody(pattern, router)}: {_DO}" if router is None else nobody(pattern, router))
    if silent := [row.name for row in rows if row.silent]:
        raise LinkLostError(f"no answer from {', '.join(silent)}")


@click.command()
@click.argument("pattern", default="**")
@number_option("--rate", "HZ", "Updates per second.", above=0, default=2.0)
@router_options
@json_option
def watch(pattern: str, rate: float, router: Network | None, as_json: bool) -> None:
    """Follow the arms until interrupted: a live table on a terminal, otherwise a line for each change.

    An arm that appears or vanishes is shown at once, without waiting for the next update, and so is one that
    does not answer within 0.4 s. --json prints one line per update, with all arms.
    """
    import threading

    from hexwire.fleet.overview import look
    from hexwire.fleet.roster import Roster

    changed = threading.Event()
    show = _json_lines if as_json else _Table(pattern, router) if on_terminal() else _Lines(pattern, router)
    with Roster(pattern, router, on_change=lambda name, there: changed.set()) as roster:
        roster.settle(_SETTLE)
        with show if isinstance(show, _Table) else nullcontext():
            while True:
                begun = time.monotonic()
                changed.clear()
                show(look(roster, _SOON))
                # An arm that does not answer does not slow the updates down.
                changed.wait(max(0.0, begun + 1.0 / rate - time.monotonic()))


@click.command()
@click.argument("pattern", required=False)
@click.option("--all", "every", is_flag=True, help="Stop every arm that this program may stop.")
@click.option("--torque-off", is_flag=True, help="Switch torque off as well: the arms may fall.")
@_stop_options
@json_option
def stop(pattern: str | None, every: bool, torque_off: bool, router: Network | None, as_json: bool) -> None:
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
    failed, kept, rows = [], [], []
    with Roster(pattern or "**", router) as roster:
        for row in stop_all(roster, whoami(), StopMode.TORQUE_OFF if torque_off else StopMode.HOLD):
            rows.append(row)
            if not row.confirmed:
                failed.append(row.name)
            elif row.with_torque:
                kept.append(row.name)
            if not as_json:
                say(str(row), flush=True)
    if as_json:
        keys = ("name", "confirmed", "joints", "error", "seconds", "kept")
        print_json([{key: getattr(row, key) for key in keys} | asdict(row.torques) for row in rows])
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


# -- rows -------------------------------------------------------------------------------------------------


def _condition(row: Overview) -> str:
    if row.silent:
        return f"no answer: {row.why}"
    if row.stopped:
        return f"stopped: {row.why}" if row.why else "stopped"
    return row.why or "ok"


def _cells(row: Overview) -> tuple[str, ...]:
    age = "-" if row.age is None else f"{1000 * row.age:.0f}"
    cells = (row.robot, row.host, row.holder, row.torque)
    return (row.name, *(cell or "-" for cell in cells), age, _condition(row))


def _as_json(row: Overview) -> dict[str, object]:
    return {
        "name": row.name,
        "robot": row.robot or None,
        "host": row.host or None,
        "holder": row.holder or None,
        "torque": row.torque or None,
        "stopped": row.stopped,
        "condition": _condition(row),
        "age_s": row.age,
        "answers": not row.silent,
        "local": row.local,
    }


def _json_lines(rows: Sequence[Overview]) -> None:
    print_json({"time": time.time(), "arms": [_as_json(row) for row in rows]}, one_line=True)


class _Lines:
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
            return _condition(row)
        holder = f", {row.holder} holds the lease" if row.holder else ""
        return f"{row.robot} at {row.host}, torque {row.torque or 'unknown'}{holder}, {_condition(row)}"


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
            parts.append(JointTable(_HEAD, [_cells(r) for r in rows], [_condition(r) != "ok" for r in rows]))
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
