"""The format of programs: what is written is read again, what is wrong is named, and nothing is unbounded."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.control.motion.via import Place
from hexwire.control.requests.motion_service import MotionRequest
from hexwire.control.requests.program import Confirmation, Move, Program, Repeat, Step, Wait, parse_program
from hexwire.errors import ConfigError, UsageError
from hexwire.inputs import parse_toml
from hexwire.model.aim import Aim


def parsed(text: str) -> Program:
    return parse_program(parse_toml(text, "p.toml"))


SPEED = st.floats(0.01, 1.0)
ANGLE = st.floats(-6.0, 6.0)
LENGTH = st.floats(-1.0, 1.0)
NAME = st.text(st.characters(categories=["L", "N"]), min_size=1, max_size=20)
AIM = st.one_of(
    st.just(Aim()),
    st.just(Aim(down=True)),
    st.just(Aim(fixed=True)),
    st.builds(lambda angles: Aim(rpy=angles), st.tuples(ANGLE, ANGLE, ANGLE)),
    st.builds(lambda pitch, roll: Aim(pitch=pitch, roll=roll), ANGLE, st.none() | ANGLE),
)
PLACE = st.builds(Place, st.tuples(LENGTH, LENGTH, LENGTH), AIM, st.booleans(), st.booleans(), st.just("") | NAME)
MOVES = st.one_of(
    st.builds(lambda speed, name: Move(MotionRequest("pose", speed, name=name)), SPEED, NAME),
    st.builds(
        lambda speed, goals: Move(MotionRequest("joints", speed, goals=goals)),
        SPEED,
        st.dictionaries(NAME, ANGLE, min_size=1, max_size=4),
    ),
    st.builds(lambda speed, place: Move(MotionRequest("place", speed, place=place)), SPEED, PLACE),
    st.builds(lambda speed, share: Move(MotionRequest("grip", speed, share=share)), SPEED, st.floats(0, 1)),
    st.builds(
        lambda speed, name, begin, factor: Move(
            MotionRequest("play", speed, begin=begin, factor=factor), f"{name}.mcap"
        ),
        SPEED,
        NAME,
        st.floats(0, 10),
        st.floats(0.1, 4),
    ),
)
LEAVES = st.one_of(MOVES, st.builds(Wait, st.floats(0, 100)), st.builds(Confirmation, NAME))
STEPS: st.SearchStrategy[Step] = st.recursive(
    LEAVES,
    lambda steps: st.builds(Repeat, st.integers(1, 3), st.lists(steps, min_size=1, max_size=3).map(tuple)),
    max_leaves=5,
)


def near(a: object, b: object) -> bool:
    """Equal, but for what rounding to a thousandth of a degree or a micrometre changes."""
    if isinstance(a, float) and isinstance(b, float):
        return a == b or abs(a - b) < 2e-6
    if isinstance(a, tuple | list) and isinstance(b, tuple | list):
        return len(a) == len(b) and all(map(near, a, b))
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(near(a[key], b[key]) for key in a)
    slots = getattr(a, "__slots__", None)
    if slots and type(a) is type(b):
        return all(near(getattr(a, name), getattr(b, name)) for name in slots)
    return a == b


def depth(steps: tuple[Step, ...]) -> int:
    return 1 + max((depth(step.steps) for step in steps if isinstance(step, Repeat)), default=0)


@given(st.lists(STEPS, min_size=1, max_size=6).map(tuple))
def test_what_is_written_is_read_again(steps: tuple[Step, ...]) -> None:
    program = Program(steps)
    if depth(steps) > 4:
        with pytest.raises(ConfigError, match="repeats in more than 3"):
            parsed(program.serialize())
        return
    again = parsed(program.serialize())
    assert near(again.steps, steps), program.serialize()
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
        ("steps = [{joints = {}}]", "goals must name 1 to 253 joints"),
        ("steps = [{joints = {J1 = 1e5}}]", "-3600 to 3600 deg"),
        ("steps = [{place = [1, 2]}]", "has 2 values, but must have 3"),
        ("steps = [{place = [1, 2, 1e6]}]", "must be -10000 to 10000 mm"),
        ("steps = [{place = [1, 2, 3], aim = 'up'}]", "is 'up', but must be arm, space, down"),
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


def test_units_are_those_of_people() -> None:
    program = parsed("speed = 0.5\nsteps = [{joints = {J1 = 180}}, {place = [0, 200, 0]}, {grip = 50}]")
    joints, place, grip = (step.request for step in program.steps if isinstance(step, Move))
    assert joints.goals == {"J1": math.pi}
    assert place.place.position == (0.0, pytest.approx(0.2), 0.0)
    assert (grip.share, grip.speed) == (0.5, 0.5)


def test_its_recordings_are_in_its_folder() -> None:
    program = Program(parsed("steps = [{play = 'a.mcap'}, {play = 'a.mcap'}]").steps, Path("/lab"))
    assert program.recordings() == {"a.mcap": Path("/lab/a.mcap")}
