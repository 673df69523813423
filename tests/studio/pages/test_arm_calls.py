"""What the page Move asks of the server, without a browser."""

from __future__ import annotations

import asyncio
import json
import math
import re
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from tests.studio.running import until
from tests.waits import eventually

from hexwire.arm.recorded import read_taught, write_taught
from hexwire.control.requests.pose_file import PoseFile, home_pose
from hexwire.control.requests.program import read_program
from hexwire.errors import HexwireError, LeaseError, UsageError
from hexwire.motion.teach import Taught
from hexwire.studio.access import Access, Right
from hexwire.studio.app import Studio
from hexwire.studio.arm_calls import taught_values
from hexwire.studio.tabs import Tab


class Desk:
    """A studio with an open arm, and a tab that has control."""

    def __init__(self, folder: Path) -> None:
        self.studio = Studio(Access(frozenset()), folder / "recordings")
        self.arm = self.studio.source.open("sim://hex7bot?name=calls", watchdog=5.0)
        self.arm.motions.poses = PoseFile(self.arm.settings.model, folder)
        until(lambda: self.arm.arm.owner.state is not None, "a state")
        self.tab = self.studio.tabs.open("s", Right.OPERATE)
        self.studio.source.take(self.tab)

    def ask(self, call: str, /, **args: Any) -> Any:
        """The answer, from an arm that has just answered: on a busy machine, it has not for a moment."""

        def asked() -> list[Any]:
            try:
                answer = asyncio.run(self.studio.call(self.tab, f"arm.{call}", args))
            except HexwireError as error:
                return [] if "no state from the robot" in str(error) else [{"error": str(error)}]
            # What a browser gets.
            return [json.loads(json.dumps(answer, allow_nan=False))]

        return eventually(asked)[0]


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    made = Desk(tmp_path)
    yield made
    made.studio.close()


def test_a_preview_has_all_that_is_drawn(desk: Desk) -> None:
    plan = desk.ask("preview", motion={"what": "place", "position": [0.05, 0.2, 0.18]})
    assert plan["refusal"] == ""
    assert "no torque" in plan["unready"]
    assert set(plan["goal"]) == set(desk.arm.settings.model.names)
    assert plan["known"]
    assert plan["duration"] > 0.1
    assert plan["branch"] in [branch["name"] for branch in plan["branches"]]
    assert 10 < len(plan["trace"]) <= 61
    assert plan["trace"][-1] == pytest.approx([0.05, 0.2, 0.18], abs=1e-4)
    refused = desk.ask("preview", motion={"what": "place", "position": [0.05, 0.9, 0.18]})
    assert "out of reach" in refused["refusal"]
    assert (refused["known"], refused["trace"]) == (False, [])


def test_what_is_malformed_is_an_answer_too(desk: Desk) -> None:
    assert "what must be one of joints" in desk.ask("preview", motion={"what": "fly"})["error"]
    assert "no call 'arm.format'" in desk.ask("format")["error"]
    assert "Expected `str`, got `int` - at `$.name`" in desk.ask("save_pose", name=3)["error"]
    assert "no pose 'x'" in desk.ask("remove_pose", name="x")["error"]


def test_poses_are_saved_renamed_and_removed(desk: Desk) -> None:
    (home,) = desk.ask("poses")
    assert (home["name"], home["saved"]) == ("home", False)
    assert home["angles"] == home_pose(desk.arm.settings.model)
    (_, row) = desk.ask("save_pose", name="a")
    assert (row["name"], row["saved"], set(row["angles"])) == ("a", True, set(desk.arm.settings.model.names))
    assert "already" in desk.ask("save_pose", name="a")["error"]
    (_, row) = desk.ask("save_pose", name="a", force=True, gripper=False)
    assert "J7" not in row["angles"]
    assert [row["name"] for row in desk.ask("rename_pose", name="a", new="b")] == ["home", "b"]
    assert desk.ask("remove_pose", name="b") == [home]


def test_without_control_nothing_is_changed(desk: Desk) -> None:
    desk.studio.source.leave(desk.tab)
    calls: dict[str, dict[str, Any]] = {
        "save_pose": {"name": "a"},
        "rename_pose": {"name": "a", "new": "b"},
        "remove_pose": {"name": "a"},
        "teach": {"on": True},
    }
    for call, args in calls.items():
        assert "does not have control" in desk.ask(call, **args)["error"]
    assert [row["name"] for row in desk.ask("poses")] == ["home"]
    assert not desk.arm.motions.teaching


def test_teach_mode_begins_and_ends(desk: Desk) -> None:
    assert "no torque" in desk.ask("teach", on=True)
    assert desk.ask("taught") == {"teaching": True, "taught": None}
    until(lambda: "error" not in desk.ask("teach", on=False) or not desk.arm.motions.teaching, "the end")
    assert desk.ask("taught")["teaching"] is False


