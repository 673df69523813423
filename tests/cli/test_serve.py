"""`hexwire serve`, and the other commands through the arm that it shares."""

from __future__ import annotations

import json
import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from click.testing import CliRunner
from tests.cli.shared_arm import ARM, Plug, ok, patient, plain, process, run
from tests.waits import PATIENCE, eventually
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from hexwire.cli.exits import DEVICE, INTERRUPTED, USAGE
from hexwire.cli.main import cli
from hexwire.control.motion.motions import run_motion
from hexwire.control.sharing.lease import TIMEOUT
from hexwire.drivers import registry
from hexwire.drivers.base import RobotDriver
from hexwire.emulator.board import make_hex7bot_board
from hexwire.errors import DeviceError, HexwireError
from hexwire.fleet.service import Service
from hexwire.fleet.service_file import read_arms
from hexwire.model.state import JointTarget
from hexwire.studio.foxglove import SUBPROTOCOL


@pytest.fixture
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="hw") as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        monkeypatch.setenv("XDG_STATE_HOME", folder)
        monkeypatch.delenv("HEXWIRE_PORT", raising=False)
        patient(monkeypatch)
        yield Path(folder)


@pytest.fixture
def plug() -> Iterator[Plug]:
    with Plug(make_hex7bot_board(start=time.monotonic())) as plug:
        yield plug


@pytest.fixture
def shared(runtime: Path) -> Iterator[Service]:
    """An emulated arm, shared as lab/arm1 by this process."""
    interval = sys.getswitchinterval()
    sys.setswitchinterval(0.001)
    # Longer times than usual, so that a busy machine is not taken for a program or a host that died.
    with Service(read_arms({"lab/arm1": {"robot": "sim", "watchdog": 5.0}}, lease=5.0)) as service:
        yield service
    sys.setswitchinterval(interval)


# -- the same results as without a server -----------------------------------------------------------------

WAYPOINTS = {
    "joint_names": ["J1", "J5"],
    "points": [
        {"positions": [0.0, 0.0], "time_from_start": 0.0},
        {"positions": [0.1, 0.1], "time_from_start": 0.5},
    ],
}

COMMANDS = [
    "state",
    "state --json",
    "ping 3",
    "ping 99",
    "probe",
    "probe --json",
    "torque on",
    "torque on J9",
    "torque off J2 J1",
    "torque on --json",
    "move J1=400",
    "move Jx=4",
    "move J1",
    "move --wait J1=-5 --duration 0.2",
    "move --wait J1=2 --duration 0.2 --json",
    "goto 0 20 0 --relative",
    "goto 0 20 0 --relative --dry-run",
    "goto 0 20 900",
    "line 0 -20 0 --relative --json",
    "goto 0 20 0 --relative --dry-run --plot FOLDER/a.png --force",
    "goto 0 20 0 --relative --dry-run --plot FOLDER/a.txt",
    "grip open",
    "grip 20% --json",
    "pump suck",
    "pump off --json",
    "play WAYPOINTS",
    "play NOTHING",
    "--record FOLDER/r.mcap --force move --wait J1=3 --duration 0.2",
    "play FOLDER/r.mcap --dry-run",
    "teach FOLDER/t.mcap --duration 0.3 --yes --force",
    "teach FOLDER/t.mcap --duration 0.2 --yes --force --limp --json",
    "teach FOLDER/t.mcap",
    "torque on",
    "stop",
    "stop --json",
    "move J1=1",
    "torque on J1",
    "resume",
    "resume --json",
    "torque off",
    "teach --help",
    "firmware info",
]
TEXT_DIFFERS = {
    # The server knows more: who stopped the arm.
    "move J1=1",
    "torque on J1",
}


@pytest.mark.slow
def test_each_command_says_and_returns_the_same_directly_and_through_a_server(
    runtime: Path, shared: Service, plug: Plug
) -> None:
    (runtime / "w.json").write_text(json.dumps(WAYPOINTS))
    for command in COMMANDS:
        words = command.replace("WAYPOINTS", str(runtime / "w.json")).replace("NOTHING", str(runtime / "no.json"))
        words = words.replace("FOLDER", str(runtime))
        direct, remote = run(*words.split(), port=plug.path), run(*words.split())
        assert (command, remote.exit_code) == (command, direct.exit_code), remote.output + direct.output
        assert remote.exception is None or isinstance(remote.exception, SystemExit), command
        if command not in TEXT_DIFFERS:
            assert (command, plain(remote.output)) == (command, plain(direct.output))


