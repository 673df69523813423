"""`hexwire fleet record` and `play`."""

from __future__ import annotations

import json
import signal
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from tests.fleet.conftest import Serve, runtime, serve  # noqa: F401  # fixtures
from tests.link.far_ends import free_port
from tests.recorded import make_positions
from tests.system.programs import PATIENT_PLAYER, hexwire_program
from tests.waits import eventually

from hexwire.cli.fleet import _tell
from hexwire.cli.main import cli
from hexwire.cli.output import printing_json
from hexwire.drivers import registry
from hexwire.fleet import player
from hexwire.trace.recording import RecordingWriter, topic_of

# ruff: noqa: F811  # fixtures that are imported

LEASE = 5.0
"""Longer than usual, so that a busy machine is not taken for a program that fell silent."""
DOUBT = ("--max-doubt", "250")
"""Milliseconds: on a busy machine clocks are known no better."""


def run(*words: object) -> Result:
    return CliRunner().invoke(cli, [str(word) for word in words])


@pytest.fixture(autouse=True)
def _patient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(player, "_WATCHDOG", 5.0)


def test_a_motion_is_told_arm_by_arm_and_then_as_a_whole(capsys: pytest.CaptureFixture[str]) -> None:
    keeper = "time kept by its server"
    left = player.Played(0.010, 0.001, 0, kept_by="board", late=0.002)
    right = player.Played(0.014, 0.001, 3, "off", late=0.004)
    _tell(player.PlayReport(1.5, {"left": left, "right": right}), ["left", "right"], dry_run=False)
    assert capsys.readouterr().out.splitlines() == [
        "left: moved 10.0 ms after the start, start known to 3.00 ms, time kept by its board",
        f"right: moved 14.0 ms after the start, start known to 5.00 ms, {keeper}, 3 stalls; arrived, off",
        "played 1.50 s on 2 arms; first movements within 4.0 ms (clocks: 2.00 ms); starts within 8.0 ms",
    ]
    still = player.Played(float("nan"), 0.001, 0)
    _tell(player.PlayReport(1.5, {"left": still}), ["left"], dry_run=False)
    assert capsys.readouterr().out.splitlines() == [
        f"left: did not move, start known to 1.00 ms, {keeper}",
        "played 1.50 s on 1 arm",
    ]


def test_a_program_is_told_the_same_in_seconds(capsys: pytest.CaptureFixture[str]) -> None:
    left = player.Played(0.010, 0.001, 0, kept_by="board", late=0.002)
    still = player.Played(float("nan"), 0.001, 3, "off")
    with printing_json(True):
        _tell(player.PlayReport(1.5, {"left": left, "still": still}), ["left", "still"], dry_run=False)
    assert json.loads(capsys.readouterr().out) == {
        "duration_s": 1.5,
        "dry_run": False,
        "skew_s": None,
        "starts_within_s": 0.004,
        "arms": [
            {
                "name": "left",
                "moved_s": 0.01,
                "clock_uncertainty_s": 0.001,
                "time_kept_by": "board",
                "start_uncertainty_s": 0.003,
                "stalls": 0,
                "off": "",
            },
            {
                "name": "still",
                "moved_s": None,
                "clock_uncertainty_s": 0.001,
                "time_kept_by": "host",
                "start_uncertainty_s": 0.001,
                "stalls": 3,
                "off": "off",
            },
        ],
    }


@pytest.fixture
def waypoints(tmp_path: Path) -> Path:
    """J1 there and back in a second."""
    points = [
        {"time_from_start": t, "positions": [angle], "velocities": [0.0]}
        for t, angle in ((0.0, 0.0), (0.5, 0.15), (1.0, 0.0))
    ]
    file = tmp_path / "way.json"
    file.write_text(json.dumps({"joint_names": ["J1"], "points": points}))
    return file


@pytest.fixture
def taught(tmp_path: Path) -> Path:
    """A recording of lab/arm1 and lab/other."""
    file = tmp_path / "taught.mcap"
    with RecordingWriter(file) as writer:
        for i in range(60):
            for name, way in (("lab/arm1", 0.1), ("lab/other", -0.1)):
                state = make_positions(("J1", "J2"), (way * i / 60, 0.9))
                writer.joint_state(state, 1.7e9 + i / 60, topic=topic_of(name))
    return file


@pytest.mark.slow
def test_what_is_recorded_can_be_shown_exported_and_played(serve: Serve, waypoints: Path, tmp_path: Path) -> None:
    for name in ("lab/arm1", "lab/arm2"):
        serve(name, robot="sim", lease=LEASE)
    file = tmp_path / "a.mcap"
    with hexwire_program("fleet", "record", file, "lab/*") as program:
        assert program.stderr is not None
        said = {program.stderr.readline().strip() for _ in range(2)}
        assert said == {"lab/arm1 recorded", "lab/arm2 recorded"}
        played = run("fleet", "play", waypoints, "--on", "lab/*", *DOUBT)
        assert played.exit_code == 0, (played.stderr, played.stdout)
        assert "played 1.00 s on 2 arms; first movements within" in played.stdout
        program.send_signal(signal.SIGINT)
        out, _ = program.communicate(timeout=30)
    assert program.returncode == 0
    assert out.splitlines()[-1] == f"recorded in {file}"
    topics = {row["topic"]: row for row in json.loads(run("record", "info", file, "--json").stdout)["topics"]}
    assert {"/fleet", "/lab/arm1/clock", "/lab/arm1/joint_states", "/lab/arm2/joint_states"} <= set(topics)
    assert topics["/lab/arm1/clock"]["schema"] == "hexwire.Clock"
    result = run("record", "export", file, tmp_path / "a.csv")
    assert (result.exit_code, "choose one with --arm" in result.stderr) == (2, True)
    for words in (("export", file, tmp_path / "b.csv"), ("plot", file, tmp_path / "b.svg")):
        result = run("record", *words, "--arm", "lab/arm3")
        assert (result.exit_code, f"{file} has no joint states of lab/arm3" in result.stderr) == (2, True)
        assert not words[-1].exists()
    assert run("record", "export", file, tmp_path / "a.csv", "--arm", "lab/arm1").exit_code == 0
    assert run("record", "plot", file, tmp_path / "a.svg", "--arm", "lab/arm2").exit_code == 0
    again = run("fleet", "play", file, "--on", "lab/arm1", "--speed", "2", "--dry-run", *DOUBT)
    assert again.exit_code == 0, again.stderr
    assert again.stderr == "not played: lab/arm2\n"
    assert "is allowed; nothing moved" in again.stdout


