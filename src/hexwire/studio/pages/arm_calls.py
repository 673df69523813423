"""What the page Arm asks of the server: previews, poses, teach mode.

Owns the calls by name, and their answers as values for JSON. Motion itself is held over the live socket, not asked
for here. Must not know HTML, nor decide about motion.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, Any

from hexwire.errors import HexwireError, UsageError

if TYPE_CHECKING:
    from nicegui.element import Element

    from hexwire.control.preview import Preview
    from hexwire.studio.app import Studio
    from hexwire.studio.source import ArmSource
    from hexwire.studio.tabs import Tab

__all__ = ["ArmCalls", "plan_values", "taught_values"]

_ROWS = 60
"""Most postures of a path that a browser is sent."""
_TAUGHT_ROWS = 400
"""Most rows of a taught motion that a browser is sent."""
_DIGITS = 5
_MOST_PLANS = 4
"""Previews of one page that may be planned at a time."""


class ArmCalls:
    """The calls of one tab.

    Args:
        studio: The studio.
        arm: The arm that the page shows.
        element: The page; its event ``hw-call`` carries a call.
    """

    def __init__(self, studio: Studio, arm: ArmSource, element: Element) -> None:
        self._studio, self._arm, self._tab = studio, arm, studio.tab()
        self._element = element
        self._told: tuple[object, ...] = ()
        self._planning = 0
        element.on("hw-call", self._on_call, args=["detail"])

    async def _on_call(self, event: Any) -> None:
        detail = event.args.get("detail") if isinstance(event.args, dict) else None
        if not isinstance(detail, dict) or not isinstance(detail.get("id"), int):
            return
        name, args = str(detail.get("name")), detail.get("args")
        values = args if isinstance(args, dict) else {}
        if name == "preview" and self._planning >= _MOST_PLANS:
            # Planning takes a while, in threads that other pages need, too.
            self._tell("answer", detail["id"], {"error": "this page asks for too many previews at a time"})
            return
        self._planning += name == "preview"
        try:
            call = partial(self.answer, name, values, self._tab)
            answer = await self._studio.run(call, computes=name == "preview")
        finally:
            self._planning -= name == "preview"
        self._tell("answer", detail["id"], answer if isinstance(answer, dict) else {"error": "the studio failed"})

    def answer(self, name: str, args: Mapping[str, object], tab: Tab) -> dict[str, object]:
        """Answer one call; what is refused is an ``error`` in words. Blocks.

        Args:
            name: ``preview``, ``poses``, ``save``, ``rename``, ``remove``, ``teach`` or ``taught``.
            args: Its values.
            tab: Who asks.
        """
        call = self._table().get(name)
        if call is None:
            return {"error": f"there is no call {name[:20]!r}"}
        try:
            return call(args, tab)
        except HexwireError as error:
            return {"error": str(error)}

    def tell_changes(self) -> None:
        """Tell the page when teach mode or the taught motion has changed; called now and then."""
        motions = self._arm.motions
        now = (motions.teaching, motions.taught)
        if now != self._told:
            self._told = now
            self._tell("taught", self._taught({}, self._tab))

    # -- the calls ----------------------------------------------------------------------------------------

    def _table(self) -> Mapping[str, Callable[[Mapping[str, object], Tab], dict[str, object]]]:
        return {
            "preview": self._preview,
            "poses": self._poses,
            "save": self._save,
            "rename": self._rename,
            "remove": self._remove,
            "teach": self._teach,
            "taught": self._taught,
        }

    def _preview(self, args: Mapping[str, object], tab: Tab) -> dict[str, object]:
        return plan_values(self._arm.motions.preview(args), self._arm)

    def _poses(self, args: Mapping[str, object], tab: Tab) -> dict[str, object]:
        return {"poses": [asdict(row) for row in self._arm.motions.pose_rows()]}

    def _save(self, args: Mapping[str, object], tab: Tab) -> dict[str, object]:
        self._studio.need_control(tab)
        name, gripper, force = _text(args, "name"), args.get("gripper", True), args.get("force", False)
        self._arm.motions.save_pose(name, gripper=gripper is True, force=force is True)
        return self._poses(args, tab)

    def _rename(self, args: Mapping[str, object], tab: Tab) -> dict[str, object]:
        self._studio.need_control(tab)
        self._arm.motions.poses.rename(_text(args, "name"), _text(args, "new"))
        return self._poses(args, tab)

    def _remove(self, args: Mapping[str, object], tab: Tab) -> dict[str, object]:
        self._studio.need_control(tab)
        self._arm.motions.poses.remove(_text(args, "name"))
        return self._poses(args, tab)

    def _teach(self, args: Mapping[str, object], tab: Tab) -> dict[str, object]:
        self._studio.need_control(tab)
        text = self._arm.motions.teach(self._arm.order(tab), args.get("on") is True)
        return {"text": text}

    def _taught(self, args: Mapping[str, object], tab: Tab) -> dict[str, object]:
        return taught_values(self._arm)

    def _tell(self, what: str, *values: object) -> None:
        rows = ", ".join(json.dumps(value, allow_nan=False) for value in values)
        with self._element:
            from nicegui import ui

            ui.run_javascript(f"window.hexwireArm && window.hexwireArm.{what}({rows})")


def plan_values(plan: Preview, arm: ArmSource) -> dict[str, object]:
    """A preview for the browser: angles in radians, lengths in metres.

    ``goal`` has all joints whose position at the end is known; ``trace`` are places of the tip along the path.
    """
    path, kinematics = plan.path, arm.settings.kinematics
    names = list(path.names) if path is not None else list(plan.goal)
    ends = dict(zip(path.names, path.goal, strict=True)) if path is not None else {}
    state = arm.arm.owner.state
    here = {} if state is None else state.positions
    goal = {**here, **ends, **plan.goal}
    rows = plan.rows(_ROWS)
    trace: list[list[float]] = []
    if kinematics is not None and rows and set(kinematics.joint_names) <= set(names):
        for row in rows:
            angles = kinematics.from_joints(dict(zip(names, row, strict=True)))
            if all(map(math.isfinite, angles)):
                trace.append(_rounded(kinematics.forward(angles).position))
    return {
        "goal": {name: round(angle, _DIGITS) for name, angle in goal.items() if math.isfinite(angle)},
        "known": bool(plan.goal),
        "duration": plan.duration,
        "lead_in": plan.lead_in,
        "tip": None if plan.tip is None else asdict(plan.tip),
        "branch": plan.branch,
        "branches": [asdict(branch) for branch in plan.branches],
        "refusal": plan.refusal,
        "unready": plan.unready,
        "trace": trace,
    }


def taught_values(arm: ArmSource) -> dict[str, object]:
    """Teach mode and the taught motion for the browser; a long one with fewer rows."""
    motions = arm.motions
    taught = motions.taught
    values: dict[str, object] = {"teaching": motions.teaching, "taught": None}
    if taught is not None:
        n = len(taught.times)
        step = max(1, math.ceil(n / _TAUGHT_ROWS))
        places = [*range(0, n - 1, step), n - 1]
        values["taught"] = {
            "names": list(taught.names),
            "duration": taught.duration,
            "times": [round(taught.times[i], 3) for i in places],
            "rows": [_rounded(taught.rows[i]) for i in places],
        }
    return values


def _rounded(values: Any) -> list[float]:
    return [round(value, _DIGITS) for value in values]


def _text(args: Mapping[str, object], name: str) -> str:
    value = args.get(name)
    if not isinstance(value, str):
        raise UsageError(f"{name} must be a text")
    return value
