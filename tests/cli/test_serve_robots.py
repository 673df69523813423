"""Every command through `hexwire serve`, for every kind of robot: the same as at its port."""

from __future__ import annotations

import json
import os
import re
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from socket import SOCK_DGRAM
from subprocess import Popen

import pytest
from click.testing import Result
from tests.beside import beside
from tests.cli.shared_arm import ARM, patient, plain, process, run
from tests.defaults import patient_line
from tests.fleet.emulated import KINDS, emulated
from tests.link.far_ends import free_port
from tests.ros1.ros_world import PtyBoard, still
from tests.system.test_dead_host import pushed_stick
from tests.waits import PATIENCE, eventually

from hexwire.cli.exits import DEVICE, INTERRUPTED
from hexwire.drivers import registry
from hexwire.drivers.base import RobotDriver
from hexwire.fleet.service import Service
from hexwire.fleet.service_file import read_arms, read_service_file
from hexwire.trace.recording import read_joint_states


@pytest.fixture(scope="module")
def folder() -> Iterator[Path]:
    """The folder of sockets, settings and files of this module."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(0.001)
    with tempfile.TemporaryDirectory(prefix="hw") as name, pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", name)
        patch.setenv("XDG_STATE_HOME", name)
        patch.delenv("HEXWIRE_PORT", raising=False)
        patient(patch)
        yield Path(name)
    sys.setswitchinterval(interval)


def service(arms: dict[str, dict[str, object]]) -> Service:
    # Longer times than usual, so that a busy machine is not taken for a program or a host that died.
    return Service(read_arms({name: {"watchdog": 15.0} | row for name, row in arms.items()}, lease=15.0))


@pytest.fixture(scope="module")
def board(folder: Path) -> Iterator[PtyBoard]:
    """A board whose arm is shared as lab/board."""
    board = PtyBoard(folder / "arm")
    try:
        with pytest.MonkeyPatch.context() as patch:
            # No test lets this board be silent; a busy machine does.
            patient_line(patch, window=5.0)
            with service({"lab/board": {"port": board.port}}):
                yield board
    finally:
        board.close()


BOARD = "zenoh:lab/board"


def at_board(*words: str) -> Result:
    return run(*words, port=BOARD)


@contextmanager
def ctrl_c_after(what: Callable[[], object]) -> Iterator[None]:
    """Ctrl-C for the command in this block when something has been done in another thread."""

    def interrupt(ended: threading.Event) -> None:
        try:
            what()
        finally:
            # A command that has failed is not there to be interrupted.
            if not ended.is_set():
                os.kill(os.getpid(), signal.SIGINT)

    with beside(interrupt):
        yield


# -- the same as at the port --------------------------------------------------------------------------------

EVERY = [
    "state",
    "ping",
    "ping 99",
    "probe",
    "torque on",
    "move --wait JOINT=-3 --duration 0.2",
    "move JOINT=0",
    "goto STEP --relative",
    "line STEP --relative --dry-run --json",
    "grip open",
    "pump suck",
    "play WAYPOINTS",
    "--record FOLDER/r.mcap --force move --wait JOINT=3 --duration 0.2",
    "play FOLDER/r.mcap --dry-run",
    "teach FOLDER/t.mcap --duration 0.3 --rate 10 --yes --force",
    "stop",
    "move JOINT=1",
    "torque on JOINT",
    "play WAYPOINTS",
    "resume",
    "stop --torque-off --json",
    "resume",
    "firmware info",
]
"""For robots that `test_serve` does not have. JOINT is the arm's first one, STEP a small one for its tip."""
UNKNOWN_TORQUE = ("state", "resume")
"""A board of dialect 1 does not say which joints have torque; the server remembers."""
SAYS_MORE = ("move JOINT=1", "torque on JOINT", "play WAYPOINTS")
"""After the stop: the server knows who stopped the arm."""
OF_A_SERVER = (
    (r"no watchdog on this port: if this program dies", "no watchdog at its server: if its server dies"),
    (
        r"hexwire keeps it for this user on this computer until 'hexwire resume'; .*",
        "the arm's server keeps it until 'hexwire resume'",
    ),
    # Whose round trips those are differs.
    (r": ok, # ms", ": ok"),
    # What the tip or a joint is sent to depends on where it came to rest, to the width of a count.
    (r"(goto|line to) .* (mm|m)\b", r"\1"),
)


UNANSWERED = re.compile("not confirmed by|no answer|does not answer")


UNCALIBRATED = "note: not calibrated: "
"""Of an arm that somebody shares, its server says so, in its log."""


STALLED = re.compile(r"warning: \S+: its states (have stopped arriving|arrive again)")


def says(output: str) -> list[str]:
    """The lines of a command at a port as the same command says them at a server."""
    lines = []
    for line in plain(output):
        for text, other in OF_A_SERVER:
            line = re.sub(text, other, line)
        # Of a board of dialect 1 only the server knows which joints have torque already; and a busy machine may
        # keep it from telling states for a while.
        if not (line.startswith(("torque on: ", UNCALIBRATED)) or STALLED.match(line)):
            lines.append(line)
    return lines


