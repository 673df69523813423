"""The commands against a board on a real pseudo-terminal, and what a person meets when something is wrong."""

from __future__ import annotations

import grp
import json
import os
import signal
import stat
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from tests.cli.shared_arm import Plug, patient
from tests.defaults import patient_line
from tests.system.programs import Terminal, board, gone, mute_port, read_until, start

from hexwire.cli.main import cli
from hexwire.emulator.board import make_hex7bot_board

pytestmark = pytest.mark.system


@pytest.fixture(autouse=True)
def _patient(monkeypatch: pytest.MonkeyPatch) -> None:
    patient(monkeypatch)
    patient_line(monkeypatch)


def hexwire(*words: str, env: dict[str, str] | None = None) -> Result:
    """Run a command in this process, where a new one would take longer than the command."""
    return CliRunner(env=env).invoke(cli, words)


def plugged_in(*faults: str, dialect: int = 2, baud: int = 115200) -> Plug:
    """An arm on a terminal of this process."""
    return Plug(make_hex7bot_board(dialect=dialect, baud=baud, faults=faults, start=time.monotonic()))


def fails(status: int, *words: str) -> str:
    """Run what must fail with one line on standard error; returns that line."""
    done = hexwire(*words)
    assert done.exit_code == status, done.output
    assert done.stderr.startswith("error: ")
    assert done.stderr.count("\n") == 1, done.stderr
    return done.stderr.removeprefix("error: ").rstrip("\n")


def is_refused(*words: str) -> str:
    """As `fails`, for a usage error: nothing was done."""
    done = hexwire(*words)
    assert done.stdout == ""
    return fails(2, *words)


def succeeds(*words: str) -> str:
    done = hexwire(*words)
    assert (done.exit_code, done.stderr) == (0, ""), done.output
    return done.stdout


