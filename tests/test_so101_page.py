"""docs/so101.md: each command of hexwire is run, on emulated arms.

Ids, health and calibration are run in simulated time; what moves and follows, in real time, on arms with the
calibration that was found, whose programs run until Ctrl-C. `make test-lerobot` runs the other commands
(integrations/lerobot/tests/test_page.py).
"""

from __future__ import annotations

import json
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from string import Template
from types import SimpleNamespace

import click
import pytest
from click.testing import CliRunner
from tests.cli.shared_arm import patient
from tests.cli.test_bus_arm_setup import Person
from tests.cli.test_bus_calibrate import CalibrateCli
from tests.control.so_bench import NAMES, SoBench
from tests.waits import PATIENCE

from hexwire.cli.main import cli
from hexwire.drivers.arm_file import load_arm_file, load_calibration
from hexwire.emulator.hand import HandOrder
from hexwire.emulator.serve_hand import move_by_hand
from hexwire.link.ports import PortInfo

TEXT = (Path(__file__).resolve().parent.parent / "docs" / "so101.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^ *```(\S*)\n(.*?)^ *```", TEXT, re.MULTILINE | re.DOTALL)
LINES = [line for kind, block in BLOCKS if kind == "console" for line in block.replace("\\\n", "").splitlines()]
COMMANDS = [line.removeprefix("$ ") for line in LINES]
OURS = [command for command in COMMANDS if command.startswith("hexwire ")]
AT_THE_TABLE = [command for command in OURS if command.split()[1] in ("ports", "bus")]
PROGRAMS = [command for command in OURS if command not in AT_THE_TABLE]
ARM_FILES = {block.split('"')[1]: block for kind, block in BLOCKS if kind == "toml"}
Said = dict[str, str]


def words(command: str, **ports: str) -> list[str]:
    """The words of a command after `hexwire`, as a shell passes them."""
    return shlex.split(Template(command).substitute(ports))[1:]


# --- the page ------------------------------------------------------------------------------------------------


def test_no_block_is_left_out() -> None:
    assert TEXT.count("```") == 2 * len(BLOCKS)
    assert {kind for kind, _ in BLOCKS} == {"console", "toml"}
    assert all(line.startswith("$ ") for line in LINES)
    # The plug-in's test runs every command that is not hexwire's; these are the programs that it knows.
    others = {re.split("[ =]", command)[0] for command in COMMANDS if command not in OURS}
    assert {name for name in others if not name.startswith("lerobot-")} == {
        *("pip", "FOLLOWER", "LEADER"),
        *("CALIBRATION", "mkdir", "cp"),
    }


def test_every_step_of_lerobot_has_its_place() -> None:
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in TEXT.splitlines() if "](#" in line]
    steps = {row[1].strip("`"): row[2] for row in rows if row[1].startswith("`")}
    assert list(steps) == [
        *("lerobot-find-port", "lerobot-setup-motors", "lerobot-calibrate", "lerobot-teleoperate"),
        *("lerobot-record", "lerobot-replay", "lerobot-train"),
    ]
    for row in rows:
        number, place = re.findall(r"\[(\d+)\]\(#(\S+)\)", row[0])[0]
        (title,) = re.findall(rf"^## {number}\. (.*)$", TEXT, re.MULTILINE)
        assert place == f"{number}-" + title.lower().replace(" ", "-")
        section = TEXT.split(f"## {number}. {title}\n")[1].split("\n## ")[0]
        assert row[1].strip("`–") in section


def test_commands_of_the_page_exist() -> None:
    for text in [*re.findall(r"`(?:sudo )?(hexwire [^`]+)`", TEXT), *OURS]:
        found: click.Command | None = cli
        rest = text.split()[1:]
        while rest[0].startswith("--") and text in OURS:
            # An option with its value before the command.
            del rest[:2]
        while isinstance(found, click.Group) and rest and not rest[0].startswith("-"):
            found = found.get_command(click.Context(found), rest.pop(0))
        assert found is not None, text
        known = {name for parameter in found.params for name in parameter.opts}
        assert {word for word in rest if word.startswith("--")} <= known, text


# --- ids, health and calibration, in simulated time -----------------------------------------------------------


