"""`hexwire fleet list`, `watch` and `stop`."""

from __future__ import annotations

import json
import os
import signal
import socket
import threading
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from hypothesis import given
from hypothesis import strategies as st
from tests.fleet.conftest import Serve, runtime, serve  # noqa: F401  # fixtures
from tests.system.programs import hexwire_program
from tests.waits import eventually

from hexwire.cli import fleet as fleet_ops
from hexwire.cli.main import cli
from hexwire.drivers import registry
from hexwire.fleet import overview
from hexwire.fleet.endpoints import local_socket
from hexwire.fleet.names import ClientRole
from hexwire.fleet.network import SILENT
from hexwire.fleet.overview import Overview

# ruff: noqa: F811  # fixtures that are imported


def run(*words: str) -> Result:
    return CliRunner().invoke(cli, ["fleet", *words])


def test_an_empty_list_says_what_to_do(runtime: Path) -> None:
    result = run("list")
    assert result.exit_code == 0
    assert result.stdout.startswith("no arm is served on this machine by this user: start one with 'hexwire serve'")
    assert json.loads(run("list", "--json").stdout) == []
    assert "under the name lab/*" in run("list", "lab/*").stdout


def test_arms_are_listed_with_their_condition(serve: Serve) -> None:
    for name in ("lab/arm1", "lab/arm2", "hall"):
        serve(name, robot="sim")
    result = run("list", "lab/*")
    assert result.exit_code == 0, result.stderr
    head, *rows = result.stdout.splitlines()
    assert head.split()[:5] == ["arm", "robot", "host", "holder", "torque"]
    assert [row.split()[:2] for row in rows] == [["lab/arm1", "hex7bot"], ["lab/arm2", "hex7bot"]]
    assert all(row.endswith("ok") for row in rows)
    with registry.connect("zenoh:hall") as robot:
        robot.torque(True)
        eventually(lambda: robot.holder)
        (row,) = json.loads(run("list", "hall", "--json").stdout)
        assert (row["torque"], row["stopped"], row["answers"], row["local"]) == ("on", False, True, True)
        assert str(os.getpid()) in row["holder"]
        robot.stop()
        eventually(lambda: json.loads(run("list", "hall", "--json").stdout)[0]["condition"].startswith("stopped: "))


def test_a_stop_stops_what_it_names_and_nothing_else(serve: Serve) -> None:
    for name in ("lab/arm1", "lab/arm2", "hall"):
        serve(name, robot="sim")
    with registry.connect("zenoh:lab/arm1") as robot:
        robot.torque(True, ["J2"])
    result = run("stop", "lab/*")
    assert result.exit_code == 0, result.stderr
    assert sorted(line.partition(" (")[0] for line in result.stdout.splitlines()) == [
        "lab/arm1: stopped, holding: J2; limp: J1 J3 J4 J5 J6 J7",
        "lab/arm2: stopped, limp: J1 J2 J3 J4 J5 J6 J7",
    ]
    stopped = {row["name"]: row["stopped"] for row in json.loads(run("list", "--json").stdout)}
    assert stopped == {"lab/arm1": True, "lab/arm2": True, "hall": False}
    rows = json.loads(run("stop", "--all", "--torque-off", "--json").stdout)
    assert [row["confirmed"] for row in rows] == [True] * 3
    assert all((row["holding"], row["unknown"], len(row["limp"])) == ([], [], 7) for row in rows)