@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "dialect 2"])
def test_each_command_says_and_returns_the_same_for_each_robot(folder: Path, kind: str) -> None:
    with emulated(kind) as own, emulated(kind) as behind, service({"lab/arm1": behind}):
        with registry.connect(ARM) as robot:
            joint, step = robot.model.names[0], "0 0.01 0" if kind == "puma260" else "0 10 0"
        waypoints = {
            "joint_names": [joint],
            "points": [{"positions": [0.0], "time_from_start": 0.0}, {"positions": [0.05], "time_from_start": 0.3}],
        }
        (folder / "w.json").write_text(json.dumps(waypoints))
        stopped = False
        for command in EVERY:
            if kind == "dialect 1" and "FOLDER/r.mcap" in command:
                # It reads four states a second, which are too few to play.
                continue
            words = command.replace("JOINT", joint).replace("STEP", step).replace("FOLDER", str(folder))
            words = words.replace("WAYPOINTS", str(folder / "w.json"))
            for _ in range(3):
                direct = run(*words.split(), "--robot", str(own["robot"]), port=str(own["port"]))
                remote = run(*words.split())
                # An emulated servo that got no processor has not answered one of the two.
                if direct.exit_code == remote.exit_code or not UNANSWERED.search(direct.output + remote.output):
                    break
            assert (command, remote.exit_code) == (command, direct.exit_code), remote.output + direct.output
            assert remote.exception is None or isinstance(remote.exception, SystemExit), command
            stopped = command.startswith("stop") or (stopped and not command.startswith("resume"))
            if kind == "dialect 1" and command in UNKNOWN_TORQUE:
                continue
            if stopped and command in SAYS_MORE:
                assert remote.stderr.splitlines()[-1].startswith("error: ")
                continue
            texts = [says(remote.output), says(direct.output)]
            if command.startswith("play"):
                # Whether an arm stands near enough to the beginning is not the server's doing.
                texts = [[line for line in text if not line.startswith("approach:")] for text in texts]
            assert (command, texts[0]) == (command, texts[1])
        examined = run("doctor")
        assert examined.exit_code == 0, examined.output
        assert "is not examined through the server" in examined.stdout
        run("stop")


def test_one_file_shares_every_kind_of_robot(folder: Path) -> None:
    with ExitStack() as stack:
        rows = {kind: stack.enter_context(emulated(kind)) for kind in KINDS}
        (folder / "lab.toml").write_text(
            "".join(
                f'[arms."lab/{kind.replace(" ", "-")}"]\nrobot = "{row["robot"]}"\nport = "{row["port"]}"\n'
                for kind, row in rows.items()
            )
        )
        stack.enter_context(Service(read_service_file(str(folder / "lab.toml"))[0]))
        for kind, row in rows.items():
            with registry.connect(f"zenoh:lab/{kind.replace(' ', '-')}") as robot:
                assert robot.model.name == row["robot"]
                assert not robot.read().silent


# -- by hand, by joystick -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_motion_that_is_taught_by_hand_is_recorded_and_played(board: PtyBoard, folder: Path) -> None:
    file, port = str(folder / "hand.mcap"), BOARD
    assert at_board("torque", "on").exit_code == 0
    with registry.connect(port) as robot:
        begin = robot.read().positions["J1"]

        def lead() -> None:
            eventually(lambda: not robot.read().torque_on)
            # It holds so long that the last states are recorded.
            board.lead("J1", 0.4, 0.8, hold=0.9)

        with ctrl_c_after(lead):
            taught = at_board("teach", file, "--yes")
        assert (taught.exit_code, taught.stderr) == (0, "recording; Ctrl-C ends it\n")
        rows = [dict(zip(row.names, row.position, strict=True))["J1"] for row in read_joint_states(file)]
        # The hand may have begun before the recording.
        assert rows[0] < begin + 0.2
        assert rows[-1] == pytest.approx(begin + 0.4, abs=0.05)
        assert len(robot.read().torque_on) == 7
        assert at_board("move", "J1=0", "--wait", "--duration", "0.3").exit_code == 0
        played = at_board("play", file, "--speed", "2")
        # A machine that stalls is told about; the motion is the same.
        assert played.exit_code == 0, played.stderr
        assert played.stderr == "" or played.stderr.startswith("warning: the line or the machine is too slow")
        assert robot.read().positions["J1"] == pytest.approx(begin + 0.4, abs=0.05)


def test_hand_guiding_ends_with_an_error_when_another_program_takes_the_arm(board: PtyBoard, folder: Path) -> None:
    file, port = folder / "taken.mcap", BOARD
    # So that the torque goes only when the teaching begins.
    assert at_board("torque", "on").exit_code == 0
    with registry.connect(f"{port}?take=1") as other:

        def take() -> None:
            eventually(lambda: not other.read().torque_on)
            other.torque(True)

        taker = threading.Thread(target=take)
        taker.start()
        taught = at_board("teach", str(file), "--yes", "--duration", "60")
        taker.join(PATIENCE)
        assert taught.exit_code == DEVICE
        assert "states are kept in" in taught.stderr
        error = taught.stderr.splitlines()[-1]
        assert "took the lease" in error or "holds the lease" in error
        assert len(other.read().torque_on) == 7


