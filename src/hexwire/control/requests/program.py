"""Programs: motions of an arm one after the other, with pauses, questions to a person, and repetitions.

Owns the format of their files and the order of their steps. A file is TOML with degrees, millimetres and percent,
so that a person can read and change it. What a motion is, `motion_service` says. Must not know how a motion is
planned or run, nor who runs a program.

    speed = 0.3                      # share of the joints' speed limits, for all steps that have none

    [[steps]]
    pose = "home"

    [[steps]]
    place = [0, 200, 150]            # mm; with relative, line, aim ("arm", "space", "down"), rpy, or pitch and roll
    aim = "down"

    [[steps]]
    joints = { J1 = 30 }             # deg

    [[steps]]
    grip = 0                         # percent open

    [[steps]]
    play = "wave.mcap"               # a recording, from the folder of this file; with from, to and smooth in s,
                                     # factor, and fit = true: slower if it is too fast

    [[steps]]
    wait = 1.5                       # s

    [[steps]]
    ask = "Put the cube there"       # waits for a person

    [[steps]]
    repeat = 3
    [[steps.steps]]
    pose = "ready"
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from hexwire.errors import GoalError, LimitError, UsageError
from hexwire.inputs import Item, parse_toml, read_text
from hexwire.model.aim import Aim
from hexwire.units import decimal

from ..loop.outcomes import Reason
from ..motion.via import Place
from .motion_service import SMOOTHEST, MotionRequest, read_goals, read_vector
from .pose_file import check_pose_name, toml_key

if TYPE_CHECKING:
    from .preview import Preview

__all__ = [
    "Confirmation",
    "Move",
    "Program",
    "Repeat",
    "Step",
    "Wait",
    "along",
    "check_program",
    "is_program",
    "parse_program",
    "read_program",
]

_T = TypeVar("_T")
_SPEED = 0.3
_SLOWEST = 0.01
_MOST_STEPS = 500
"""Of a file."""
_MOST_CHECKED = 500
_MOST_RUN = 10_000
"""Steps that a program may run, repetitions counted."""
_DEEPEST = 4
_MOST_DEGREES = 3600.0
_MOST_MM = 10_000.0
_LONGEST_WAIT = 3600.0
_LONGEST_TEXT = 200
_DIGITS = 8
_AIMS = ("arm", "space", "down")
_MOTION_KEYS: Mapping[str, tuple[str, ...]] = {
    "pose": (),
    "joints": (),
    "place": ("relative", "line", "aim", "rpy", "pitch", "roll", "branch"),
    "grip": (),
    "play": ("from", "to", "smooth", "factor", "fit"),
}
_KINDS = (*_MOTION_KEYS, "wait", "ask", "repeat")


@dataclass(frozen=True, slots=True)
class Move:
    """A motion.

    Attributes:
        request: What is asked for.
        row: As in a file, with its speed.
    """

    request: MotionRequest
    row: Mapping[str, Any]

    @property
    def file(self) -> str:
        """The recording to play, of ``play``, whose motion is that of this file; empty for other motions."""
        return str(self.row.get("play", ""))


@dataclass(frozen=True, slots=True)
class Wait:
    """A pause of so many seconds."""

    seconds: float


@dataclass(frozen=True, slots=True)
class Confirmation:
    """A pause until a person says that it goes on."""

    text: str


@dataclass(frozen=True, slots=True)
class Repeat:
    """Steps that are run several times."""

    times: int
    steps: tuple[Step, ...]


Step = Move | Wait | Confirmation | Repeat


@dataclass(frozen=True, slots=True)
class Program:
    """Steps in their order.

    Attributes:
        steps: The steps.
        folder: Where its recordings are.
    """

    steps: tuple[Step, ...]
    folder: Path = Path()

    def run_from(self, first: int = 1, times: int = 1) -> Iterator[tuple[str, Move | Wait | Confirmation]]:
        """What is done, in its order, with the number of each step, such as ``3``, or ``3.1`` in a repetition.

        Args:
            first: The step to begin with, from 1; only the first time.
            times: How often all of it is run.

        Raises:
            UsageError: There is no such step.
        """
        if not 1 <= first <= len(self.steps):
            raise UsageError(f"there is no step {first}: the program has {len(self.steps)}")
        for time in range(times):
            yield from _unrolled(self.steps, "", first if not time else 1)

    def recordings(self) -> dict[str, Path]:
        """The recordings that it plays: their files by their names in the program."""
        return {
            move.file: self.folder / move.file for _, move in self.run_from() if isinstance(move, Move) if move.file
        }

    @property
    def asks(self) -> bool:
        """Whether a person must be there to say that it goes on."""
        return any(isinstance(step, Confirmation) for _, step in self.run_from())

    def rows(self) -> list[dict[str, Any]]:
        """Its steps as the values of its file."""
        return _rows(self.steps)

    def serialize(self) -> str:
        """The text of its file."""
        lines = ["# A program of hexwire: degrees, millimetres, percent, seconds."]
        _write(self.rows(), "steps", lines)
        return "\n".join(lines) + "\n"


def _unrolled(
    steps: tuple[Step, ...], before: str, first: int = 1
) -> Iterator[tuple[str, Move | Wait | Confirmation]]:
    for i, step in enumerate(steps[first - 1 :], first):
        if not isinstance(step, Repeat):
            yield f"{before}{i}", step
            continue
        for _ in range(step.times):
            yield from _unrolled(step.steps, f"{before}{i}.")


def check_program(
    program: Program, plan: Callable[[Move, Mapping[str, float] | None], Preview], first: int = 1
) -> list[tuple[str, Preview]]:
    """Plan all motions of a program, each from where the one before it ends, until one is refused; nothing moves.

    Args:
        program: The program.
        plan: Plans a motion from where all joints are then, radians; from where the arm is if None.
        first: The step to begin with, from 1.

    Returns:
        The number and the plan of each motion; of what is repeated, once for each place where it begins.

    Raises:
        UsageError: A step cannot be, with its number; there is no such step, or there are too many to be checked.
        HexwireError: As `plan`.
    """
    found: list[tuple[str, Preview]] = []

    def planned(number: str, move: Move, here: dict[str, float]) -> tuple[Preview, dict[str, float]]:
        if len(found) == _MOST_CHECKED:
            raise UsageError(f"more than {_MOST_CHECKED} motions of this program differ: too many to be checked")
        preview = plan(move, here or None)
        found.append((number, preview))
        path = preview.path
        return preview, here | (dict(zip(path.names, path.goal, strict=True)) if path is not None else {})

    for preview in along(program.run_from(first), {}, planned):
        if preview.refusal:
            break
    return found


def along(
    steps: Iterable[tuple[str, Move | Wait | Confirmation]],
    start: Mapping[str, float],
    check: Callable[[str, Move, dict[str, float]], tuple[_T, dict[str, float]]],
) -> Iterator[_T]:
    """Check the motions of a program, each from where the one before it ends.

    Args:
        steps: As `Program.run_from` gives them.
        start: Where the first one begins, radians by joint.
        check: Called with the number, the motion and where it begins: of what is repeated, once for each such
            place. Returns what it found, and where the motion ends.

    Yields:
        What was found, for each motion.

    Raises:
        HexwireError: As `check`; what is wrong with a step has its number.
    """
    here = dict(start)
    known: dict[tuple[str, tuple[float, ...]], tuple[_T, dict[str, float]]] = {}
    for number, step in steps:
        if isinstance(step, Move):
            at = number, tuple(here.values())
            if at not in known:
                with _named(number):
                    known[at] = check(number, step, here)
            found, here = known[at]
            yield found


@contextmanager
def _named(number: str) -> Iterator[None]:
    """Name the step in what is wrong with it."""
    try:
        yield
    except LimitError as error:
        raise LimitError(f"step {number}: {error}") from error
    except GoalError as error:
        # Whoever has checked it: a path that is not allowed is a matter of limits.
        if error.reason != Reason.PATH_NOT_ALLOWED:
            raise
        raise LimitError(f"step {number}: {error}") from error
    except UsageError as error:
        raise UsageError(f"step {number}: {error}") from error


def is_program(file: str | Path) -> bool:
    """Whether the name of a file is that of a program."""
    return str(file).lower().endswith(".toml")


def read_program(file: str | Path) -> Program:
    """Read a program.

    Raises:
        ConfigError: It is none; the text names the place.
        UsageError: It cannot be read.
    """
    return replace(parse_program(parse_toml(read_text(file), str(file))), folder=Path(file).parent)


def parse_program(item: Item) -> Program:
    """Parse the content of such a file, or what a page has sent of one; raises `ConfigError`, as `read_program`."""
    root = item.table(("steps",), ("speed",))
    speed = root["speed"].number(_SLOWEST, 1.0) if "speed" in root else _SPEED
    left = [_MOST_STEPS]
    program = Program(_steps(root["steps"], speed, left, 1))
    for count, _ in enumerate(program.run_from()):
        if count >= _MOST_RUN:
            raise root["steps"].fault(f"run more than {_MOST_RUN} steps, repetitions counted")
    return program


def _steps(item: Item, speed: float, left: list[int], depth: int) -> tuple[Step, ...]:
    rows = list(item.rows(_MOST_STEPS, least=1))
    left[0] -= len(rows)
    if left[0] < 0:
        raise item.fault(f"are more than {_MOST_STEPS} in all")
    return tuple(_step(row, speed, left, depth) for row in rows)


def _step(item: Item, speed: float, left: list[int], depth: int) -> Step:
    kinds = [kind for kind in _KINDS if kind in item.table()]
    if len(kinds) != 1:
        which = f"; this has {' and '.join(kinds)}" if kinds else ""
        raise item.fault(f"must have one of {', '.join(_KINDS)}{which}")
    kind = kinds[0]
    if kind == "wait":
        return Wait(item.table(("wait",), ())["wait"].number(0.0, _LONGEST_WAIT, "s"))
    if kind == "ask":
        return Confirmation(item.table(("ask",), ())["ask"].text(_LONGEST_TEXT, least=1))
    if kind == "repeat":
        row = item.table(("repeat", "steps"), ())
        times = row["repeat"].integer(1, _MOST_RUN)
        if depth == _DEEPEST:
            raise item.fault(f"repeats in more than {_DEEPEST - 1} repetitions")
        return Repeat(times, _steps(row["steps"], speed, left, depth + 1))
    row = item.table((kind,), ("speed", *_MOTION_KEYS[kind]))
    if "speed" in row:
        speed = row["speed"].number(_SLOWEST, 1.0)
    return Move(MotionRequest(kind, speed, **_READERS[kind](row)), {**item.value, "speed": speed})


def _pose(row: dict[str, Item]) -> dict[str, Any]:
    name = row["pose"].text()
    try:
        return {"name": check_pose_name(name)}
    except UsageError as error:
        raise row["pose"].fault(f"is none: {error}") from None


def _joints(row: dict[str, Item]) -> dict[str, Any]:
    goals = read_goals(row["joints"], _MOST_DEGREES, "deg")
    return {"goals": {name: math.radians(angle) for name, angle in goals.items()}}


def _place(row: dict[str, Item]) -> dict[str, Any]:
    x, y, z = read_vector(row["place"], _MOST_MM, "mm")
    return {
        "place": Place(
            (1e-3 * x, 1e-3 * y, 1e-3 * z),
            _aim(row),
            relative="relative" in row and row["relative"].flag(),
            straight="line" in row and row["line"].flag(),
            branch=row["branch"].text(_LONGEST_TEXT) if "branch" in row else "",
        )
    }


def _aim(row: dict[str, Item]) -> Aim:
    aims = [key for key in ("aim", "rpy", "pitch") if key in row]
    if len(aims) > 1:
        raise row[aims[1]].fault(f"and {aims[0]} both aim the tool; leave one out")
    if "roll" in row and "pitch" not in row:
        raise row["roll"].fault("needs a pitch")
    if "rpy" in row:
        roll, pitch, yaw = map(math.radians, read_vector(row["rpy"], _MOST_DEGREES, "deg"))
        return Aim(rpy=(roll, pitch, yaw))
    if "pitch" in row:
        return Aim(pitch=_degrees(row["pitch"]), roll=_degrees(row["roll"]) if "roll" in row else None)
    aim = row["aim"].choice(_AIMS) if "aim" in row else "arm"
    return Aim(down=aim == "down", fixed=aim == "space")


def _grip(row: dict[str, Item]) -> dict[str, Any]:
    return {"share": row["grip"].number(0.0, 100.0, "percent") / 100.0}


def _play(row: dict[str, Item]) -> dict[str, Any]:
    file = row["play"].text(_LONGEST_TEXT, least=1)
    if Path(file).name != file:
        raise row["play"].fault("must be the name of a recording in the folder of this file, without a path")
    names = {"from": "begin", "to": "end", "factor": "factor"}
    args: dict[str, Any] = {name: row[key].number(0.0) for key, name in names.items() if key in row}
    if "smooth" in row:
        args["smooth"] = row["smooth"].number(0.0, SMOOTHEST, "s")
    if "fit" in row:
        args["fit"] = row["fit"].flag()
    return args


_READERS = {"pose": _pose, "joints": _joints, "place": _place, "grip": _grip, "play": _play}


def _degrees(item: Item) -> float:
    return math.radians(item.number(-_MOST_DEGREES, _MOST_DEGREES, "deg"))


def _rows(steps: tuple[Step, ...]) -> list[dict[str, Any]]:
    return [_row(step) for step in steps]


def _row(step: Step) -> dict[str, Any]:
    if isinstance(step, Wait):
        return {"wait": step.seconds}
    if isinstance(step, Confirmation):
        return {"ask": step.text}
    if isinstance(step, Repeat):
        return {"repeat": step.times, "steps": _rows(step.steps)}
    return dict(step.row)


def _write(rows: list[dict[str, Any]], path: str, lines: list[str]) -> None:
    for row in rows:
        lines += ["", f"[[{path}]]"]
        lines += [f"{key} = {_value(value)}" for key, value in row.items() if key != "steps"]
        _write(row.get("steps", []), f"{path}.steps", lines)


def _value(value: object) -> str:
    """A value of TOML; a string of JSON is one, too."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return decimal(value, _DIGITS)
    if isinstance(value, list):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{toml_key(name)} = {_value(one)}' for name, one in value.items())} }}"
    return json.dumps(value, ensure_ascii=False)
