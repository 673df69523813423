"""The demo as a person runs it: to its end, interrupted, killed; with a terminal and without."""

from __future__ import annotations

import json
import re
import signal
import sys
import time

import pytest
from click.testing import CliRunner
from tests.cli.shared_arm import Plug, ok, patient, run
from tests.defaults import patient_line
from tests.system import programs
from tests.system.programs import ANSI, PATIENCE, Terminal, children_of, gone, hexwire, read_until, start
from tests.waits import eventually

from hexwire.cli.main import cli
from hexwire.emulator.board import make_hex7bot_board

pytestmark = pytest.mark.system

SUMMARY = re.compile(
    r"dialect \d, \d+ cycles at [\d.]+ Hz \(\d+ late, \d+ skipped\), round trip p50 [\d.]+ ms p99 [\d.]+ ms, "
    r"\d+ retries, \d+ dropped frames"
)


# One second at least: where the machine stalls, a line is late.
LATER = re.compile(r"^ *[1-9]\d*\.\d s: ", re.MULTILINE)


PATIENT = """
import sys
import pytest
from tests.defaults import patient_line
from hexwire.cli import demo
from hexwire.cli.main import main
demo._WATCHDOG = 5.0
patient_line(pytest.MonkeyPatch())
sys.argv = ["hexwire", *sys.argv[1:]]
main()
"""


@pytest.fixture(autouse=True)
def _patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """Longer times, in the demo too: on a busy machine the board finds its host silent, and answers late."""
    monkeypatch.setattr(programs, "HEXWIRE", [sys.executable, "-c", PATIENT])
    patient(monkeypatch)
    patient_line(monkeypatch)


def state(path: str) -> dict[str, object]:
    return json.loads(ok("state", "--json", port=path))  # type: ignore[no-any-return]


def torque(path: str) -> list[bool]:
    return [joint["torque_on"] for joint in state(path)["joints"]]  # type: ignore[attr-defined]


@pytest.mark.slow
@pytest.mark.parametrize("options", [[], ["--baud", "0", "--rate", "50"], ["--dialect", "1", "--baud", "0"]])
def test_without_a_terminal_it_prints_plain_lines(options: list[str]) -> None:
    done = hexwire("demo", "--duration", "2", *options, env={"FORCE_COLOR": "1"})
    assert (done.returncode, done.stderr) == (0, ""), done.stdout
    assert not ANSI.search(done.stdout)
    assert "\r" not in done.stdout
    lines = done.stdout.splitlines()
    for phase in ("started", "identified", "pinged", "read", "torque on", "torque off", "summary"):
        assert sum(line.startswith(f"{phase}: ") for line in lines) == 1, phase
    assert SUMMARY.search(lines[-1])


@pytest.mark.slow
def test_on_a_terminal_it_draws_a_table_and_a_bar() -> None:
    with Terminal("demo", "--duration", "2") as terminal:
        assert terminal.wait() == 0
    text = terminal.plain
    assert terminal.text != text, "it is drawn"
    for word in ("target deg", "position deg", "error deg", "load %", "age ms", "there", "back", "2.0/2.0 s"):
        assert word in text
    assert (
        max(len(line) for line in text.replace("\r", "").splitlines() if "J7" in line and "read" not in line) <= 90
    )
    assert SUMMARY.search(" ".join(text.split()))
    assert terminal.text.count("\x1b[?25l") == terminal.text.count("\x1b[?25h"), "the cursor is shown again"


@pytest.mark.slow
def test_a_faulty_line_is_lived_with_and_counted() -> None:
    # Unpaced, a frame is one message: the same ones are hit every time.
    done = hexwire("demo", "--duration", "3", "--baud", "0", "--fault", "host.flip:0.02")
    assert done.returncode == 0, done.stderr
    retries = re.search(r"(\d+) retries", done.stdout.splitlines()[-1])
    assert retries is not None
    assert int(retries[1]) > 0


def test_a_fault_that_does_not_exist_is_a_usage_error() -> None:
    done = CliRunner().invoke(cli, ["demo", "--fault", "silly:1"])
    assert (done.exit_code, done.stdout) == (2, "")
    assert done.stderr.count("\n") == 1
    assert "silly" in done.stderr


@pytest.mark.slow
def test_a_missing_servo_ends_it() -> None:
    done = hexwire("demo", "--fault", "silent:4")
    assert done.returncode == 1
    assert done.stderr == "error: servo 4 (J5) does not answer: check cable, power and id\n"


@pytest.mark.parametrize(
    "number",
    [
        *(
            pytest.param(number, marks=pytest.mark.slow)
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        ),
        signal.SIGKILL,
    ],
)
def test_it_leaves_no_process(number: signal.Signals) -> None:
    with start("demo", "--duration", "30") as demo:
        read_until(demo, LATER)
        children = children_of(demo.pid)
        assert children
        demo.send_signal(number)
        _, err = demo.communicate(timeout=PATIENCE)
    assert demo.returncode == (-signal.SIGKILL if number == signal.SIGKILL else 130)
    assert err.strip() == ("" if number == signal.SIGKILL else "torque off: all joints")
    assert all(gone(child) for child in children)


@pytest.mark.slow
def test_ctrl_c_on_a_terminal_leaves_no_process_and_a_usable_terminal() -> None:
    with Terminal("demo", "--duration", "30") as terminal:
        terminal.read_until("there")
        children = children_of(terminal.process.pid)
        assert children
        terminal.type(b"\x03")
        assert terminal.wait() == 130
    assert "torque off: all joints" in terminal.plain
    assert "Traceback" not in terminal.plain
    assert terminal.text.count("\x1b[?25l") == terminal.text.count("\x1b[?25h"), "the cursor is shown again"
    assert all(gone(child) for child in children)


@pytest.mark.parametrize("dialect", [pytest.param(1, marks=pytest.mark.slow), 2])
@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_an_interrupted_demo_leaves_no_torque(number: signal.Signals, dialect: int) -> None:
    # Unpaced: reading back the registers of dialect 1 takes seconds at its rate.
    with (
        Plug(make_hex7bot_board(dialect=dialect, baud=0, start=time.monotonic())) as arm,
        start("demo", "--port", arm.path, "--yes-move-the-arm", "--duration", "30") as demo,
    ):
        path = arm.path
        read_until(demo, "torque on")
        read_until(demo, " s: ")
        demo.send_signal(number)
        _, err = demo.communicate(timeout=PATIENCE)
        assert demo.returncode == 130
        assert "torque off: all joints" in err
        # Dialect 1 has no flag for it: the command reads the registers back and says what it found on.
        if dialect == 2:
            assert not any(torque(path))
            assert state(path)["stopped"] is False
        else:
            moved = run("move", "J1=-4", "J4=0", "J5=3", port=path)
            assert "torque on: J1 J4 J5" in moved.stdout, moved.output


@pytest.mark.slow
def test_a_killed_demo_leaves_no_torque_either() -> None:
    with (
        Plug(make_hex7bot_board(start=time.monotonic())) as arm,
        start("demo", "--port", arm.path, "--yes-move-the-arm", "--duration", "30") as demo,
    ):
        path = arm.path
        read_until(demo, "torque on")
        read_until(demo, LATER)
        demo.kill()
        demo.communicate(timeout=PATIENCE)
        # The board's own watchdog acts after a second without us; asking it any earlier would feed it.
        eventually(lambda: arm.board.state.watchdog_tripped)
        assert state(path)["watchdog_tripped"] is True
        assert not any(torque(path))