@contextmanager
def teleop(robot: RobotDriver) -> Iterator[Popen[str]]:
    """A program that moves the arm because somebody pushes its stick."""
    channel, begin = free_port(SOCK_DGRAM), robot.read().positions["J1"]
    words = ("teleop", "--from", f"udp-listen://127.0.0.1:{channel}", "--port", BOARD)
    with pushed_stick(channel), process(*words) as program:
        eventually(lambda: robot.read().positions["J1"] > begin + 0.02)
        yield program


@pytest.mark.slow
def test_teleop_moves_the_arm_until_ctrl_c_or_until_another_program_takes_it(board: PtyBoard) -> None:
    at_board("move", "J1=0", "--wait", "--duration", "0.3")
    with registry.connect(BOARD) as robot:
        with teleop(robot) as program:
            program.send_signal(signal.SIGINT)
            _, said = program.communicate(timeout=PATIENCE)
            assert (program.returncode, "error" in said) == (INTERRUPTED, False)
        still(lambda: board.positions)
        assert (robot.read().stopped, len(robot.read().torque_on)) == (False, 7)
        with teleop(robot) as program:
            assert at_board("torque", "on").exit_code == DEVICE
            assert at_board("torque", "on", "--take").exit_code == 0
            _, said = program.communicate(timeout=PATIENCE)
        assert program.returncode == DEVICE
        (error,) = [line for line in said.splitlines() if line.startswith("error: ")]
        assert "took the lease" in error or "holds the lease" in error
        still(lambda: board.positions)
        assert (robot.read().stopped, len(robot.read().torque_on)) == (False, 7)


# -- Ctrl-C, and the end of the server ----------------------------------------------------------------------

LONG = {
    "joint_names": ["J1"],
    "points": [{"positions": [0.0], "time_from_start": 0.0}, {"positions": [0.6], "time_from_start": 20.0}],
}


@pytest.fixture
def long(folder: Path) -> str:
    """A file with a slow motion of J1."""
    file = folder / "long.json"
    file.write_text(json.dumps(LONG))
    return str(file)


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    [
        pytest.param("goto 40 0 0 --relative --speed 1", marks=pytest.mark.slow),
        pytest.param("line 40 0 0 --relative --speed 4", marks=pytest.mark.slow),
        "play LONG",
    ],
)
def test_ctrl_c_in_a_command_that_moves_stops_the_arm(board: PtyBoard, long: str, command: str) -> None:
    assert at_board("resume").exit_code == 0
    # A joint without it, also one that does not move, keeps the board from following a path.
    assert at_board("torque", "on").exit_code == 0
    assert at_board("move", "J1=0", "--wait", "--duration", "0.3").exit_code == 0

    with registry.connect(BOARD) as robot:
        # What is left of the motion before must not count as this one.
        still(lambda: robot.read().positions)
        begin = robot.read().positions
        with ctrl_c_after(lambda: eventually(lambda: max(robot.read().distances(begin).values()) > 0.03)):
            ended = at_board(*command.replace("LONG", long).split())
        assert ended.exit_code == INTERRUPTED, ended.output
        assert ended.stderr == "stopped: the arm holds; clear it with 'hexwire resume'\n"
        assert robot.read().stopped
    assert at_board("resume").exit_code == 0


@pytest.mark.slow
def test_each_command_ends_in_one_line_when_its_server_is_killed(folder: Path, long: str) -> None:
    names = ["a", "b", "c", "d", "e"]
    (folder / "five.toml").write_text("".join(f'[arms.{name}]\nrobot = "sim"\nwatchdog = 15.0\n' for name in names))
    commands = [
        # So slow that none has ended when the last program has begun.
        "move --wait J1=40 --duration 100",
        f"play {long} --speed 0.2",
        "goto 40 0 0 --relative --speed 1",
        f"teach {folder / 'k.mcap'} --yes",
        "state --watch",
    ]
    with ExitStack() as stack:
        server = stack.enter_context(process("serve", "--config", str(folder / "five.toml")))
        assert server.stdout is not None
        for _ in names:
            server.stdout.readline()
        programs = [
            stack.enter_context(process(*command.split(), "--port", f"zenoh:{name}"))
            for command, name in zip(commands, names, strict=True)
        ]
        for program in programs:
            assert program.stdout is not None
        programs[-1].stdout.readline()  # type: ignore[union-attr]  # it is a pipe
        for name in ("a", "b", "c"):
            with registry.connect(f"zenoh:{name}") as robot:
                eventually(lambda: robot.read().torque_on)
        eventually(lambda: (folder / "k.mcap").exists())
        server.kill()
        for command, program in zip(commands, programs, strict=True):
            shown, said = program.communicate(timeout=PATIENCE)
            errors = [line for line in said.splitlines() if line.startswith("error: ")]
            ended = program.returncode, len(errors), "Traceback" in said
            assert ended == (DEVICE, 1, False), f"{command}: {shown}{said}"
