"""The format of programs: what is written is read again, what is wrong is named, and nothing is unbounded."""

from __future__ import annotations

import math
from itertools import count
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.control.motion.via import Place
from hexwire.control.requests.motion_service import MotionRequest
from hexwire.control.requests.program import Move, Program, check_program, parse_program
from hexwire.errors import ConfigError, UsageError
from hexwire.inputs import Item, parse_toml
from hexwire.model.aim import Aim


def parsed(text: str) -> Program:
    return parse_program(parse_toml(text, "p.toml"))


SPEED = st.floats(0.01, 1.0)
DEGREES = st.floats(-360.0, 360.0)
THREE = st.tuples(DEGREES, DEGREES, DEGREES).map(list)
NAME = st.text(st.characters(categories=["L", "N"]), min_size=1, max_size=20)
TRUE = st.just(True)
AIM = st.one_of(
    st.just({}),
    st.fixed_dictionaries({"aim": st.sampled_from(["arm", "space", "down"])}),
    st.fixed_dictionaries({"rpy": THREE}),
    st.fixed_dictionaries({"pitch": DEGREES}, optional={"roll": DEGREES}),
)
PLACE = st.fixed_dictionaries({"place": THREE}, optional={"relative": TRUE, "line": TRUE, "branch": NAME})
PLAY = st.fixed_dictionaries(
    {"play": NAME.map("{}.mcap".format)},
    optional={
        "from": st.floats(0, 10),
        "to": st.floats(10, 20),
        "smooth": st.floats(0, 2),
        "factor": st.floats(0.1, 4),
        "fit": TRUE,
    },
)
MOTIONS = st.one_of(
    st.fixed_dictionaries({"pose": NAME}),
    st.fixed_dictionaries({"joints": st.dictionaries(NAME, DEGREES, min_size=1, max_size=4)}),
    st.builds(lambda place, aim: place | aim, PLACE, AIM),
    st.fixed_dictionaries({"grip": st.floats(0, 100)}),
    PLAY,
)
LEAVES = st.one_of(
    st.builds(lambda row, speed: {**row, "speed": speed}, MOTIONS, SPEED),
    st.fixed_dictionaries({"wait": st.floats(0, 100)}),
    st.fixed_dictionaries({"ask": NAME}),
)
ROWS: st.SearchStrategy[dict[str, Any]] = st.recursive(
    LEAVES,
    lambda rows: st.fixed_dictionaries(
        {"repeat": st.integers(1, 3), "steps": st.lists(rows, min_size=1, max_size=3)}
    ),
    max_leaves=5,
)


def near(a: object, b: object) -> bool:
    """Equal, but for the rounding of what is written, to eight digits or six decimals."""
    if isinstance(a, float) and isinstance(b, int | float):
        return math.isclose(a, b, rel_tol=1e-7, abs_tol=1e-6)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(near, a, b))
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(near(a[key], b[key]) for key in a)
    return a == b


def depth(rows: list[dict[str, Any]]) -> int:
    return 1 + max((depth(row["steps"]) for row in rows if "steps" in row), default=0)


