"""The parts of the page Arm for joints and jog: joint table with sliders, jog in space, pose of the tip.

Owns their HTML. Must not know what moves an arm, nor how a slider works (`static/arm_joints.js`).
"""

from __future__ import annotations

import math
from html import escape
from typing import TYPE_CHECKING

from hexwire.units import decimal

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel, JointModel
    from hexwire.model.kinematics import KinematicModel

__all__ = ["joints_html", "space_html", "tip_html"]


def joints_html(arm: ArmModel) -> str:
    """The joint table: limits, sliders, jog buttons; positions are filled in by the browser."""
    rows = "".join(_row(i, joint) for i, joint in enumerate(arm.joints))
    return f"""
<section class="arm-part arm-joints-part" aria-labelledby="arm-joints-title">
  <h2 id="arm-joints-title">Joints</h2>
  <table class="arm-joints">
    <thead><tr>
      <th scope="col">Joint</th><th scope="col">Jog and drag</th>
      <th scope="col" class="arm-number">Position&nbsp;°</th>
      <th scope="col" class="arm-number arm-wide">Goal&nbsp;°</th>
      <th scope="col" class="arm-number arm-wide">Load&nbsp;%</th><th scope="col" class="arm-wide">State</th>
    </tr></thead>
    <tbody>{rows}</tbody>
  </table>
  <p class="arm-note">A joint moves while its button is pressed, its marker is dragged, or an arrow key is held on
  its slider. Letting go stops it.</p>
</section>"""


def _row(i: int, joint: JointModel) -> str:
    name = escape(joint.name, quote=True)
    low, high = _degrees(joint.minimum), _degrees(joint.maximum)
    colour = f"var(--joint-{i % 8 + 1})"
    return f"""
<tr data-joint="{name}" style="--colour: {colour}">
  <th scope="row"><span class="arm-swatch"></span>{name}</th>
  <td><div class="arm-drive">
    <button class="hw-button arm-jog arm-need" type="button" data-turn="-1" aria-label="Jog {name} down">−</button>
    <div class="arm-slider" role="slider" tabindex="0" aria-label="{name}" aria-orientation="horizontal"
      aria-valuemin="{low}" aria-valuemax="{high}" aria-valuenow="0" aria-valuetext="unknown">
      <span class="arm-track"></span><span class="arm-aim" hidden></span><span class="arm-thumb"></span>
      <span class="arm-end arm-low">{_minus(low)}</span><span class="arm-end arm-high">{_minus(high)}</span>
    </div>
    <button class="hw-button arm-jog arm-need" type="button" data-turn="1" aria-label="Jog {name} up">+</button>
  </div></td>
  <td class="arm-number" data-value="position">–</td><td class="arm-number arm-wide" data-value="goal">–</td>
  <td class="arm-number arm-wide" data-value="load">–</td><td class="arm-wide" data-value="state">–</td>
</tr>"""


def _degrees(angle: float) -> str:
    """Degrees with one decimal where it counts."""
    return decimal(round(math.degrees(angle), 1))


def _minus(number: str) -> str:
    return number.replace("-", "−")


def tip_html(kinematics: KinematicModel) -> str:
    """The pose of the tip, filled in by the browser."""
    rows = [("x", "x", "mm"), ("y", "y", "mm"), ("z", "z", "mm")]
    rows += [("roll", "roll", "°"), ("pitch", "pitch", "°"), ("yaw", "yaw", "°")]
    if len(kinematics.ranges) == 5:
        rows = [*rows[:3], ("toolpitch", "pitch", "°"), ("toolroll", "roll", "°")]
    cells = "".join(
        f'<div><dt>{words} <span class="arm-unit">{unit}</span></dt><dd data-tip="{key}">–</dd></div>'
        for key, words, unit in rows
    )
    return f"""
<section class="arm-part" aria-labelledby="arm-tip-title">
  <h2 id="arm-tip-title">Tip</h2>
  <dl class="arm-tip hw-live">{cells}</dl>
</section>"""


_MOVES = (("x", 0), ("y", 1), ("z", 2))


def space_html() -> str:
    """Buttons that move the tip along the axes of the base, and turn the tool about them."""
    cells = ""
    for what, words, first in (("along", "Move", 0), ("about", "Turn", 3)):
        cells += (
            f'<div class="arm-axes" role="group" aria-label="{words}"><span class="arm-axes-name">{words}</span>'
        )
        for axis, i in _MOVES:
            cells += (
                f'<span class="arm-axis arm-axis-{axis}">'
                + _axis_button(first + i, -1, f"{words} {what} {axis}, minus")
                + f"<span>{axis}</span>"
                + _axis_button(first + i, 1, f"{words} {what} {axis}, plus")
                + "</span>"
            )
        cells += "</div>"
    return f"""
<section class="arm-part" aria-labelledby="arm-space-title">
  <h2 id="arm-space-title">Jog in space</h2>
  <div class="arm-space">{cells}</div>
  <p class="arm-note">In the frame of the base, while a button is pressed.</p>
</section>"""


def _axis_button(place: int, turn: int, label: str) -> str:
    return (
        f'<button class="hw-button arm-jog arm-need arm-whole" type="button" data-axis="{place}" '
        f'data-turn="{turn}" aria-label="{label}">{"+" if turn > 0 else "−"}</button>'
    )
