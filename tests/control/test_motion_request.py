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
        ({}, "no motion 'None'; there are joints, place"),
        ({"what": "fly"}, "no motion 'fly'"),
        ({"what": ["place"]}, "no motion"),
        ({"what": "pose", "name": "a", "share": 1}, "a motion of kind pose has no value 'share'"),
        ({"what": "joints"}, "goals must name"),
        ({"what": "joints", "goals": {}}, "goals must name"),
        ({"what": "joints", "goals": {"J1": "1"}}, "goal of J1 must be a number"),
        ({"what": "joints", "goals": {"J1": math.inf}}, "goal of J1 is inf"),
        ({"what": "joints", "goals": dict.fromkeys(map(str, range(300)), 0.0)}, "goals must name"),
        ({"what": "place"}, "position must be three numbers"),
        ({"what": "place", "position": [1, 2]}, "position must be three numbers"),
        ({**PLACE, "position": [1, 2, None]}, "position must be a number"),
        ({**PLACE, "position": [1, 2, 1e200]}, "position has 1e.200, which no arm reaches"),
        ({**PLACE, "aim": "up"}, "no aim 'up'"),
        ({**PLACE, "aim": ["rpy"]}, "no aim"),
        ({**PLACE, "aim": "rpy"}, "rpy must be three numbers"),
        ({**PLACE, "aim": "pitch"}, "pitch must be a number"),
        ({**PLACE, "relative": 1}, "relative must be true or false"),
        ({**PLACE, "branch": 3}, "branch must be a short text"),
        ({"what": "pose"}, "name must be a short text"),
        ({"what": "pose", "name": "x" * 101}, "name must be a short text"),
        ({"what": "grip"}, "share must be a number"),
        ({"what": "play", "factor": True}, "factor must be a number"),
        ({"what": "play", "speed": math.nan}, "speed is nan"),
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
