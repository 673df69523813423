"""`hexwire follow`, on emulated arms."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result
from tests.control.swing import Swing
from tests.defaults import default
from tests.few import few
from tests.waits import PATIENCE

from hexwire.cli.main import cli
from hexwire.control.motion import following
from hexwire.control.motion.following import Pair, run_following
from hexwire.emulator.hand import HandOrder
from hexwire.emulator.serve_hand import move_by_hand
from hexwire.errors import LinkLostError
from hexwire.trace.capture import CapturedMessage, read_messages
from hexwire.trace.recording import JOINT_STATES

LEADER, FOLLOWER = "sim://so101?leader=1&name=follow_lead", "sim://so101?name=follow_follow"


def run(*words: str) -> Result:
    return CliRunner().invoke(cli, ["follow", *words])


@pytest.mark.parametrize(
    ("words", "status", "text"),
    [
        (("a",), 2, "give a LEADER and a FOLLOWER for each pair"),
        (("a", "a"), 2, "an arm is named twice"),
        (("so101@/none/a", "so100@/none/a"), 2, "an arm is named twice"),
        (("a", "b", "--meet", "2"), 2, "--meet must be at most 1"),
        (("a", "b", "--grip", "101"), 2, "--grip must be at most 100"),
        ((LEADER, FOLLOWER, "--max-speed", "400"), 2, "reaches 312 degrees a second, not 400"),
        (("so101@/none/a", "so101@/none/b"), 1, "/none/a does not exist"),
        ((LEADER, "sim://hex7bot"), 2, "so101 cannot lead hex7bot: it has no J1"),
        (("--leader", "a", "--follower", "b"), 2, "No such option '--leader'"),
        (("a", "b", "--leader", "c"), 2, "No such option '--leader'"),
        (("a", "b", "--table", "5", "--no-table"), 2, "--table and --no-table contradict each other"),
        (("none.toml@/none/a", "so101@/none/b"), 2, "none.toml"),
    ],
)
def test_mistakes(words: tuple[str, ...], status: int, text: str) -> None:
    result = run(*words)
    assert (result.exit_code, text in result.stderr) == (status, True), result.stderr
    assert result.stderr.count("\n") == 1


def test_options_before_the_command() -> None:
    result = CliRunner().invoke(cli, ["--port", "/none/c", "follow", "/none/a", "/none/b"])
    assert result.exit_code == 2
    assert "name the ports as LEADER and FOLLOWER" in result.stderr
    result = CliRunner().invoke(cli, ["--robot", "nobody", "follow", "/none/a", "/none/b"])
    assert result.exit_code == 2
    assert "nobody" in result.stderr


@pytest.mark.parametrize("option", ["--record", "--record-ros2"])
def test_the_followers_of_two_pairs_are_recorded_apart(
    option: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each on a topic of its own, named by its arm, with its own description."""

    def read_once(pair: Pair, *_: Any, **__: Any) -> None:
        pair.leader.read()
        pair.follower.read()

    monkeypatch.setattr(following, "run_following", read_once)
    for name, base in (("left", "so101"), ("right-1", "so100"), ("right.1", "so101")):
        (tmp_path / f"{name}.toml").write_text(f'name = "{name}"\nbase = "{base}"\n')
    file = tmp_path / "recording"
    arms: list[str] = []
    for name in ("left", "right-1", "right.1"):
        arms += [f"sim://so101?leader=1&name=lead_{name[-1]}{len(name)}{len(arms)}"]
        arms += [f"{tmp_path}/{name}.toml@sim://so101?name=two_{len(arms)}"]
    result = CliRunner().invoke(cli, [option, str(file), "follow", *arms])
    assert result.exit_code == 0, result.output
    if option == "--record-ros2":
        file = next(file.glob("*.mcap"))
    with file.open("rb") as opened:
        messages = [message for message in read_messages(opened, "it") if isinstance(message, CapturedMessage)]
    topics = {message.topic for message in messages if message.topic.endswith(f"/{JOINT_STATES[1:]}")}
    assert topics == {"/left/joint_states", "/right_1/joint_states", "/right_1_2/joint_states"}
    if option == "--record-ros2":
        urdf = {m.topic.split("/")[1]: m.data for m in messages if m.topic.endswith("/robot_description")}
        assert {arm: b'<robot name="so100"' in data for arm, data in urdf.items()} == {
            "left": False,
            "right_1": True,
            "right_1_2": False,
        }


def test_a_fault_of_one_pair_ends_all_and_is_the_error(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[bool] = []

    def one_fails(pair: Pair, rate: float, *, ended: threading.Event, **_: Any) -> None:
        if "fails" in pair.follower.url:
            raise LinkLostError("the cable of one is out")
        seen.append(ended.wait(PATIENCE))

    monkeypatch.setattr(following, "run_following", one_fails)
    arms = [f"sim://so101?name=all_{name}" for name in ("a", "b", "c", "fails")]
    result = run(*arms)
    assert (result.exit_code, result.stderr) == (1, "error: the cable of one is out\n")
    assert seen == [True]


@few(
    "words, late",
    [([], 0.1), (["--max-speed", "180"], 14.0), (["--max-acceleration", "500"], 80.0)],
    (["--max-speed", "180"], 14.0),
    (["--max-acceleration", "500"], 80.0),
)
def test_it_follows_as_fast_as_its_servos_can_or_may(
    words: list[str], late: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    swing = Swing(1.0)
    arms = {"lead": swing.leader, "follow": swing.follower}
    monkeypatch.setattr("hexwire.cli.teleop._make", lambda text, *_, **__: arms[text])
    default(monkeypatch, run_following, sleep=swing.sleep)
    result = run("lead", "follow", "--no-table", *words)
    assert result.exit_code == 130 or isinstance(result.exception, KeyboardInterrupt | SystemExit), result.output
    assert 0.5 * late - 0.1 < swing.late < late
    assert ("shoulder_pan is led" in result.stderr) == bool(words)


@pytest.mark.system
def test_a_follower_follows_until_ctrl_c() -> None:
    command = [sys.executable, "-m", "hexwire.cli", "follow", LEADER, FOLLOWER]
    program = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        assert program.stderr is not None
        assert program.stderr.readline() == f"{FOLLOWER} follows {LEADER}; Ctrl-C ends it, and it holds\n"
        assert "if this program dies" in program.stderr.readline()
        moved = move_by_hand(LEADER, HandOrder("shoulder_pan", 20.0, 0.3, 0.2, 0.6))
        assert moved.moved > 19.0
        assert "met the leader" in program.stderr.readline()
        program.send_signal(signal.SIGINT)
        assert program.wait(30.0) == 130
    finally:
        program.kill()
        program.wait()
        if program.stderr is not None:
            program.stderr.close()
