"""The part of the page Arm for motions to a place or to joint angles, with a preview.

Owns its HTML. Must not know how a motion is planned; `static/arm_goto.js` asks for previews and begins it.
"""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hexwire.model.arm import ArmModel
    from hexwire.model.kinematics import KinematicModel

__all__ = ["goto_html", "number_field"]


def number_field(name: str, words: str, unit: str, *, step: str = "1") -> str:
    """A labelled number; `name` is unique on the page."""
    return (
        f'<label class="arm-field"><span>{escape(words)} <span class="arm-unit">{unit}</span></span>'
        f'<input type="number" inputmode="decimal" step="{step}" name="{escape(name, quote=True)}"></label>'
    )


def goto_html(arm: ArmModel, kinematics: KinematicModel | None) -> str:
    """The form: to a place if the arm's geometry is known, to joint angles always."""
    kinds = '<label><input type="radio" name="what" value="joints" checked> Joint angles</label>'
    place = ""
    if kinematics is not None:
        kinds = (
            '<label><input type="radio" name="what" value="place" checked> Place of the tip</label>'
            '<label><input type="radio" name="what" value="joints"> Joint angles</label>'
        )
        place = _place_html(five=len(kinematics.ranges) == 5)
    joints = "".join(number_field(f"joint:{joint.name}", joint.name, "°", step="any") for joint in arm.joints)
    return f"""
<section class="arm-part" aria-labelledby="arm-goto-title">
  <h2 id="arm-goto-title">Go to</h2>
  <form id="arm-goto" class="arm-form" autocomplete="off">
    <div class="arm-choices" role="radiogroup" aria-label="Kind of goal">{kinds}</div>
    {place}
    <div class="arm-fields" data-for="joints"{" hidden" if place else ""}>{joints}</div>
    <p class="arm-plan" id="arm-plan" role="status">These are the present values. Change one to see a preview.</p>
    <div class="hw-row">
      <button class="hw-button arm-primary arm-need arm-whole" type="submit" id="arm-go">Go</button>
      <button class="hw-button" type="button" id="arm-here">Take present values</button>
      <button class="hw-button" type="button" id="arm-unghost" hidden>Hide preview</button>
    </div>
  </form>
  <p class="arm-note">A motion runs while this page is in sight. It ends with STOP, Escape or End motion, and when
  the page is hidden, closed, or loses its connection.</p>
</section>"""


def _place_html(*, five: bool) -> str:
    aims = (
        '<option value="arm">keeps its angle to the arm</option><option value="space">keeps its direction</option>'
    )
    aims += '<option value="down">points straight down</option>'
    if five:
        aims += '<option value="pitch">has a pitch and a roll</option>'
        turns = number_field("pitch", "Pitch", "°", step="any") + number_field("roll", "Roll", "°", step="any")
        turns = f'<div class="arm-fields" data-aim="pitch" hidden>{turns}</div>'
    else:
        aims += '<option value="rpy">has roll, pitch and yaw</option>'
        turns = "".join(number_field(name, name.capitalize(), "°", step="any") for name in ("roll", "pitch", "yaw"))
        turns = f'<div class="arm-fields" data-aim="rpy" hidden>{turns}</div>'
    places = "".join(number_field(axis, axis, "mm", step="any") for axis in "xyz")
    return f"""
    <div data-for="place" class="arm-form">
      <div class="arm-fields">{places}</div>
      <div class="arm-choices">
        <label><input type="checkbox" name="relative"> from the present tip</label>
        <label><input type="checkbox" name="straight"> on a straight line</label>
      </div>
      <div class="arm-fields">
        <label class="arm-field arm-long"><span>The tool</span><select name="aim">{aims}</select></label>
        <label class="arm-field arm-long" id="arm-branch-field" hidden><span>Solution</span>
          <select name="branch"><option value="">nearest</option></select></label>
      </div>
      {turns}
    </div>"""
