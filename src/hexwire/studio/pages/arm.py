"""The page Arm: the arm in 3D, its joints, jog, motions to a goal, poses, teach and play.

Owns the arrangement of its parts, and that it follows what is open. Numbers at frame rate, drags and the 3D view
are in `static/arm.js`. Must not know other pages, nor decide about motion.
"""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

from hexwire.studio.geometry import make_geometry, make_turns
from hexwire.studio.layout import every, mount

from .arm_calls import ArmCalls
from .arm_goto import goto_html
from .arm_joints import joints_html, space_html, tip_html
from .arm_poses import gripper_html, poses_html
from .arm_teach import teach_html

if TYPE_CHECKING:
    from hexwire.studio.app import Studio
    from hexwire.studio.source import ArmSource

__all__ = ["arguments", "build", "page_html"]

_LOOK = 0.5
"""Seconds between two looks at what is open, and at what was taught."""


def build(studio: Studio) -> None:
    """Build the page."""
    from nicegui import ui

    ui.html("Arm", sanitize=False, tag="h1")
    place = ui.element("div")
    shown: tuple[str, ArmSource | None, str] | None = None
    calls: ArmCalls | None = None

    def follow() -> None:
        nonlocal shown, calls
        source = studio.source
        now = (source.mode, source.arm, source.error if source.arm is None else "")
        if now == shown:
            if calls is not None:
                calls.tell_changes()
            return
        shown, calls = now, None
        place.clear()
        with place:
            if now[1] is None:
                ui.html(_nothing(now[0], now[2]), sanitize=False)
                return
            body = ui.html(page_html(now[1], studio.emulated(now[1])), sanitize=False)
            calls = ArmCalls(studio, now[1], body)
            mount("arm.js", body, **arguments(now[1]))

    follow()
    every(_LOOK, follow)


def page_html(arm: ArmSource, emulated: str = "") -> str:
    """Everything below the heading; what moves is filled in by the browser.

    Args:
        arm: The open arm.
        emulated: What a person should know of an emulated arm; empty for others.
    """
    kinematics, model = arm.settings.kinematics, arm.settings.model
    left, right = [_view_html(kinematics is not None, emulated)], [joints_html(model)]
    if kinematics is not None:
        left += [tip_html(kinematics), space_html()]
    if arm.motions.jaws is not None:
        left.append(gripper_html())
    right += [goto_html(model, kinematics), poses_html(gripper=arm.motions.jaws is not None), teach_html()]
    return (
        f'<div class="arm-page">{_bar_html()}'
        f'<div class="arm-left">{"".join(left)}</div><div class="arm-right">{"".join(right)}</div></div>'
    )


def arguments(arm: ArmSource) -> dict[str, object]:
    """What `static/arm.js` is told about the arm."""
    kinematics, model, jaws = arm.settings.kinematics, arm.settings.model, arm.motions.jaws
    return {
        "geometry": make_geometry(model, arm.settings.links),
        "joints": [{"name": joint.name, "min": joint.minimum, "max": joint.maximum} for joint in model.joints],
        "table": arm.settings.table,
        "jaws": None if jaws is None else {"joint": jaws.joint, "closed": jaws.closed, "opened": jaws.opened},
        "turns": None if kinematics is None else make_turns(model, kinematics),
    }


def _bar_html() -> str:
    return """
<div class="arm-bar">
  <label for="arm-speed">Speed</label>
  <input id="arm-speed" type="range" min="1" max="100" value="30" step="1" aria-describedby="arm-speed-value">
  <output id="arm-speed-value" for="arm-speed">30 %</output>
  <span class="arm-hint" id="arm-hint" role="status"></span>
</div>"""


def _view_html(known: bool, emulated: str) -> str:
    view = '<div class="arm-view" id="arm-view"></div>'
    if not known:
        view = (
            '<p class="arm-note">The lengths of this arm are unknown, so it has no 3D view, no tip, '
            "and no jog in space.</p>"
        )
    if emulated:
        view += f'<p class="arm-note">{escape(emulated)}</p>'
    return f"""
<section class="arm-part arm-view-part" aria-label="View and motion">
  {view}
  <div class="arm-run" id="arm-run">
    <progress id="arm-run-bar" max="1" value="0" aria-label="Progress of the motion"></progress>
    <span id="arm-run-text" role="status">No motion</span>
    <button class="hw-button" id="arm-run-end" type="button" disabled>End motion</button>
  </div>
</section>"""


def _nothing(mode: str, error: str) -> str:
    if mode == "opening":
        return "<p>The arm is being opened.</p>"
    if mode == "bus":
        return (
            "<p>The servos are open one by one, without the arm around them. "
            'To move the arm as a whole, open it on <a href="/">Connect</a>.</p>'
        )
    problem = f'<p class="hw-bad">Not opened: {escape(error)}</p>' if error else ""
    words = 'Choose one on <a href="/">Connect</a>, or a servo bus on <a href="/servos">Servos</a>.'
    return f"{problem}<p>No arm is open. {words}</p>"