@pytest.mark.slow
def test_motions_are_mapped_to_arms(serve: Serve, taught: Path) -> None:
    serve("lab/arm1", robot="sim", lease=LEASE)
    serve("lab/arm2", robot="sim", lease=LEASE)
    result = run("fleet", "play", taught, "--on", "lab/*")
    assert (result.exit_code, "no motion for lab/arm2" in result.stderr) == (2, True)
    mapped = ("--on", "lab/arm1", "--map", "lab/other=lab/arm2")
    result = run("fleet", "play", taught, *mapped, "--json", *DOUBT)
    assert result.exit_code == 0, result.stderr
    done = json.loads(result.stdout)
    assert [row["name"] for row in done["arms"]] == ["lab/arm1", "lab/arm2"]
    assert done["duration_s"] == pytest.approx(59 / 60, abs=0.01)
    with registry.connect("zenoh:lab/arm1") as one, registry.connect("zenoh:lab/arm2") as two:
        assert one.read().positions["J1"] > 0.05
        assert two.read().positions["J1"] < -0.05


def test_one_arm_of_a_recording_can_be_played_alone(taught: Path) -> None:
    """As any other recording; which one must be said."""
    saved = taught.with_name("one.mcap")
    result = run("play", taught, "--save", saved)
    assert (result.exit_code, "lab/arm1, lab/other, ...): choose one with --arm" in result.stderr) == (2, True)
    assert run("play", taught, "--arm", "lab/other", "--save", saved).exit_code == 0
    result = run("play", taught, "--arm", "lab/none", "--save", saved)
    assert (result.exit_code, "no joint states of lab/none" in result.stderr) == (2, True)


@pytest.mark.parametrize(
    ("words", "said", "status"),
    [
        ((), "name the arms to move: --on 'lab/*'", 2),
        (("--on", "lab/*"), "no arm moved: no arm is served", 1),
        (("--map", "lab/a"), "write RECORDED=ARM", 2),
        (("--map", "a=b", "--map", "c=b"), "names b twice", 2),
        (("--map", "lab/arm1=lab/arm9"), "no arm moved: lab/arm9: no arm lab/arm9 is served", 1),
    ],
)
def test_what_is_missing_is_said(
    runtime: Path, taught: Path, words: tuple[str, ...], said: str, status: int
) -> None:
    result = run("fleet", "play", taught, *words)
    assert (result.exit_code, said in result.stderr) == (status, True), result.stderr


def test_nothing_is_left_of_a_recording_of_nobody(runtime: Path, tmp_path: Path) -> None:
    file = tmp_path / "a.mcap"
    result = run("fleet", "record", file, "--duration", "0.2")
    assert (result.exit_code, file.exists()) == (1, False)
    assert "nothing was recorded" in result.stderr
    assert run("fleet", "record", tmp_path / "a.csv").exit_code == 2


@pytest.mark.slow
def test_ctrl_c_stops_all_arms(serve: Serve, taught: Path) -> None:
    for name in ("lab/arm1", "lab/arm2"):
        serve(name, robot="sim", lease=LEASE)
    with registry.connect("zenoh:lab/arm1") as robot:
        words = ["fleet", "play", taught, "--map", "lab/arm1=lab/arm1", "--map", "lab/arm1=lab/arm2", *DOUBT]
        before = robot.read().positions["J2"]
        with hexwire_program(*words, "--speed", "0.1", program=PATIENT_PLAYER) as program:
            # The approach moves J2.
            eventually(lambda: abs(robot.read().positions["J2"] - before) > 0.05)
            program.send_signal(signal.SIGINT)
            _, said = program.communicate(timeout=30)
        assert program.returncode == 130
        assert "stop sent to all arms" in said
        eventually(lambda: robot.read().stopped)
    with registry.connect("zenoh:lab/arm2") as other:
        eventually(lambda: other.read().stopped)


def test_the_error_says_why_no_arm_is_found_behind_a_router(runtime: Path, taught: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    for words, said in (
        (("record", taught.with_name("none.mcap"), "--duration", "0.3"), "nothing was recorded: no arm is served"),
        (("play", taught, "--on", "lab/*"), "no arm moved: no arm is served"),
    ):
        result = run("fleet", *words, "--router", endpoint)
        last = result.stderr.splitlines()[-1]
        assert (result.exit_code, said in last) == (1, True), result.stderr
        assert last.count(f"nobody answers at {endpoint}") == 1