def test_a_long_taught_motion_is_sent_with_fewer_rows(desk: Desk) -> None:
    times = tuple(0.02 * i for i in range(3001))
    rows = tuple((math.sin(t), 0.0) for t in times)
    desk.arm.arm.teach_mode.taught = Taught(("J1", "J2"), times, rows)
    values: Any = taught_values(desk.arm)
    taught = values["taught"]
    assert len(taught["times"]) == len(taught["rows"]) <= 401
    assert (taught["times"][0], taught["times"][-1], taught["duration"]) == (0.0, 60.0, 60.0)
    assert taught["rows"][-1] == pytest.approx(rows[-1], abs=1e-4)


def test_a_timeline_is_smoothed_cut_and_kept_as_a_new_recording(desk: Desk, tmp_path: Path) -> None:
    folder = tmp_path / "recordings"
    rows = tuple((0.002 * (i % 2) + 0.01 * i,) for i in range(101))
    jagged = Taught(("J1",), tuple(i / 50 for i in range(101)), rows)
    desk.studio.recordings.library.make_folder()
    write_taught(jagged, folder / "wave.mcap")
    assert desk.ask("recordings") == ["wave.mcap"]
    assert "nothing was taught" in desk.ask("timeline", motion={})["error"]
    plain = desk.ask("timeline", motion={"recording": "wave.mcap"})
    assert (plain["names"], plain["duration"], len(plain["rows"])) == (["J1"], pytest.approx(2.0), 101)
    smooth = desk.ask("timeline", motion={"recording": "wave.mcap", "smooth": 0.2})
    assert (smooth["rows"][0], smooth["rows"][-1]) == (plain["rows"][0], plain["rows"][-1])
    assert smooth["rows"][50][0] == pytest.approx(0.501, abs=2e-4)

    # What is kept is what would be played; nothing is replaced by the way.
    part = {"recording": "wave.mcap", "begin": 0.5, "end": 1.5, "smooth": 0.2, "factor": 0.5}
    assert desk.ask("preview", motion={"what": "play", **part})["duration"] > 2.0
    assert desk.ask("save_taught", name="part", motion=part) == ["part.mcap", "wave.mcap"]
    assert read_taught(str(folder / "part.mcap")).duration == pytest.approx(2.0, abs=1e-3)
    was = (folder / "wave.mcap").read_bytes()
    assert "exists" in desk.ask("save_taught", name="wave", motion=part)["error"]
    assert (folder / "wave.mcap").read_bytes() == was
    assert desk.ask("save_taught", name="wave", motion=part, force=True) == ["part.mcap", "wave.mcap"]
    assert desk.ask("timeline", motion={"recording": "wave.mcap"})["duration"] == pytest.approx(2.0, abs=1e-3)
    for wrong, said in (
        ({"begin": 9.0}, "nothing is left"),
        ({"begin": 1.0, "end": 0.5}, "nothing is left"),
        ({"smooth": 1e9}, "must be 0 to 2 s"),
        ({"smooth": -1.0}, "must be 0 to 2 s"),
        ({"factor": 1e-300}, "0.1 to 4 times"),
        ({"factor": "fast"}, "factor must be a number"),
        ({"recording": "missing.mcap"}, "no recording 'missing.mcap'"),
        ({"recording": "../wave.mcap"}, "cannot be the name of a recording"),
    ):
        for call, more in (("save_taught", {"name": "other"}), ("preview", {}), ("timeline", {})):
            motion: dict[str, object] = {"what": "play", "recording": "wave.mcap"} | wrong
            if call != "timeline" or not {"begin", "end", "factor"} & wrong.keys() or said.endswith("number"):
                assert re.search(said, desk.ask(call, motion=motion, **more)["error"]), (call, wrong)
    for name in ("../x", "", "a/b", "x" * 200, "a\0b"):
        assert "cannot be the name" in desk.ask("save_taught", name=name, motion=part)["error"], name
    assert desk.ask("recordings") == ["part.mcap", "wave.mcap"]
    # Who only watches has none read, which a motion of somebody else would wait for.
    watcher = desk.studio.tabs.open("w", Right.WATCH)
    steps = [{"play": "wave.mcap"}]
    for call, given in (
        ("save_taught", {"name": "a", "motion": part}),
        ("timeline", {"motion": part}),
        ("preview", {"motion": {"what": "play", **part}}),
        ("recordings", {}),
        ("check_program", {"steps": steps}),
    ):
        with pytest.raises(LeaseError, match="watching only"):
            asyncio.run(desk.studio.call(watcher, f"arm.{call}", given))