@pytest.mark.parametrize("dialect", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_a_day_with_the_arm(dialect: int) -> None:
    with plugged_in(dialect=dialect) as arm:
        port = ("--port", arm.path)
        assert succeeds("ping", *port).count(": ok, ") == 7
        assert json.loads(succeeds("probe", "--json", *port))["dialect"] == dialect
        moved = hexwire("move", "J1=10", "J5=-5", "--wait", *port)
        assert moved.exit_code == 0, moved.stderr
        assert "torque on: J1 J5" in moved.stdout
        # Only a board of dialect 2 stops by itself when the program dies.
        assert ("has no watchdog on this port" in moved.stderr) == (dialect == 1)
        joints = {j["name"]: j for j in json.loads(succeeds("state", "--json", *port))["joints"]}
        assert joints["J1"]["position_deg"] == pytest.approx(10.0, abs=1.0)
        assert joints["J5"]["position_deg"] == pytest.approx(-5.0, abs=1.0)
        stopped = hexwire("stop", *port)
        assert stopped.exit_code == 0, stopped.stderr
        assert ("no board latches this stop" in stopped.stderr) == (dialect == 1)
        assert hexwire("move", "J1=0", *port).exit_code == 1
        assert hexwire("resume", *port).exit_code == 0
        succeeds("torque", "off", *port)


def test_the_port_from_the_environment() -> None:
    with plugged_in(baud=0) as arm:
        done = hexwire("ping", "0", env={"HEXWIRE_PORT": arm.path})
        assert (done.exit_code, done.stderr) == (0, "")


def test_ports_are_json_if_asked() -> None:
    assert isinstance(json.loads(succeeds("ports", "--json")), list)


# --- errors that a person meets --------------------------------------------------------------------------


def test_no_such_port() -> None:
    text = fails(1, "state", "--port", "/dev/ttyNOSUCH")
    assert text.startswith("/dev/ttyNOSUCH does not exist; ")
    assert "port" in text.partition(";")[2]


def test_a_file_is_no_port(tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_text("")
    assert "is not a serial port" in fails(1, "state", "--port", str(path))


def test_no_permission_names_the_group() -> None:
    with plugged_in() as arm:
        path = arm.path
        if os.getuid() == 0:
            os.chown(path, -1, grp.getgrnam("dialout").gr_gid)
        group = grp.getgrgid(Path(path).stat().st_gid).gr_name
        Path(path).chmod(stat.S_IRGRP | stat.S_IWGRP)
        # Root may do everything, unless it gives that right away.
        less = ["setpriv", "--bounding-set", "-dac_override,-dac_read_search"] if os.getuid() == 0 else []
        command = [*less, sys.executable, "-m", "hexwire.cli", "state", "--port", path]
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert done.returncode == 1
    assert done.stdout == ""
    assert done.stderr == (
        f"error: no permission for {path}: it belongs to group {group}; "
        f"run 'sudo usermod -aG {group} $USER', then log out and in again\n"
    )


def test_a_port_in_use_names_the_program() -> None:
    with plugged_in() as arm, start("state", "--watch", "--port", arm.path) as watcher:
        path = arm.path
        try:
            read_until(watcher, " deg")
            text = fails(1, "ping", "--port", path)
        finally:
            watcher.send_signal(signal.SIGINT)
            watcher.communicate(timeout=60)
        assert text.startswith(f"{path} is in use by ")
        assert f"(pid {watcher.pid})" in text
        assert watcher.returncode == 130
        succeeds("ping", "0", "--port", path)


def test_a_port_that_answers_nothing(tmp_path: Path) -> None:
    with mute_port(tmp_path / "ttyUSB0") as path:
        text = fails(1, "probe", "--port", path, "--timeout", "0.2")
    assert text.startswith("no answer to IDENTIFY on ")
    assert "nothing arrived" in text
    assert "hexwire ports" in text


@pytest.mark.slow
def test_the_command_says_what_it_waits_for(tmp_path: Path) -> None:
    with mute_port(tmp_path / "ttyUSB0") as path, Terminal("probe", "--port", path, "--timeout", "3") as terminal:
        assert terminal.wait() == 1
        lines = terminal.plain.splitlines()
    assert lines[0].startswith("waiting for an answer on serial://")
    assert "error: no answer to IDENTIFY" in terminal.plain


def test_a_board_that_boots_is_waited_for() -> None:
    with plugged_in("boot:1.0") as arm:
        began = time.monotonic()
        assert succeeds("ping", "--port", arm.path).count(": ok, ") == 7
        assert time.monotonic() - began > 0.5, "the board cannot have been up yet"


def test_a_missing_servo() -> None:
    with plugged_in("silent:4") as arm:
        missing = "servo 4 (J5) does not answer: check cable, power and id"
        assert fails(1, "ping", "--port", arm.path) == missing
        assert fails(1, "state", "--port", arm.path) == missing
        shown = hexwire("state", "--port", arm.path).stdout.splitlines()
        assert [line.split()[0] for line in shown if line.endswith("no answer")] == ["J5"]


def test_a_wrong_rate() -> None:
    with board() as path:
        text = fails(1, "probe", "--port", path, "--baud", "57600", "--timeout", "0.3")
        assert "baud" in text
        succeeds("probe", "--port", path)


@pytest.mark.parametrize("rate", ["0", "x", "-1"])
def test_an_invalid_rate_is_refused(rate: str) -> None:
    is_refused("probe", "--port", "/dev/ttyNOSUCH", "--baud", rate)


@pytest.mark.slow
def test_unplugged_in_the_middle_of_a_move(tmp_path: Path) -> None:
    # A name of its own: the kernel soon gives a terminal's number to the next one.
    with ExitStack() as outer:
        with board("--link", str(tmp_path / "arm")) as path:
            words = ("move", "J4=80", "--duration", "30", "--wait", "--port", path)
            mover = outer.enter_context(start(*words))
            read_until(mover, "moving to")
        # The board has gone, and its terminal with it.
        out, err = mover.communicate(timeout=60)
    assert mover.returncode == 1
    assert "arrived" not in out
    lines = err.splitlines()
    assert lines[0].startswith("warning: ")
    assert "waiting up to 10 s" in lines[0]
    assert lines[-1].startswith("error: ")
    assert path in lines[-1]
    assert len(lines) == 2


# --- interruption ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [pytest.param(signal.SIGINT, marks=pytest.mark.slow), signal.SIGTERM])
def test_interrupting_a_move_stops_the_arm(number: signal.Signals) -> None:
    with plugged_in() as arm, start("move", "J4=80", "--duration", "20", "--wait", "--port", arm.path) as mover:
        read_until(mover, "moving to")
        mover.send_signal(number)
        _, err = mover.communicate(timeout=60)
        assert mover.returncode == 130
        assert "stopped: the arm holds" in err
        assert "Traceback" not in err
        state = json.loads(succeeds("state", "--json", "--port", arm.path))
        assert state["stopped"] is True
        assert state["joints"][3]["position_deg"] < 60


def test_ctrl_c_on_the_terminal_stops_the_arm_and_clears_the_progress_bar() -> None:
    with plugged_in() as arm:
        with Terminal("move", "J4=80", "--duration", "20", "--wait", "--port", arm.path) as terminal:
            terminal.read_until("deg to go")
            terminal.type(b"\x03")
            assert terminal.wait() == 130
        assert "stopped: the arm holds" in terminal.plain
        assert "Traceback" not in terminal.plain
        assert json.loads(succeeds("state", "--json", "--port", arm.path))["stopped"] is True


@pytest.mark.slow
def test_arriving_on_a_terminal() -> None:
    with plugged_in() as arm, Terminal("move", "J4=20", "--wait", "--port", arm.path) as terminal:
        assert terminal.wait() == 0
        assert terminal.plain.rstrip().endswith("arrived")


@pytest.mark.slow
def test_watching_on_a_terminal_draws_and_ends_with_ctrl_c() -> None:
    with plugged_in() as arm, Terminal("state", "--watch", "--port", arm.path) as terminal:
        terminal.read_until(lambda text: text.count("J7") >= 3)
        terminal.type(b"\x03")
        assert terminal.wait() == 130
        assert "Traceback" not in terminal.plain
        assert terminal.text.rstrip().endswith("\x1b[?25h"), "the cursor is shown again"


def test_piping_into_head_is_silent() -> None:
    with plugged_in() as arm:
        script = f"{sys.executable} -m hexwire.cli state --watch --rate 50 --json --port {arm.path} | head -n 1"
        done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, check=False, timeout=60)
        assert len(json.loads(done.stdout)["joints"]) == 7
        assert done.stderr == ""


# --- the emulator ----------------------------------------------------------------------------------------


def test_a_board_has_a_name_that_stays_and_is_tidied_up(tmp_path: Path) -> None:
    link = tmp_path / "arm"
    with board("--link", str(link)) as path:
        assert path == str(link)
        assert link.is_symlink()
        succeeds("ping", "0", "--port", path)
    assert not link.is_symlink()


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_a_board_ends_on_a_signal(number: signal.Signals) -> None:
    with start("sim", "board") as process:
        path = read_until(process, "\n").strip()
        process.send_signal(number)
        _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert err.strip() == ""
    assert not Path(path).exists() or gone(process.pid)


@pytest.mark.slow
def test_a_board_ends_with_its_standard_input() -> None:
    process = subprocess.Popen(
        [sys.executable, "-m", "hexwire.cli", "sim", "board", "--until-eof"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    assert process.stdin is not None
    assert process.stdout.readline().startswith("/dev/")
    out, err = process.communicate(timeout=60)
    assert (process.returncode, out, err) == (0, "", "")


@pytest.mark.parametrize(
    "words",
    [
        ["--fault", "silly:1"],
        ["--fault", "silent"],
        ["--baud", "-1"],
        ["--dialect", "3"],
        ["--link", "/etc/passwd"],
    ],
)
def test_invalid_board_options_are_refused(words: list[str]) -> None:
    is_refused("sim", "board", *words)


def test_a_link_that_cannot_be_made() -> None:
    assert "/nosuch" in is_refused("sim", "board", "--link", "/nosuch/folder/arm")
