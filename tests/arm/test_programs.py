"""Programs: checked as a whole, run from any step, ended by whatever ends a motion.

`test_torque_off` asks of every kind of arm that torque off voids what is left; a step is a motion as of any verb.
"""

from __future__ import annotations

import math
import tempfile
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from tests.arm.arms import connected, marked
from tests.recorded import make_positions
from tests.waits import PATIENCE, eventually

from hexwire import Arm, deg
from hexwire.arm.front import Front
from hexwire.errors import ConfigError, HexwireError, LimitError, StoppedError, UsageError
from hexwire.trace.recording import RecordingWriter


@pytest.fixture(scope="module", params=marked(("board", "bus", "shared board", "timed board")))
def arm(request: pytest.FixtureRequest) -> Iterator[Arm]:
    """Arms whose host sends the targets, on a board, a bus and behind a server, and one whose board does it all."""
    with tempfile.TemporaryDirectory(prefix="hw") as folder, connected(request.param, Path(folder)) as arm:
        yield arm


@pytest.fixture
def folder() -> Path:
    return Path(tempfile.mkdtemp(prefix="hw"))


def written(folder: Path, *steps: str) -> Path:
    file = folder / "program.toml"
    file.write_text("speed = 1\n" + "\n".join(f"[[steps]]\n{step}" for step in steps))
    return file


def turned(arm: Arm, degrees: float) -> str:
    """A step that turns the first joint to so many degrees from its middle."""
    joint = arm.model.joints[0]
    return f"joints = {{ {joint.name} = {math.degrees(joint.offset) + degrees:.3f} }}"


def first(arm: Arm) -> float:
    """Degrees of the first joint from its middle."""
    return math.degrees(arm.read().position[0] - arm.model.joints[0].offset)


def test_the_steps_are_run_in_their_order_and_from_any_of_them(arm: Arm, folder: Path) -> None:
    arm.home()
    with arm.record(folder / "way.mcap") as way:
        arm.move({arm.model.names[0]: deg(6)}, relative=True)
    assert way is not None
    asked: list[tuple[str, float]] = []
    file = written(
        folder,
        turned(arm, 8),
        'ask = "one"',
        f"repeat = 2\n[[steps.steps]]\n{turned(arm, 4)}\n[[steps.steps]]\nask = 'again'",
        'play = "way.mcap"',
        'ask = "played"',
        'pose = "home"',
        "wait = 0.01",
    )
    result = arm.play(file, ask=lambda text: asked.append((text, first(arm))))
    assert result.arrived
    assert [text for text, _ in asked] == ["one", "again", "again", "played"]
    assert [degrees for _, degrees in asked] == pytest.approx([8, 4, 4, 6], abs=2)
    assert abs(first(arm)) < 2
    asked.clear()
    arm.play(file, step=5, repeat=2, ask=lambda text: asked.append((text, first(arm))))
    assert [text for text, _ in asked] == ["played", "one", "again", "again", "played"]