def test_a_page_that_asks_for_too_many_previews_keeps_nobody_waiting(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    free = threading.Event()
    asked: list[object] = []

    def preview(motion: object, *, taught: object) -> object:
        asked.append(motion)
        free.wait(30)
        raise UsageError("enough")

    monkeypatch.setattr(desk.arm.motions, "preview", preview)
    other = desk.studio.tabs.open("s", Right.WATCH)

    async def flood() -> None:
        def ask(tab: Tab) -> asyncio.Task[object]:
            return asyncio.create_task(desk.studio.call(tab, "arm.preview", {"motion": {}}))

        calls = [ask(desk.tab) for _ in range(100)]
        await asyncio.sleep(0)
        refused = [str(call.exception()) for call in calls if call.done()]
        assert refused == ["this browser asks for too much at a time; try again"] * 96
        # What is no preview is not refused, nor is a preview of another page.
        poses = await desk.studio.call(desk.tab, "arm.poses", {})
        assert isinstance(poses, list)
        calls.append(ask(other))
        free.set()
        await asyncio.gather(*calls, return_exceptions=True)

    asyncio.run(flood())
    assert len(asked) == 5


def test_an_arm_that_lacks_something_says_so(desk: Desk) -> None:
    whole = desk.ask("values")
    assert (whole["space"], whole["jaws"]["joint"], whole["emulated"]) == (6, "J7", "")
    assert [joint["name"] for joint in whole["joints"]] == list(desk.arm.settings.model.names)
    desk.arm.settings = replace(desk.arm.settings, kinematics=None)
    desk.arm.motions.jaws = None
    poor = desk.ask("values")
    assert (poor["space"], poor["turns"], poor["jaws"]) == (None, None, None)


STEPS = [
    {"pose": "home", "speed": 0.5},
    {
        "repeat": 2,
        "steps": [{"joints": {"J1": 20.0}, "speed": 1.0}, {"ask": "go on?"}, {"joints": {"J1": 0.0}, "speed": 1.0}],
    },
    {"place": [0.0, 200.0, 180.0], "line": True, "speed": 0.3},
    {"wait": 1.5},
]


def test_a_program_is_kept_as_a_file_that_the_command_runs_too(desk: Desk, tmp_path: Path) -> None:
    assert desk.ask("programs") == []
    assert desk.ask("save_program", name="pick", steps=STEPS) == ["pick"]
    assert desk.ask("program", name="pick") == STEPS
    assert read_program(tmp_path / "recordings" / "pick.toml").rows() == STEPS
    # What somebody else has saved meanwhile is not overwritten by the way.
    assert "exists" in desk.ask("save_program", name="pick", steps=STEPS[:1])["error"]
    assert desk.ask("save_program", name="pick", steps=STEPS[:1], force=True) == ["pick"]
    assert desk.ask("program", name="pick") == STEPS[:1]
    for name in ("../x", "", ".x", "a/b", "x" * 200, "a\0b"):
        for call, more in (("save_program", {"steps": STEPS}), ("program", {}), ("remove_program", {})):
            assert "cannot be the name of a program" in desk.ask(call, name=name, **more)["error"], name
    assert "cannot be read" in desk.ask("program", name="missing")["error"]
    assert desk.ask("remove_program", name="pick") == []
    assert "cannot be removed" in desk.ask("remove_program", name="pick")["error"]
    watcher = desk.studio.tabs.open("w", Right.WATCH)
    with pytest.raises(HexwireError):
        asyncio.run(desk.studio.call(watcher, "arm.save_program", {"name": "a", "steps": STEPS}))


def test_a_program_is_checked_as_a_whole_and_nothing_moves(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    # Each plan asks for a state that is fresh: on a busy machine, not all of hundreds find one.
    monkeypatch.setattr("hexwire.control.requests.program._MOST_CHECKED", 10)
    owner = desk.arm.arm.owner
    before = eventually(lambda: owner.state).positions
    rows = desk.ask("check_program", steps=STEPS)
    # What is repeated is planned once from each place where it begins.
    assert [row["number"] for row in rows] == ["1", "2.1", "2.3", "2.1", "3"]
    assert all(row["refusal"] == "" for row in rows)
    assert rows[1]["duration"] > 0.05
    # A step that is allowed by itself, but not from where the one before it ends.
    away = [{"joints": {"J1": 60.0}}, {"place": [0.0, 0.0, -120.0], "relative": True, "line": True}]
    refused = desk.ask("check_program", steps=[*away, {"wait": 1}])
    assert (len(refused), refused[1]["number"]) == (2, "2")
    assert refused[1]["refusal"]
    # From any step, which begins where the arm is.
    assert [row["number"] for row in desk.ask("check_program", steps=[*away, {"grip": 0.0}], first=3)] == ["3"]
    assert "there is no step 9" in desk.ask("check_program", steps=away, first=9)["error"]
    for steps, said in (
        ([{"pose": "nowhere"}], "step 1: no pose 'nowhere'"),
        ([{"play": "missing.mcap"}], "missing.mcap"),
        ([{"fly": 1}], "must have one of pose"),
        ([], "at least 1|1 to 500"),
        ([{"repeat": 11, "steps": [{"place": [0.0, 0.0, 0.1], "relative": True}]}], "too many to be checked"),
    ):
        assert re.search(said, desk.ask("check_program", steps=steps)["error"]), steps
    assert eventually(lambda: owner.state).positions == pytest.approx(before, abs=1e-3)
