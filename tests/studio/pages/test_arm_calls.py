"""What the page Arm asks of the server, without a browser."""

from __future__ import annotations

import asyncio
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.studio.running import until

from hexwire.control.pose_file import PoseFile, home_pose
from hexwire.motion.teach import Taught
from hexwire.studio.access import Access, Right
from hexwire.studio.app import Studio
from hexwire.studio.pages.arm_calls import ArmCalls, taught_values


class Page:
    """Stands in for the element of the page."""

    def on(self, *args: object, **more: object) -> None:
        """Nothing comes."""


class Desk:
    """A studio with an open arm, and a tab that has control."""

    def __init__(self, folder: Path) -> None:
        self.studio = Studio(Access(frozenset()))
        self.arm = self.studio.source.open("sim://hex7bot?name=calls", watchdog=5.0)
        self.arm.motions.poses = PoseFile(self.arm.settings.model, folder)
        until(lambda: self.arm.arm.owner.state is not None, "a state")
        self.tab = self.studio.tabs.open("s", Right.OPERATE)
        self.studio.source.take(self.tab)
        self.studio.tab = lambda: self.tab  # type: ignore[method-assign]  # without a page there is no client
        self.calls = ArmCalls(self.studio, self.arm, Page())  # type: ignore[arg-type]  # no events come

    def ask(self, call: str, /, **args: Any) -> Any:
        answer = self.calls.answer(call, args, self.tab)
        # What a browser gets.
        return json.loads(json.dumps(answer, allow_nan=False))


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    made = Desk(tmp_path)
    yield made
    made.studio.close()


def test_a_preview_has_all_that_is_drawn(desk: Desk) -> None:
    plan = desk.ask("preview", what="place", position=[0.05, 0.2, 0.18])
    assert plan["refusal"] == ""
    assert "no torque" in plan["unready"]
    assert set(plan["goal"]) == set(desk.arm.settings.model.names)
    assert plan["known"]
    assert plan["duration"] > 0.1
    assert plan["branch"] in [branch["name"] for branch in plan["branches"]]
    assert 10 < len(plan["trace"]) <= 61
    assert plan["trace"][-1] == pytest.approx([0.05, 0.2, 0.18], abs=1e-4)
    refused = desk.ask("preview", what="place", position=[0.05, 0.9, 0.18])
    assert "out of reach" in refused["refusal"]
    assert (refused["known"], refused["trace"]) == (False, [])


def test_what_is_malformed_is_an_answer_too(desk: Desk) -> None:
    assert "no motion" in desk.ask("preview", what="fly")["error"]
    assert "no call 'format'" in desk.ask("format")["error"]
    assert "name must be a text" in desk.ask("save", name=3)["error"]
    assert "no pose 'x'" in desk.ask("remove", name="x")["error"]


def test_poses_are_saved_renamed_and_removed(desk: Desk) -> None:
    (home,) = desk.ask("poses")["poses"]
    assert (home["name"], home["saved"]) == ("home", False)
    assert home["angles"] == home_pose(desk.arm.settings.model)
    (_, row) = desk.ask("save", name="a")["poses"]
    assert (row["name"], row["saved"], set(row["angles"])) == ("a", True, set(desk.arm.settings.model.names))
    assert "already" in desk.ask("save", name="a")["error"]
    (_, row) = desk.ask("save", name="a", force=True, gripper=False)["poses"]
    assert "J7" not in row["angles"]
    assert [row["name"] for row in desk.ask("rename", name="a", new="b")["poses"]] == ["home", "b"]
    assert desk.ask("remove", name="b") == {"poses": [home]}


def test_without_control_nothing_is_changed(desk: Desk) -> None:
    desk.studio.source.leave(desk.tab)
    calls: dict[str, dict[str, Any]] = {
        "save": {"name": "a"},
        "rename": {"name": "a", "new": "b"},
        "remove": {"name": "a"},
        "teach": {"on": True},
    }
    for call, args in calls.items():
        assert "does not have control" in desk.ask(call, **args)["error"]
    assert [row["name"] for row in desk.ask("poses")["poses"]] == ["home"]
    assert not desk.arm.motions.teaching


def test_teach_mode_begins_and_ends(desk: Desk) -> None:
    assert "no torque" in desk.ask("teach", on=True)["text"]
    assert desk.ask("taught") == {"teaching": True, "taught": None}
    until(lambda: "text" in desk.ask("teach", on=False) or not desk.arm.motions.teaching, "the end")
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


def test_a_page_that_asks_for_too_many_previews_keeps_nobody_waiting(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[tuple[object, ...]] = []
    monkeypatch.setattr(desk.calls, "_tell", lambda *what: told.append(what))
    free = asyncio.Event()
    asked = 0

    async def run(call: object, *, computes: bool) -> dict[str, object]:
        nonlocal asked
        asked += 1
        assert computes
        await free.wait()
        return {}

    monkeypatch.setattr(desk.studio, "run", run)

    class Event:
        def __init__(self, number: int) -> None:
            self.args = {"detail": {"id": number, "name": "preview"}}

    async def flood() -> None:
        calls = [asyncio.create_task(desk.calls._on_call(Event(number))) for number in range(100)]
        while len(told) < 96:
            await asyncio.sleep(0)
        assert asked == 4
        assert told[0] == ("answer", 4, {"error": "this page asks for too many previews at a time"})
        free.set()
        await asyncio.gather(*calls)
        # What is no preview is not refused, and a later preview is not, either.
        await desk.calls._on_call(Event(100))

    asyncio.run(flood())
    assert asked == 5