def test_a_pause_takes_its_seconds(arm: Arm, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    slept: list[float] = []
    options = replace(arm._front.options, clock=lambda: sum(slept), sleep=slept.append)
    monkeypatch.setattr(arm, "_front", replace(arm._front, options=options))
    times: list[float] = []
    file = written(folder, 'ask = "before"', "wait = 20", 'ask = "after"')
    arm.play(file, ask=lambda text: times.append(sum(slept)))
    assert times == [0.0, pytest.approx(20.0)]


def test_what_is_wrong_with_any_step_is_said_before_the_first_one_begins(arm: Arm, folder: Path) -> None:
    arm.home()
    before = arm.read().positions
    joint = arm.model.joints[0]
    beyond = math.degrees(joint.maximum) + 5
    for step, kind, said in (
        (f"joints = {{ {joint.name} = {beyond} }}", LimitError, r"^step 2\.1: .*outside its limits"),
        ("joints = { nothing = 1 }", UsageError, r"^step 2\.1: .*nothing"),
        ('pose = "nowhere"', UsageError, r"^step 2\.1: no pose 'nowhere'"),
        ('play = "missing.mcap"', UsageError, "missing.mcap"),
        ("place = [0, 0, 5000]\naim = 'arm'", HexwireError, r"^step 2\.1: "),
    ):
        file = written(folder, turned(arm, 10), f"repeat = 3\n[[steps.steps]]\n{step}")
        with pytest.raises(kind, match=said):
            arm.play(file)
    with pytest.raises(ConfigError, match=r"program\.toml:3:1: steps\[0\]\.poes|must have one of"):
        arm.play(written(folder, 'poes = "home"'))
    with pytest.raises(UsageError, match="there is no step 3: the program has 2"):
        arm.play(written(folder, turned(arm, 10), turned(arm, 0)), step=3)
    with pytest.raises(UsageError, match="waits for a person"):
        arm.play(written(folder, turned(arm, 10), "ask = 'x'"))
    with pytest.raises(UsageError, match="for motions"):
        arm.play(written(folder, turned(arm, 10)), factor=2.0)
    assert arm.read().positions == pytest.approx(before, abs=deg(1))


def test_a_step_is_checked_from_where_those_before_it_end(folder: Path) -> None:
    def joint(name: str, degrees: float) -> str:
        return f"joints = {{ {name} = {math.degrees(arm.model.joint(name).offset) + degrees:.3f} }}"

    with connected("board", folder) as arm:
        arm.home()
        checked = Arm(arm.driver, front=Front(dry_run=True))
        with pytest.raises(LimitError, match=r"^step 2: .*elbow"):
            checked.play(written(folder, joint("J2", 60), joint("J3", 60)))
        checked.play(written(folder, joint("J2", 60), joint("J2", 0), joint("J3", 60)))


def test_a_recording_that_is_too_fast_is_offered_at_the_speed_that_fits(arm: Arm, folder: Path) -> None:
    arm.home()
    joint = arm.model.joints[0]
    with RecordingWriter(folder / "way.mcap") as writer:
        for i, degrees in enumerate((0, 10, 0)):
            state = make_positions((joint.name,), (joint.offset + deg(degrees),))
            writer.joint_state(state, 1.7e9 + 0.05 * i)
    with pytest.raises(
        LimitError, match=r"would turn .*: factor=(0\.\d+), or fit=True; nothing was sent$"
    ) as refused:
        arm.play(folder / "way.mcap")
    with pytest.raises(LimitError, match=r"^step 1: .*: factor = 0\.\d+, or fit = true; nothing was sent$"):
        arm.play(written(folder, 'play = "way.mcap"'))
    fits = float(str(refused.value).partition("factor=")[2].partition(",")[0])
    assert arm.play(folder / "way.mcap", factor=fits).arrived
    assert arm.play(written(folder, 'play = "way.mcap"\nfit = true')).arrived


@pytest.mark.parametrize("where", ["a motion", "a pause", "a question"])
def test_a_stop_at_any_step_voids_those_that_are_left(arm: Arm, folder: Path, where: str) -> None:
    arm.home()
    reached, release = threading.Event(), threading.Event()
    steps = {
        "a motion": turned(arm, 35) + "\nspeed = 0.02",
        "a pause": "wait = 3000",
        "a question": 'ask = "go on?"',
    }
    file = written(folder, 'ask = "begun"', steps[where], turned(arm, 20))

    def ask(text: str) -> None:
        reached.set()
        if text == "go on?":
            release.wait(PATIENCE)

    motion = arm.play(file, ask=ask, wait=False)
    assert reached.wait(PATIENCE)
    if where == "a motion":
        eventually(lambda: abs(first(arm)) > 0.5)
    arm.stop()
    before = first(arm)
    release.set()
    with pytest.raises(StoppedError, match=r"resume\(\)"):
        motion.wait(PATIENCE)
    arm.resume()
    assert first(arm) == pytest.approx(before, abs=2)
    assert arm.home().arrived


@pytest.mark.parametrize("where", ["a motion", "a pause"])
def test_a_program_can_be_cancelled_and_nothing_of_it_is_latched(arm: Arm, folder: Path, where: str) -> None:
    arm.home()
    step = "wait = 3000" if where == "a pause" else turned(arm, 35) + "\nspeed = 0.02"
    motion = arm.play(written(folder, turned(arm, 4), step, turned(arm, 35)), wait=False)
    eventually(lambda: first(arm) > (3 if where == "a pause" else 6))
    with pytest.raises(UsageError, match="is in motion"):
        arm.home()
    result = motion.cancel()
    assert (result.cut, result.stopped) == (True, None)
    assert 2 < first(arm) < 30
    assert arm.home().arrived
