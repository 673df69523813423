"""Every argument of every verb: what is of a wrong kind is refused in one line, and nothing moves."""

from __future__ import annotations

import inspect
import math
import tempfile
from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.arm.arms import connected

from hexwire import Arm
from hexwire.arm.poses import Poses
from hexwire.errors import UsageError

WRONG: tuple[Any, ...] = (
    None,
    "no",
    "",
    b"x",
    object(),
    [],
    [1.0],
    {1.0, 2.0, 3.0},
    (1.0, "a", 2.0),
    {"J99": 0.1},
    {3: 0.1},
    {"J1": "a"},
    iter(()),
    lambda: 1.0,
    int,
    1j,
    math.nan,
    math.inf,
    -math.inf,
    -1,
    -0.5,
    0,
    0.5,
    2,
    1e9,
    10**400,
    Fraction(10**400),
    True,
    np.float64(math.nan),
    np.array([1.0, 2.0]),
    np.array(["a"]),
)


def is_flag(value: object) -> bool:
    return isinstance(value, int) and value in (0, 1)


def number(low: float, high: float = math.inf, *, above: bool = False) -> Callable[[object], bool]:
    """Whether a value is a number in a range; above its beginning, if that is said."""

    def fits(value: object) -> bool:
        if isinstance(value, bool) or not isinstance(value, int | float | Fraction) or value > 10**300:
            return False
        return (low < value if above else low <= value) and value <= high and math.isfinite(value)

    return fits


def none_or(fits: Callable[[object], bool]) -> Callable[[object], bool]:
    return lambda value: value is None or fits(value)


def never(value: object) -> bool:
    return False


SHARE, SECONDS, FORCE = number(0, 1, above=True), number(0, above=True), number(0, 1)
RIGHT: dict[str, Callable[[object], bool]] = {
    "relative": is_flag,
    "down": is_flag,
    "wait": is_flag,
    "trim": is_flag,
    "fit": is_flag,
    "limp": is_flag,
    "mirror": is_flag,
    "on": is_flag,
    "torque_off": is_flag,
    "speed": none_or(SHARE),
    "duration": none_or(SECONDS),
    "factor": SECONDS,
    "begin": number(0),
    "end": lambda value: (isinstance(value, float) and value == math.inf) or number(0)(value),
    "seconds": lambda value: (isinstance(value, float) and value == math.inf) or number(0)(value),
    "smooth": number(0),
    "repeat": number(2, 2),
    "step": number(2, 2),
    "ask": none_or(callable),
    "rate": lambda value: number(0, 1000)(value),
    "opening": FORCE,
    "grip": none_or(FORCE),
    "meet": SHARE,
    "max_speed": none_or(SECONDS),
    "max_acceleration": none_or(SECONDS),
    "x": none_or(number(-3, 3)),
    "y": none_or(number(-3, 3)),
    "z": none_or(number(-3, 3)),
    "pitch": none_or(number(-7, 7)),
    "roll": none_or(number(-7, 7)),
    "rpy": none_or(never),
    "tip_speed": number(0, 3, above=True),
    "rounding": number(0, 3),
    "points": never,
    "goal": never,
    "joints": never,
    "motion": never,
    "leader": never,
    "file": lambda value: value is None,
    "state": none_or(never),
    "angles": none_or(never),
    "name": lambda value: value == "no" if isinstance(value, str) else False,
}
"""By the name of an argument, which values are right, or wrong only beside others; `force` is either of two."""

GOOD: dict[str, tuple[tuple[Any, ...], dict[str, Any]]] = {
    "move": (({},), {}),
    "goto": (("home",), {}),
    "line": (("home",), {}),
    "play": (("none.mcap",), {}),
    "grip": ((0.5,), {}),
    "follow": ((None,), {}),
    "record": (("none.txt",), {}),
    "teach": (("none.txt",), {}),
    "send": (({},), {}),
}
"""What else a verb is called with."""


def verbs_of(kind: type) -> Iterator[str]:
    for name, method in inspect.getmembers(kind, inspect.isfunction):
        if not name.startswith("_") and method.__module__.startswith("hexwire.arm."):
            yield name


