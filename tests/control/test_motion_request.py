from __future__ import annotations

import contextlib
import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.control.requests.motion_service import read_motion
from hexwire.errors import UsageError
from hexwire.model.aim import Aim

PLACE = {"what": "place", "position": [0.1, 0.2, 0.3]}


def test_joints() -> None:
    request = read_motion({"what": "joints", "goals": {"J1": 0.5, "J2": 1}, "speed": 0.7})
    assert (request.goals, request.speed) == ({"J1": 0.5, "J2": 1.0}, 0.7)


def test_a_place_is_as_plain_as_it_is_given() -> None:
    place = read_motion(PLACE).place
    assert (place.position, place.aim, place.relative, place.straight, place.branch) == (
        (0.1, 0.2, 0.3), Aim(), False, False, "",
    )  # fmt: skip
    more = read_motion({**PLACE, "relative": True, "straight": True, "branch": "front, elbow up"}).place
    assert (more.relative, more.straight, more.branch) == (True, True, "front, elbow up")


@pytest.mark.parametrize(
    ("given", "aim"),
    [
        ({"aim": "arm"}, Aim()),
        ({"aim": "space"}, Aim(fixed=True)),
        ({"aim": "down"}, Aim(down=True)),
        ({"aim": "rpy", "rpy": [0.1, 0.2, 0.3], "pitch": 1}, Aim(rpy=(0.1, 0.2, 0.3))),
        ({"aim": "pitch", "pitch": 0.4}, Aim(pitch=0.4)),
        ({"aim": "pitch", "pitch": 0.4, "roll": 0.0}, Aim(pitch=0.4, roll=0.0)),
        ({"aim": "down", "rpy": None}, Aim(down=True)),
    ],
)
def test_where_the_tool_points(given: dict[str, Any], aim: Aim) -> None:
    assert read_motion({**PLACE, **given}).place.aim == aim


def test_pose_gripper_and_taught_motion() -> None:
    assert read_motion({"what": "pose", "name": "home"}).name == "home"
    assert read_motion({"what": "grip", "share": 0.25}).share == 0.25
    whole = read_motion({"what": "play"})
    assert (whole.begin, whole.end, whole.factor, whole.speed) == (0.0, math.inf, 1.0, 0.3)
    part = read_motion({"what": "play", "begin": 1, "end": 2.5, "factor": 0.5})
    assert (part.begin, part.end, part.factor) == (1.0, 2.5, 0.5)


@pytest.mark.parametrize(
    ("args", "error"),
    [
        ({}, "what is missing"),
        ({"what": "fly"}, "what must be one of joints, place, pose, step, grip, play, not the text 'fly'"),
        ({"what": ["place"]}, r"what must be one of joints, .*, not the list \['place'\]"),
        ({"what": "pose", "name": "a", "share": 1}, "share is an unknown key; known: what, name, speed"),
        ({"what": "pose", "nme": "a"}, "nme is an unknown key, did you mean name"),
        ({"what": "joints"}, "goals is missing"),
        ({"what": "joints", "goals": {}}, "goals must name 1 to 253 joints"),
        ({"what": "joints", "goals": {"J1": "1"}}, r"goals\.J1 must be a number, not the text '1'"),
        ({"what": "joints", "goals": {"J1": math.inf}}, r"goals\.J1 must be a finite number"),
        ({"what": "joints", "goals": {"J1": 90 * 12}}, r"goals\.J1 is 1080, but must be -1000 to 1000 rad"),
        ({"what": "joints", "goals": dict.fromkeys(map(str, range(300)), 0.0)}, "goals must name 1 to 253 joints"),
        ({"what": "place"}, "position is missing"),
        ({"what": "place", "position": [1, 2]}, "position has 2 values, but must have 3"),
        ({**PLACE, "position": [1, 2, None]}, r"position\[2\] must be a number, not nothing"),
        ({**PLACE, "position": [1, 2, 1e200]}, r"position\[2\] is 1e.200, but must be -1000 to 1000 m"),
        ({**PLACE, "aim": "up"}, "aim must be one of arm, space, down, rpy, pitch, not the text 'up'"),
        ({**PLACE, "aim": ["rpy"]}, "aim must be one of"),
        ({**PLACE, "aim": "rpy"}, "rpy is missing"),
        ({**PLACE, "aim": "pitch"}, "pitch is missing"),
        ({**PLACE, "aim": "pitch", "pitch": None}, "pitch must be a number, not nothing"),
        ({**PLACE, "relative": 1}, "relative must be true or false, not 1"),
        ({**PLACE, "branch": 3}, "branch must be text, not 3"),
        ({"what": "pose"}, "name is missing"),
        ({"what": "pose", "name": "x" * 101}, "name has 101 characters, but must have 0 to 100"),
        ({"what": "grip"}, "share is missing"),
        ({"what": "grip", "share": None}, "share must be a number, not nothing"),
        ({"what": "play", "factor": True}, "factor must be a number, not true"),
        ({"what": "play", "speed": math.nan}, "speed must be a finite number"),
    ],
)
def test_a_malformed_request_names_the_value(args: dict[str, object], error: str) -> None:
    with pytest.raises(UsageError, match=error):
        read_motion(args)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=4),
    max_leaves=8,
)
KEYS = st.sampled_from(["what", "position", "aim", "rpy", "pitch", "roll", "goals", "name", "share", "factor", "x"])


@given(st.dictionaries(KEYS, JSON | st.sampled_from(["place", "joints", "pose", "grip", "play"]), max_size=6))
def test_anything_else_is_a_usage_error(args: dict[str, object]) -> None:
    with contextlib.suppress(UsageError):
        read_motion(args)
