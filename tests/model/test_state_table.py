"""A state as a table in a notebook; the terminal's is in tests/cli/test_state.py."""

from __future__ import annotations

import math
import re
from dataclasses import replace

from hexwire.model.state import JointFlag, JointState

ON, SILENT = int(JointFlag.TORQUE_ON), int(JointFlag.SILENT | JointFlag.TORQUE_UNKNOWN)


def rows(state: JointState) -> list[list[str]]:
    html = state._repr_html_()
    return [re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row) for row in re.findall(r"<tr>(.*?)</tr>", html)]


def test_a_notebook_shows_what_is_known() -> None:
    state = JointState.of({"a": 0.5, "b": -0.25}, stamp=1.0, flags=(ON, SILENT), voltage=(7.4, float("nan")))
    assert rows(state) == [
        ["joint", "deg", "V", "age ms", "torque", "condition"],
        ["a", "28.65", "7.4", "0", "on", "ok"],
        ["b", "-14.32", "-", "0", "-", "no answer"],
    ]
    assert state._repr_html_().endswith("</table>")


def test_a_stopped_arm_says_so_below_its_table() -> None:
    state = replace(JointState.of({"a": 0.0}, stamp=1.0), stopped=True)
    assert state._repr_html_().endswith("</table><p>stopped; &#x27;hexwire resume&#x27; ends the stop</p>")


def test_a_name_is_text() -> None:
    state = JointState.of({"<b>": 0.0}, stamp=1.0)
    assert rows(state)[1][0] == "&lt;b&gt;"


def test_at_the_prompt_a_state_is_one_line() -> None:
    state = JointState.of({"a": math.radians(-4.5), "b": math.nan}, stamp=0.0, torque=True)
    assert repr(state) == "<JointState: a -4.5, b - deg; torque on: a b>"
    assert repr(replace(state, stopped=True)).endswith("torque on: a b; stopped; 'hexwire resume' ends the stop>")