class Table:
    """Both arms, in simulated time; the cable of one of them is plugged in for each command."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.monkeypatch = monkeypatch
        self.arms = {
            name: CalibrateCli(monkeypatch, bench=SoBench(1, leader=name == "leader", any_horns=False))
            for name in ("follower", "leader")
        }

    def run(self, command: str) -> str:
        arm = self.arms["leader" if "$LEADER" in command else "follower"]
        arm.plug_in(self.monkeypatch)
        if command == "hexwire ports --find":
            self.unplug()
        elif command.startswith("hexwire bus setup"):
            self.new_servos(arm)
        # Its questions: hold the arm, the middle of wrist_roll, and whether it may move.
        given = words(command, FOLLOWER="/dev/ttyACM0", LEADER="/dev/ttyACM1")
        result = CliRunner().invoke(cli, given, input="y\n\n\n")
        assert result.exit_code == 0, f"{command}: {result.output}"
        return result.output

    def unplug(self) -> None:
        one, two = PortInfo("/dev/ttyACM1"), PortInfo("/dev/ttyACM0", guess="an adapter")
        looks = [[one, two], [one], [one, two], [one, two]]
        now = [0.0]
        self.monkeypatch.setattr(
            "hexwire.link.ports.list_ports", lambda: looks.pop(0) if len(looks) > 1 else looks[0]
        )
        clock = SimpleNamespace(monotonic=lambda: now[0], sleep=lambda s: now.__setitem__(0, now[0] + s))
        self.monkeypatch.setattr("hexwire.cli.look.time", clock)

    def new_servos(self, arm: CalibrateCli) -> None:
        servos, wire = list(arm.parts.arm.servos), arm.parts.device.wire
        acts: list[Callable[[], object] | str] = []
        wire.servos[:] = []
        for count in range(1, 7):
            acts.append(lambda count=count: wire.servos.__setitem__(slice(None), servos[-count:]))  # type: ignore[misc]
            if count < 6:
                acts.append("y")
        for servo in servos:
            servo.registers.put_stored("id", 1)
        self.monkeypatch.setattr("hexwire.cli.bus_setup.sys", SimpleNamespace(stdin=Person(*acts)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the owner works: with the arm files of the page."""
    path = tmp_path_factory.mktemp("so101")
    for name, text in ARM_FILES.items():
        (path / f"{name}.toml").write_text(text)
    return path


@pytest.fixture(scope="module")
def table(folder: Path) -> tuple[Table, Said]:
    """Both arms after all commands at the table, and what each of these said."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        monkeypatch.chdir(folder)
        both = Table(monkeypatch)
        said = {command: both.run(command) for command in AT_THE_TABLE}
    return both, said


@pytest.mark.slow
def test_the_page_from_the_box_to_calibrated_arms(table: tuple[Table, Said], folder: Path) -> None:
    arms, said = table[0].arms, table[1]
    assert "/dev/ttyACM0" in said["hexwire ports --find"]
    assert not [text for text in said.values() if "BAD" in text]
    for name, arm in arms.items():
        assert [servo.servo_id for servo in arm.parts.arm.servos] == [1, 2, 3, 4, 5, 6]
        rows = json.loads((folder / f"{name}.json").read_text())
        assert list(rows) == list(NAMES)
        offsets = [servo.registers.stored("position_offset") for servo in arm.parts.arm.servos]
        assert [row["homing_offset"] for row in rows.values()] == offsets
        made = load_arm_file(folder / f"{name}.toml").calibration
        assert made is not None
        assert made.joints == load_calibration(folder / f"{name}.json").joints
    cal = load_calibration(folder / "follower-cal.toml")
    assert cal.joints == load_calibration(folder / "follower.json").joints


# --- what moves and follows, in real time ----------------------------------------------------------------------

_SILENT = re.compile(r"all servos have their old values again|is silent after|no answer to")


class Shell:
    """Runs commands of the page, each once; those that run until Ctrl-C as programs."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.done = folder, list[str]()
        self.ports = {"FOLLOWER": str(folder / "follower"), "LEADER": str(folder / "leader")}

    def given(self, start: str) -> list[str]:
        """The words of the next command of the page that begins so."""
        command = next(one for one in PROGRAMS if one.startswith(start) and one not in self.done)
        self.done.append(command)
        text = command.replace("/tmp/follower", "$FOLLOWER").replace("/tmp/leader", "$LEADER")
        return words(text, **self.ports)

    def run(self, start: str) -> str:
        return self.call(*self.given(start))

    def call(self, *given: str) -> str:
        end = time.monotonic() + PATIENCE
        done = CliRunner().invoke(cli, given)
        # The emulated servos had no processor for a moment: a person would do it again.
        while done.exit_code == 1 and _SILENT.search(done.stderr) and time.monotonic() < end:
            done = CliRunner().invoke(cli, given)
        assert done.exit_code == 0, f"{given}: {done.output}"
        return done.stdout

    @contextmanager
    def running(self, start: str, ready: str, *more: str) -> Iterator[subprocess.Popen[str]]:
        """A command that runs until Ctrl-C, with more words; it is ready when it has said something."""
        command = [sys.executable, "-m", "hexwire.cli", *self.given(start), *more]
        program = subprocess.Popen(
            command, cwd=self.folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
        )
        assert program.stdout is not None
        try:
            said = ""
            while ready not in said:
                line = program.stdout.readline()
                assert line, f"{start} ended: {said}"
                said += line
            yield program
            program.send_signal(signal.SIGINT)
            said += program.communicate(timeout=30.0)[0]
            assert program.returncode in (0, 130), f"{start}: {said}"
        finally:
            program.kill()
            program.wait()
            program.stdout.close()

    def angle(self, arm: str, joint: str) -> float:
        """Where a joint is, degrees."""
        given = ("state", "--json", "--robot", f"{arm}.toml", "--port", self.ports[arm.upper()])
        rows = json.loads(self.call(*given))["joints"]
        return float(next(row["position_deg"] for row in rows if row["name"] == joint))