def test_a_stop_that_holds_instead_of_switching_torque_off_says_so(
    serve: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    serve("lab/arm1", robot="sim")
    with registry.connect("zenoh:lab/arm1") as robot:
        robot.torque(True)
    monkeypatch.setattr(overview, "role_of", lambda cert: ClientRole.OBSERVER)
    result = run("stop", "lab/*", "--torque-off")
    assert result.exit_code == 1
    assert result.stdout.startswith("lab/arm1: stopped, holding: J1 ")
    assert "; with torque: an observer may stop it, but not switch its torque off" in result.stdout
    assert "stopped, but torque is still on: lab/arm1" in result.stderr


def test_a_stop_that_stops_nothing_says_so(runtime: Path) -> None:
    for words in ((), ("lab/*", "--all")):
        result = run("stop", *words)
        assert (result.exit_code, result.stdout) == (2, "")
        assert "nothing was stopped: write 'hexwire fleet stop --all'" in result.stderr
    result = run("stop", "lab/*")
    assert result.exit_code == 1
    assert "nothing was stopped: no arm is served" in result.stderr


@pytest.mark.slow
def test_an_arm_that_hangs_is_not_confirmed_and_the_status_says_so(serve: Serve) -> None:
    serve("lab/arm1", robot="sim")
    with socket.socket(socket.AF_UNIX) as hung:
        hung.bind(str(local_socket("lab/hung")))
        hung.listen()
        result = run("stop", "--all")
        assert result.exit_code == 1
        first, second = result.stdout.splitlines()
        assert first.startswith("lab/arm1: stopped")
        assert second.startswith("lab/hung: NOT CONFIRMED: its program does not answer")
        assert "not confirmed by lab/hung: switch the power off" in result.stderr
        result = run("list")
        assert (result.exit_code, "no answer from lab/hung" in result.stderr) == (1, True)
        assert "no answer: its program does not answer" in result.stdout


def test_watch_tells_changes_in_lines_and_ends_like_ctrl_c(serve: Serve) -> None:
    service = serve("lab/arm1", robot="sim")
    lines: list[str] = []
    with hexwire_program("fleet", "watch") as program:
        assert program.stdout is not None
        reader = threading.Thread(target=lambda: lines.extend(iter(program.stdout.readline, "")))  # type: ignore[union-attr]
        reader.start()
        eventually(lambda: any("lab/arm1: hex7bot at" in line for line in lines))
        service.close()
        eventually(lambda: any(line.endswith("lab/arm1: gone\n") for line in lines))
        program.send_signal(signal.SIGINT)
        assert program.wait(30) == 130
        reader.join()


@pytest.mark.slow
def test_watch_prints_all_arms_a_line_as_json(serve: Serve) -> None:
    serve("lab/arm1", robot="sim")
    with hexwire_program("fleet", "watch", "lab/*", "--json", "--rate", "20") as program:
        assert program.stdout is not None
        rows = [json.loads(program.stdout.readline()) for _ in range(3)]
        program.send_signal(signal.SIGTERM)
        assert program.wait(30) == 130
    assert [arm["name"] for arm in rows[-1]["arms"]] == ["lab/arm1"]
    assert rows[0]["time"] < rows[2]["time"]


class CutOff:
    """An arm that is cut off, in simulated time: it answers, then does not, then is gone from the roster.

    Args:
        cut: When, seconds.
        gone: Seconds after which the roster misses it.
    """

    def __init__(self, cut: float, gone: float = SILENT) -> None:
        self.time, self.cut, self.missed = 0.0, cut, cut + gone
        self.changed = False
        self.said: list[tuple[float, str]] = []

    def now(self) -> float:
        return self.time

    def look(self, timeout: float) -> list[Overview]:
        if self.time >= self.missed:
            return []
        if self.time < self.cut:
            return [Overview("lab/arm1", "hex7bot", "pc")]
        self.pass_by(timeout)
        return [Overview("lab/arm1", why="is it halted?", silent=True)]

    def show(self, rows: Sequence[Overview]) -> None:
        self.said += [(self.time, "gone" if not rows else "no answer" if rows[0].silent else "ok")]
        if self.time > self.missed + 2.0:
            raise EOFError

    def pass_by(self, seconds: float) -> None:
        self.changed |= self.time < self.missed <= self.time + seconds
        self.time += seconds

    # As an event that the roster sets.

    def clear(self) -> None:
        self.changed = False

    def wait(self, seconds: float) -> None:
        if not self.changed:
            self.pass_by(min(seconds, self.missed - self.time) if self.time < self.missed else seconds)


@given(st.floats(1.0, 2.0), st.floats(2.0, 2 * SILENT))
def test_watch_shows_an_arm_that_is_cut_off_within_a_second_and_as_gone_at_once(cut: float, gone: float) -> None:
    arm = CutOff(cut, gone)
    with pytest.raises(EOFError):
        fleet_ops._follow(arm.look, arm.show, 2.0, arm, arm.now)  # type: ignore[arg-type]  # an event
    words = [word for _, word in arm.said]
    assert words == sorted(words, key=["ok", "no answer", "gone"].index), "in this order"
    times = {word: when for when, word in reversed(arm.said)}
    assert times["no answer"] - cut <= 1.0
    # As soon as the roster misses it; a look that is under way ends first.
    assert 0.0 <= times["gone"] - arm.missed <= 0.4
    assert [when for when, _ in arm.said[:2]] == [0.0, 0.5]


def shown(monkeypatch: pytest.MonkeyPatch, *steps: list[Overview]) -> list[str]:
    """What the table on a terminal shows after each step."""
    from hexwire.cli import draw

    pages: list[str] = []

    class Page:
        def update(self, what: Any, *, refresh: bool = False) -> None:
            console = draw.SafeConsole(width=120)
            with console.capture() as text:
                console.print(what)
            # Nothing else draws it.
            if refresh:
                pages.append(text.get())

    monkeypatch.setattr(draw, "live", Page)
    table = fleet_ops._Table("**", None)
    for step in steps:
        table(step)
    return pages


def test_without_a_terminal_there_is_a_line_for_each_change(capsys: pytest.CaptureFixture[str]) -> None:
    ok = Overview("lab/arm1", "hex7bot", "pc", "", "on", False, "", 0.004, False, True)
    held = replace(ok, holder="Ann")
    show = fleet_ops._ChangeLines("lab/*", None)
    for rows in ([], [], [ok], [ok], [held], []):
        show(rows)
    nobody, *lines = (line.partition("  ")[2] for line in capsys.readouterr().out.splitlines())
    assert nobody.startswith("no arm is served on this machine by this user")
    assert nobody.endswith(" under the name lab/*; waiting")
    assert lines == [
        "lab/arm1: hex7bot at pc, torque on, ok",
        "lab/arm1: hex7bot at pc, torque on, Ann holds the lease, ok",
        "lab/arm1: gone",
    ]


def test_the_table_on_a_terminal_names_those_that_are_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    ok = Overview("lab/arm1", "hex7bot", "pc", "", "on", False, "", 0.004, False, True)
    bad = Overview("lab/arm2", "hex7bot", "pc", "Ann", "off", True, "Ann stopped it", 1.5)
    none, two, one, back = shown(monkeypatch, [], [ok, bad], [bad], [ok, bad])
    assert "no arm is served" in none
    assert "stopped: Ann stopped it" in two
    assert "2 arms" in two
    assert "gone: lab/arm1 (" in one
    assert "1 arm," in one
    assert "gone" not in back


@pytest.mark.parametrize("words", [("list",), ("stop",), ("watch",), ("record", "a.mcap")])
def test_a_wrong_pattern_and_a_wrong_router_are_usage_errors(
    runtime: Path,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    words: tuple[str, ...],
) -> None:
    monkeypatch.chdir(tmp_path)
    result = CliRunner().invoke(cli, ["fleet", *words, "lab/arm*"])
    assert (result.exit_code, "matches no arm" in result.stderr) == (2, True), result.stderr
    result = CliRunner().invoke(cli, ["fleet", *words, "lab/*", "--router", "lab-pc"])
    assert (result.exit_code, "not an endpoint" in result.stderr) == (2, True), result.stderr
    assert list(tmp_path.iterdir()) == []