@given(st.lists(ROWS, min_size=1, max_size=6))
def test_what_is_written_is_read_again(rows: list[dict[str, Any]]) -> None:
    item = Item({"steps": rows})
    if depth(rows) > 4:
        with pytest.raises(ConfigError, match="repeats in more than 3"):
            parse_program(item)
        return
    program = parse_program(item)
    assert program.rows() == rows
    again = parsed(program.serialize())
    assert near(rows, again.rows()), program.serialize()
    assert parsed(again.serialize()) == again


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "steps is missing"),
        ("steps = []", "at least 1|1 to 500"),
        ("steps = 3", "steps must be a list"),
        ("speed = 2\nsteps = [{wait = 1}]", r"1:9: speed is 2, but must be 0.01 to 1"),
        ("steps = [{}]", r"steps\[0\] must have one of pose"),
        ("steps = [{wait = 1, ask = 'x'}]", "this has wait and ask"),
        ("steps = [{wait = 1, speed = 1}]", "speed is an unknown key"),
        ("steps = [{wait = nan}]", "must be a finite number"),
        ("steps = [{wait = 1e9}]", "must be 0 to 3600 s"),
        ("steps = [{ask = ''}]", "must have 1 to 200"),
        ("steps = [{pose = 'a\"b'}]", "has a character that a name cannot have"),
        ("steps = [{joints = {}}]", r"1:9: steps\[0\].joints must name 1 to 253 joints"),
        ("steps = [{play = 'a', smooth = 3}]", r"steps\[0\].smooth is 3, but must be 0 to 2 s"),
        ("steps = [{play = 'a', fit = 1}]", "fit must be true or false"),
        ("steps = [{joints = {J1 = 1e5}}]", "-3600 to 3600 deg"),
        ("steps = [{place = [1, 2]}]", "has 2 values, but must have 3"),
        ("steps = [{place = [1, 2, 1e6]}]", "must be -10000 to 10000 mm"),
        ("steps = [{place = [1, 2, 3], aim = 'up'}]", "aim must be one of arm, space, down, not the text 'up'"),
        ("steps = [{place = [1, 2, 3], aim = 'down', pitch = 3}]", "both aim the tool"),
        ("steps = [{place = [1, 2, 3], roll = 3}]", "roll needs a pitch"),
        ("steps = [{place = [1, 2, 3], line = 1}]", "line must be true or false"),
        ("steps = [{grip = 101}]", "must be 0 to 100 percent"),
        ("steps = [{play = '../x.mcap'}]", "without a path"),
        ("steps = [{play = '/etc/passwd'}]", "without a path"),
        ("steps = [{repeat = 2}]", "steps is missing"),
        ("steps = [{repeat = 0, steps = [{wait = 1}]}]", "must be 1 to 10000"),
        ("steps = [{repeat = 10000, steps = [{repeat = 9999, steps = [{wait = 1}]}]}]", "more than 10000 steps"),
        ("steps = [" + "{wait = 1}," * 501 + "]", "501 values"),
        ("steps = [{repeat = 1, steps = [" + "{wait = 1}," * 499 + "]}, {wait = 1}]", "more than 500 in all"),
    ],
)
def test_what_is_wrong_is_named(text: str, said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        parsed(text)


def test_it_is_run_from_any_step_and_again_from_the_first() -> None:
    program = parsed("steps = [{wait = 1}, {repeat = 2, steps = [{wait = 2}, {ask = 'x'}]}, {wait = 3}]")
    numbers = [number for number, _ in program.run_from()]
    assert numbers == ["1", "2.1", "2.2", "2.1", "2.2", "3"]
    assert [number for number, _ in program.run_from(3, 2)] == ["3", *numbers]
    for first in (0, 4):
        with pytest.raises(UsageError, match=f"there is no step {first}"):
            list(program.run_from(first))
    assert program.asks
    assert not parsed("steps = [{wait = 1}]").asks


@pytest.mark.parametrize(
    ("row", "request_"),
    [
        ("pose = ' home '", MotionRequest("pose", name="home")),
        ("joints = {J1 = 180, J2 = -90.0}", MotionRequest("joints", goals={"J1": math.pi, "J2": -math.pi / 2})),
        ("grip = 50, speed = 1", MotionRequest("grip", 1.0, share=0.5)),
        ("place = [0, 250, -500]", MotionRequest("place", place=Place((0.0, 0.25, -0.5)))),
        (
            "place = [0, 0, 500], relative = true, line = true, branch = 'elbow up', aim = 'down'",
            MotionRequest("place", place=Place((0.0, 0.0, 0.5), Aim(down=True), True, True, "elbow up")),
        ),
        ("place = [0, 0, 0], aim = 'arm'", MotionRequest("place")),
        ("place = [0, 0, 0], aim = 'space'", MotionRequest("place", place=Place((0.0, 0.0, 0.0), Aim(fixed=True)))),
        (
            "place = [0, 0, 0], rpy = [0, 90, 180]",
            MotionRequest("place", place=Place((0.0, 0.0, 0.0), Aim(rpy=(0.0, math.pi / 2, math.pi)))),
        ),
        (
            "place = [0, 0, 0], pitch = 90",
            MotionRequest("place", place=Place((0.0, 0.0, 0.0), Aim(pitch=math.pi / 2))),
        ),
        (
            "place = [0, 0, 0], pitch = 90, roll = 180",
            MotionRequest("place", place=Place((0.0, 0.0, 0.0), Aim(pitch=math.pi / 2, roll=math.pi))),
        ),
        ("play = 'a.mcap'", MotionRequest("play")),
        (
            "play = 'a.mcap', from = 1, to = 9, smooth = 0.5, factor = 2, fit = true",
            MotionRequest("play", begin=1.0, end=9.0, smooth=0.5, factor=2.0, fit=True),
        ),
    ],
)
def test_units_are_those_of_people(row: str, request_: MotionRequest) -> None:
    (step,) = parsed(f"steps = [{{{row}}}]").steps
    assert isinstance(step, Move)
    assert step.request == request_
    assert step.file == ("a.mcap" if "play" in row else "")


def test_a_step_without_a_speed_has_that_of_the_file() -> None:
    program = parsed("speed = 0.5\nsteps = [{grip = 1}, {grip = 2, speed = 0.7}]")
    assert [row["speed"] for row in program.rows()] == [0.5, 0.7]
    assert [step.request.speed for step in program.steps if isinstance(step, Move)] == [0.5, 0.7]


def test_its_recordings_are_in_its_folder() -> None:
    program = Program(parsed("steps = [{play = 'a.mcap'}, {play = 'a.mcap'}]").steps, Path("/lab"))
    assert program.recordings() == {"a.mcap": Path("/lab/a.mcap")}


def test_so_many_motions_are_checked_and_no_more() -> None:
    places = count(1)

    def elsewhere(move: Move, here: object) -> Any:
        """A plan that ends where none has ended."""
        return SimpleNamespace(refusal="", path=SimpleNamespace(names=("J1",), goal=(float(next(places)),)))

    step = "steps = [{place = [0, 0, 1], relative = true}]"
    checked = check_program(parsed(f"steps = [{{repeat = 500, {step}}}]"), elsewhere)
    assert [number for number, _ in checked] == ["1.1"] * 500
    with pytest.raises(UsageError, match="more than 500 motions of this program differ: too many to be checked"):
        check_program(parsed(f"steps = [{{repeat = 501, {step}}}]"), elsewhere)
