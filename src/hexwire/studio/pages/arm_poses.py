"""The parts of the page Arm for poses by name, and for the gripper.

Owns their HTML. Must not know where poses are kept; `static/arm_poses.js` shows and changes them.
"""

from __future__ import annotations

__all__ = ["gripper_html", "poses_html"]


def poses_html(*, gripper: bool) -> str:
    """The list of poses, filled in by the browser, and saving a new one."""
    with_gripper = ""
    if gripper:
        with_gripper = '<label><input type="checkbox" name="gripper" checked> with the gripper</label>'
    return f"""
<section class="arm-part" aria-labelledby="arm-poses-title">
  <h2 id="arm-poses-title">Poses</h2>
  <ul class="arm-poses" id="arm-poses" aria-label="Saved poses"></ul>
  <form id="arm-pose-form" class="hw-row" autocomplete="off">
    <label class="arm-field arm-long"><span>Name</span>
      <input type="text" name="name" maxlength="40" required></label>
    {with_gripper}
    <button class="hw-button arm-need arm-whole" type="submit">Save present pose</button>
  </form>
  <p class="arm-note" id="arm-pose-note" role="status"></p>
</section>"""


def gripper_html() -> str:
    """Opening and closing, and how far it is open."""
    return """
<section class="arm-part" aria-labelledby="arm-grip-title">
  <h2 id="arm-grip-title">Gripper</h2>
  <form id="arm-grip" class="hw-row" autocomplete="off">
    <span class="arm-grip-now"><meter id="arm-grip-bar" min="0" max="1" value="0" aria-label="Opening"></meter>
      <output id="arm-grip-value">–</output></span>
    <button class="hw-button arm-need" type="button" data-share="0">Close</button>
    <button class="hw-button arm-need" type="button" data-share="1">Open</button>
    <label class="arm-field arm-inline"><span>Opening <span class="arm-unit">%</span></span>
      <input type="number" inputmode="decimal" name="share" min="0" max="100" step="any" value="50"></label>
    <button class="hw-button arm-need" type="submit">Set</button>
  </form>
  <p class="arm-note">Closing stops at an object and keeps a little pressure on it.</p>
</section>"""