VERBS = [*verbs_of(Arm)]


@pytest.fixture(scope="module", params=["bus", "board"])
def arm(request: pytest.FixtureRequest) -> Iterator[Arm]:
    with tempfile.TemporaryDirectory(prefix="hw") as folder, connected(request.param, Path(folder)) as arm:
        yield arm


@pytest.fixture
def sent(arm: Arm, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What the robot is told; it does nothing of it."""
    told: list[str] = []
    for name in ("write", "torque", "path", "clear_path", "stop", "resume", "detach", "watchdog", "ioctl"):
        if hasattr(arm.driver, name):
            monkeypatch.setattr(arm.driver, name, lambda *given, _name=name, **named: told.append(_name) or ())
    return told


def refused(call: Callable[[], object], what: str) -> None:
    with pytest.raises(UsageError) as error:
        call()
    said = str(error.value)
    assert said, what
    assert "\n" not in said, what
    assert len(said) < 400, what


def arguments(method: Callable[..., Any]) -> Iterator[tuple[str, inspect.Parameter]]:
    for name, row in inspect.signature(method).parameters.items():
        if name != "self":
            yield name, row


def is_right(verb: str, name: str, value: object) -> bool:
    if name == "force":
        return (is_flag if verb in ("teach", "record", "save") else FORCE)(value)
    if verb == "follow" and name == "rate":
        return SECONDS(value) and number(0, 1000)(value)
    if verb == "send" and name == "duration":
        return RIGHT["begin"](value)
    if verb == "record" and name == "file":
        return False
    return RIGHT[name](value)


@pytest.mark.parametrize("verb", VERBS)
def test_every_argument_of_every_verb(arm: Arm, sent: list[str], verb: str) -> None:
    method = getattr(arm, verb)
    given, named = GOOD.get(verb, ((), {}))
    if verb == "follow":
        given = (Arm(arm.driver),)
    for name, row in arguments(getattr(Arm, verb)):
        for value in WRONG:
            what = f"{verb}({name}={value!r:.60})"
            if row.kind is row.VAR_KEYWORD:
                if number(-6, 6)(value):
                    continue
                refused(partial(method, **{arm.model.names[0]: value}), what)
            elif row.kind is row.VAR_POSITIONAL:
                before = (False,) if verb == "torque" else ()
                refused(partial(method, *before, value), what)
            elif is_right(verb, name, value):
                continue
            elif row.kind is row.KEYWORD_ONLY:
                refused(partial(method, *given, **{**named, name: value}), what)
            else:
                refused(partial(method, value), what)
    assert not [one for one in sent if one != "clear_path"]


def test_what_an_arm_is_told_by_its_attributes(arm: Arm, sent: list[str]) -> None:
    names = arm.model.names
    for value in WRONG:
        what = f"{value!r:.60}"
        for name, right in (("speed", SHARE), ("table", none_or(number(-3, 3)))):
            if not right(value):
                old = getattr(arm, name)
                setattr(arm, name, value)
                try:
                    refused(lambda: arm.move({names[0]: 0.1}), f"{name} = {what}")
                finally:
                    setattr(arm, name, old)
        refused(partial(arm.poses.__setitem__, "nod", value), f"poses['nod'] = {what}")
        refused(partial(arm.poses.__setitem__, value, {"J99": 0.1}), f"poses[{what}]")
        for name, _ in arguments(Poses.save):
            if not is_right("save", name, value):
                refused(partial(arm.poses.save, **{"name": "nod", name: value}), f"poses.save({name}={what})")
    assert not [one for one in sent if one != "clear_path"]


def test_how_long_a_program_waits(arm: Arm) -> None:
    motion = arm.move({arm.model.names[0]: 0.3}, duration=30.0, wait=False)
    try:
        for value in WRONG:
            if (value is not None and not isinstance(value, int | float | Fraction)) or isinstance(value, bool):
                refused(partial(motion.wait, value), f"wait({value!r:.60})")
        refused(lambda: motion.wait(math.nan), "nan")
        with pytest.raises(TimeoutError):
            motion.wait(-1)
    finally:
        motion.cancel()