def test_what_needs_the_port_itself_is_refused_in_one_line(shared: Service) -> None:
    for command, says in (
        ("bus scan", "is a shared arm; this command needs the port itself"),
        ("loopback", "is a shared arm"),
        ("demo --yes-move-the-arm", "is a shared arm"),
        ("state --baud 9600", "--baud, --raise-baud, --dialect and --timeout belong to a port"),
        ("state --robot so101", "is a hex7bot, not a so101"),
    ):
        result = run(*command.split())
        assert result.exit_code == USAGE, (command, result.output)
        assert says in result.stderr
        assert result.stderr.count("\n") == 1


def test_an_address_that_leads_nowhere_is_one_line_with_the_right_status(shared: Service) -> None:
    for port, status in (("zenoh:lab/arm7", DEVICE), ("zenoh:", USAGE), ("zenoh:a?x=1", USAGE)):
        result = run("state", port=port)
        assert (port, result.exit_code) == (port, status)
        assert result.stderr.startswith("error: ")
        assert result.stderr.count("\n") == 1


def test_take_belongs_to_shared_arms(shared: Service, plug: Plug) -> None:
    assert run("state", "--take", port=plug.path).exit_code == USAGE
    ok("torque", "on", "--take")


def test_the_environment_names_the_arm_and_observers_work(
    shared: Service, runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HEXWIRE_PORT", ARM)
    traced = CliRunner().invoke(cli, ["state", "--trace"])
    assert traced.exit_code == 0
    assert traced.stderr.startswith("note: no bytes to show")
    # Then the states that it read, as in the chapter.
    assert next(line.partition(" ")[0] for line in traced.stderr.splitlines()[1:]) == "hex7bot::"
    assert traced.stderr.count("note:") == 1
    file = runtime / "file.mcap"
    recorded = CliRunner().invoke(cli, ["--record", str(file), "move", "--wait", "J1=3", "--duration", "0.2"])
    assert (recorded.exit_code, recorded.stderr) == (0, "")
    played = CliRunner().invoke(cli, ["play", str(file), "--dry-run"])
    assert played.exit_code == 0, played.output
    doctor = CliRunner().invoke(cli, ["doctor"])
    assert doctor.exit_code == 0, doctor.output


# -- several programs -------------------------------------------------------------------------------------


class Mover:
    """Another program that moves the arm for twenty seconds, unless something ends it."""

    def __init__(self) -> None:
        self.robot = registry.connect(ARM)
        self.robot.torque(True)
        self.error: HexwireError | None = None
        self.why = ""
        self._thread = threading.Thread(target=self._run)
        self._thread.start()
        eventually(lambda: self.robot.read().velocity[0] > 0.01)

    def _run(self) -> None:
        try:
            self.why = run_motion(self.robot, JointTarget.of({"J1": 1.0}, 20.0)).why
        except HexwireError as error:
            self.error = error

    def end(self) -> None:
        self._thread.join(PATIENCE)
        self.robot.detach()


def test_one_moves_another_is_refused_a_third_stops_and_a_fourth_watches(shared: Service) -> None:
    with registry.connect(ARM) as watcher:
        states = watcher.stream(0.05)
        mover = Mover()
        refused = run("move", "J1=0")
        assert refused.exit_code == DEVICE
        assert refused.stderr.count("\n") == 1
        assert f"process {os.getpid()}" in refused.stderr
        assert "--take" in refused.stderr
        assert not next(states).stopped
        assert "stopped, holding: J1 J2 J3 J4 J5 J6 J7" in ok("stop")
        mover.end()
        assert "stopped" in mover.why
        eventually(lambda: next(states).stopped)
        assert watcher.read().positions["J1"] < 0.9
        # The lease of the one that was stopped has been given back.
        ok("resume")
        ok("move", "J1=0", "--duration", "0.2")


def test_take_takes_the_arm_from_the_one_that_moves_it(shared: Service) -> None:
    mover = Mover()
    taken = run("move", "--wait", "J1=0", "--duration", "0.3", "--take")
    assert taken.exit_code == 0, taken.output
    mover.end()
    assert mover.error is not None
    assert "took the lease" in str(mover.error) or "holds the lease" in str(mover.error)
    assert '"stopped": false' in ok("state", "--json")


@pytest.mark.slow
def test_a_move_without_wait_runs_to_its_end_after_the_command(shared: Service) -> None:
    with registry.connect(ARM) as robot:
        ok("move", "J1=20", "--duration", "2")
        assert robot.read().positions["J1"] < 0.3
        eventually(lambda: abs(robot.read().positions["J1"] - 0.349) < 0.02)


# -- processes --------------------------------------------------------------------------------------------


def test_ctrl_c_stops_the_arm(shared: Service) -> None:
    with (
        registry.connect(ARM) as robot,
        process("move", "--wait", "J1=60", "--duration", "20", "--port", ARM) as moving,
    ):
        eventually(lambda: robot.read().velocity[0] > 0.02)
        moving.send_signal(signal.SIGINT)
        _, said = moving.communicate(timeout=PATIENCE)
        assert moving.returncode == INTERRUPTED
        assert "stopped: the arm holds" in said
        assert robot.read().stopped
        assert robot.read().positions["J1"] < 0.9


def held_after_silence(shared: Service, robot: RobotDriver) -> float:
    """Let the lease of a program that is silent from now on end as usual; returns where J1 then rests, radians."""
    arm = shared._arms[0].shared
    # Only now: before, a busy machine must not be taken for a silent program.
    arm._lease.timeout = TIMEOUT
    eventually(lambda: "lost the lease" in arm.held)
    eventually(lambda: abs(robot.read().velocity[0]) < 0.005)
    where = robot.read().positions["J1"]
    assert where < 0.9, "long before its goal"
    return where


def test_a_frozen_program_loses_the_arm_which_holds_and_the_program_says_so(shared: Service) -> None:
    with (
        registry.connect(ARM) as robot,
        process("move", "--wait", "J1=60", "--duration", "20", "--port", ARM) as moving,
    ):
        eventually(lambda: robot.read().velocity[0] > 0.02)
        moving.send_signal(signal.SIGSTOP)
        where = held_after_silence(shared, robot)
        moving.send_signal(signal.SIGCONT)
        _, said = moving.communicate(timeout=PATIENCE)
        assert moving.returncode == DEVICE
        assert said.count("\n") == 1
        assert "lost the lease" in said
        state = robot.read()
        assert not state.stopped
        assert state.positions["J1"] == pytest.approx(where, abs=0.01)


def test_a_killed_program_loses_the_arm_which_holds(shared: Service) -> None:
    with (
        registry.connect(ARM) as robot,
        process("move", "--wait", "J1=60", "--duration", "20", "--port", ARM) as moving,
    ):
        eventually(lambda: robot.read().velocity[0] > 0.02)
        moving.kill()
        where = held_after_silence(shared, robot)
        begin = robot.read().stamp
        eventually(lambda: robot.read().stamp > begin + 0.3)
        assert robot.read().positions["J1"] == pytest.approx(where, abs=0.01)


@pytest.mark.parametrize(
    "number",
    [
        pytest.param(signal.SIGINT, marks=pytest.mark.slow),
        signal.SIGTERM,
        pytest.param(signal.SIGHUP, marks=pytest.mark.slow),
    ],
)
def test_every_signal_ends_the_server_with_a_stopped_arm(runtime: Path, plug: Plug, number: signal.Signals) -> None:
    # A longer watchdog than usual: a busy machine must not stop the arm before the signal does.
    (runtime / "one.toml").write_text(f'[arms."lab/arm1"]\nport = "{plug.path}"\nwatchdog = 5.0\n')
    with process("serve", "--config", str(runtime / "one.toml"), "--foxglove") as server, ExitStack() as stack:
        assert server.stdout is not None
        words, url = server.stdout.readline().split()
        assert words == "foxglove:"
        assert server.stdout.readline().startswith("lab/arm1: serial://")
        # Nobody who watches delays the end.
        viewer = stack.enter_context(connect(url, subprotocols=[Subprotocol(SUBPROTOCOL)]))
        assert json.loads(viewer.recv(PATIENCE))["name"] == "hexwire serve"
        with registry.connect(ARM) as robot:
            robot.torque(True)
            robot.write(JointTarget.of({"J1": 1.0}, 20.0))
            for _ in range(3):
                # Whoever is impatient interrupts nothing.
                server.send_signal(number)
            _, said = server.communicate(timeout=PATIENCE)
        assert (server.returncode, said) == (0, "the arms are no longer shared\n")
    with registry.connect(plug.path) as robot:
        state = robot.read()
        assert (state.stopped, state.watchdog_tripped, state.torque_on) == (True, False, robot.model.names)


def test_a_signal_while_it_waits_for_its_port_ends_it(runtime: Path) -> None:
    with process("serve", "--port", str(runtime / "nothing"), "--name", "a", "--wait") as server:
        assert server.stdout is not None
        assert server.stdout.readline().startswith("a: waiting: ")
        server.send_signal(signal.SIGTERM)
        server.communicate(timeout=PATIENCE)
        assert server.returncode == 0


def test_the_boards_watchdog_stops_the_arm_of_a_killed_server(runtime: Path, plug: Plug) -> None:
    with process("serve", "--port", plug.path, "--name", "lab/arm1") as server:
        assert server.stdout is not None
        server.stdout.readline()
        with registry.connect(ARM) as robot:
            robot.torque(True)
            robot.write(JointTarget.of({"J1": 1.0}, 20.0))
            server.kill()
            server.wait()
    eventually(lambda: plug.board.state.watchdog_tripped)
    with registry.connect(plug.path) as robot:
        state = robot.read()
        assert (state.stopped, state.watchdog_tripped, state.torque_on) == (True, True, robot.model.names)
        assert state.positions["J1"] < 0.9


@pytest.mark.slow
def test_of_an_arm_without_a_watchdog_only_a_short_step_remains_when_its_server_is_killed(runtime: Path) -> None:
    with Plug(make_hex7bot_board(dialect=1, start=time.monotonic())) as plug:
        with process("serve", "--port", plug.path, "--name", "lab/arm1") as server:
            assert server.stdout is not None
            server.stdout.readline()
            with registry.connect(ARM) as robot:
                robot.torque(True)
                sent = robot.write(JointTarget.of({"J1": 1.0}, 30.0))
                assert (dict(sent.positions), sent.duration) == ({"J1": 1.0}, 30.0)
                eventually(lambda: robot.read().positions["J1"] > 0.05)
                server.kill()
                server.wait()
        # Without steps it would go on for most of a radian, which is 652 counts.
        assert plug.moves(3.0) < 100
        assert plug.rests(5.0)


def test_if_the_line_hangs_the_end_says_so_and_the_arm_is_stopped(
    runtime: Path, plug: Plug, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Less than the 5 s for which a person waits.
    monkeypatch.setattr("hexwire.control.loop.owner._PATIENCE", 1.0)
    service = Service(read_arms({"lab/arm1": {"port": plug.path}}))
    service.start()
    service.wait_until_shared()
    robot = registry.connect(ARM)
    robot.torque(True)
    robot.write(JointTarget.of({"J1": 1.0}, 20.0))
    plug.hang()
    with pytest.raises(DeviceError, match="lab/arm1: the stop was not confirmed"):
        service.close()
    robot.abort()
    plug.go_on()
    with registry.connect(plug.path) as robot:
        state = robot.read()
        assert (state.stopped, state.torque_on) == (True, robot.model.names)


# -- the command line -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--config", "FILE", "--robot", "sim"], "leave out --robot"),
        (["--config", "FILE", "--no-table"], "leave out --no-table"),
        (["--config", "FILE", "--host-timed"], "leave out --host-timed"),
        (["--config", "FILE"], "arms.a.wacthdog: unknown, did you mean watchdog?"),
        (["--config", "/nowhere"], "cannot be read"),
        (["--robot", "sim", "--name", "a b"], "is not the name of an arm"),
        (["--robot", "sim", "--listen", "tcp/0.0.0.0:7447"], "anybody there could move the arm"),
        (["--robot", "sim", "--listen", "tls/0.0.0.0:7447"], "needs certificates"),
        (["--robot", "sim", "--links", "Z"], "links"),
        (["--robot", "chain", "--port", "/dev/null", "--table", "5"], "has no geometry"),
        (["--robot", "sim", "--lease", "0.01"], "less than 0.1"),
        (["--robot", "sim", "--foxglove", "0.0.0.0:8765"], "other machines can reach 0.0.0.0"),
        (["--robot", "sim", "--foxglove", "nowhere"], "write PORT, HOST:PORT"),
        (["--robot", "sim", "--foxglove-origin", "https://app.foxglove.dev"], "is for --foxglove"),
        (["--port", ARM], "shared already"),
    ],
)
def test_what_is_wrong_is_said_before_anything_is_opened(runtime: Path, words: list[str], says: str) -> None:
    (runtime / "FILE").write_text("[arms.a]\nrobot = 'sim'\nwacthdog = 1.0")
    result = CliRunner().invoke(
        cli, ["serve", *(str(runtime / word) if word == "FILE" else word for word in words)]
    )
    assert result.exit_code == USAGE, result.output
    assert says in result.stderr
    assert not (runtime / "hexwire").exists()


def test_who_keeps_the_time_is_an_option_and_a_setting(runtime: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[bool] = []
    monkeypatch.setattr(
        "hexwire.cli.serve._run", lambda arms, *rest: given.extend(arm.settings.host_timed for arm in arms)
    )
    (runtime / "FILE").write_text("[arms.a]\nrobot = 'sim'\nhost_timed = true\n[arms.b]\nrobot = 'sim'")
    for words in (["--robot", "sim"], ["--robot", "sim", "--host-timed"], ["--config", str(runtime / "FILE")]):
        assert CliRunner().invoke(cli, ["serve", *words]).exit_code == 0
    assert given == [False, True, True, False]
