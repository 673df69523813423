"""The part of the page Arm for teach mode and for playing what was taught.

Owns its HTML. Must not know how a motion is recorded or played; `static/arm_teach.js` draws the timeline.
"""

from __future__ import annotations

__all__ = ["teach_html"]

_FACTORS = ((0.25, "¼"), (0.5, "½"), (1.0, "1"), (1.5, "1½"), (2.0, "2"))


def teach_html() -> str:
    """Teach mode, the timeline of the taught motion, and playing it."""
    factors = "".join(
        f'<option value="{factor}"{" selected" if factor == 1.0 else ""}>{words} ×</option>'
        for factor, words in _FACTORS
    )
    return f"""
<section class="arm-part" aria-labelledby="arm-teach-title">
  <h2 id="arm-teach-title">Teach and play</h2>
  <div class="hw-row">
    <label><input type="checkbox" id="arm-teach-hand"> I hold the arm: it will sink</label>
    <button class="hw-button arm-need" id="arm-teach-start" type="button" disabled>Start teaching</button>
    <button class="hw-button arm-need" id="arm-teach-stop" type="button" hidden>End teaching: hold here</button>
  </div>
  <p class="arm-note" id="arm-teach-note" role="status">Teaching switches torque off and records how you move the
  arm by hand.</p>
  <div id="arm-taught" hidden>
    <div class="arm-time">
      <canvas id="arm-time-plot" aria-hidden="true"></canvas>
      <input id="arm-time" type="range" min="0" max="1" step="any" value="0" aria-label="Time in the taught motion">
    </div>
    <div class="hw-row">
      <output id="arm-time-value" for="arm-time">0.0 s</output>
      <label class="arm-field arm-inline"><span>Speed</span><select id="arm-factor">{factors}</select></label>
      <button class="hw-button arm-primary arm-need arm-whole" id="arm-play" type="button">Play</button>
      <button class="hw-button arm-need arm-whole" id="arm-play-here" type="button">Play from here</button>
    </div>
    <p class="arm-plan" id="arm-play-plan" role="status"></p>
  </div>
</section>"""