@pytest.mark.slow
@pytest.mark.system
@pytest.mark.usefixtures("table")
def test_the_page_from_calibrated_arms_to_another_machine(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)
    patient(monkeypatch)
    shell = Shell(folder)
    with (
        shell.running("hexwire sim bus --arm so101 --link", "/"),
        shell.running("hexwire sim bus --arm so101 --leader", "/"),
    ):
        for name, port in shell.ports.items():
            file = f"{name.lower()}.json"
            shell.call("bus", "calibrate", "so101", f"x{file}", "--from", file, "--store", "--port", port)
        before = shell.angle("leader", "elbow_flex")
        assert "elbow_flex moved by -" in shell.run("hexwire sim hand")
        assert shell.angle("leader", "elbow_flex") == pytest.approx(before - 30.0, abs=2.0)

        # Put down folded, and its angles say so.
        assert re.search(r"shoulder_lift +-9[1-9]\.\d", shell.run("hexwire state --robot follower.toml"))
        assert "offset" not in shell.run("hexwire probe")
        assert "arrived" in shell.run("hexwire move")
        assert shell.angle("follower", "elbow_flex") == pytest.approx(60.0, abs=2.0)
        assert "arrived" in shell.run("hexwire goto")
        assert "50 % open" in shell.run("hexwire grip")
        assert "torque off: shoulder_pan" in shell.run("hexwire torque off")

        for start, degrees in (("hexwire follow leader.toml@$LEADER f", 20.0), ("hexwire --record", -20.0)):
            with shell.running(start, "has met the leader"):
                move_by_hand(shell.ports["LEADER"], HandOrder("shoulder_pan", degrees, 0.5, 1.0))
            led = shell.angle("leader", "shoulder_pan")
            assert shell.angle("follower", "shoulder_pan") == pytest.approx(led, abs=3.0)
        assert (folder / "wave.mcap").stat().st_size > 1000

        # A machine that stalls loses a lease of half a second.
        with shell.running("hexwire serve", "as zenoh:lab/follower", "--lease", "10"):
            assert "shoulder_pan" in shell.run("hexwire state --port zenoh:lab/follower")
            with shell.running("hexwire follow leader.toml@$LEADER zenoh:", "has met the leader"):
                move_by_hand(shell.ports["LEADER"], HandOrder("shoulder_pan", 30.0, 0.5, 1.0))
        led = shell.angle("leader", "shoulder_pan")
        assert shell.angle("follower", "shoulder_pan") == pytest.approx(led, abs=3.0)
    assert sorted(shell.done) == sorted(PROGRAMS)
