from __future__ import annotations

import math

import pytest
from rich.console import Console
from rich.text import Text
from tests.model.states import make_state

from hexwire.cli.draw import CycleSample, JointTable, LiveView, SafeConsole, progress
from hexwire.model.state import JointFlag, JointState

NAN = math.nan
HEAD = ("joint", "deg", "condition")


def state(position: tuple[float, ...], load: tuple[float, ...], flags: tuple[int, ...]) -> JointState:
    return make_state(*position, load=load, flags=flags, age=(0.004,) * len(position), stamp=1.0)


def drawn(what: object, *, width: int = 80, colour: bool = False) -> str:
    console = Console(width=width, force_terminal=colour, color_system="standard" if colour else None)
    with console.capture() as capture:
        console.print(what)
    return capture.get()


def sample(**changes: object) -> CycleSample:
    joints = state((math.radians(10.0), math.radians(-0.02)), (0.05, NAN), (0, int(JointFlag.OVERLOAD)))
    values: dict[str, object] = {
        "time": 1.5,
        "duration": 6.0,
        "state": joints,
        "target": (math.radians(11.5), 0.0),
        "rate": 20.0,
        "round_trip": 0.0203,
        "retries": 3,
    }
    return CycleSample(**(values | changes))  # type: ignore[arg-type]


def test_a_table_has_a_row_a_joint() -> None:
    text = drawn(
        JointTable(("joint", "deg", "condition"), [("J1", "-4.5", "ok"), ("J2", "-", "hot")], [False, True])
    )
    lines = [line.split() for line in text.splitlines() if line.strip()]
    assert lines[0] == ["joint", "deg", "condition"]
    assert lines[2:] == [["J1", "-4.5", "ok"], ["J2", "-", "hot"]]


def test_a_faulty_row_is_red() -> None:
    rows = [("J1", "1.0", "ok"), ("J2", "2.0", "overload")]
    text = drawn(JointTable(HEAD, rows, [False, True]), colour=True)
    one, two = [line for line in text.splitlines() if "J" in line]
    assert "\x1b[1;31m" not in one
    assert "\x1b[1;31m" in two
    assert "\x1b[1;36mJ1" in one, "the name stands out"
    assert one.count("\x1b[1;36m") == 1


def test_the_demo_shows_target_position_error_load_and_age() -> None:
    view = LiveView(Console(width=80))
    view.show(sample())
    text = drawn(view.render())
    rows = [line.split() for line in text.splitlines() if line.strip()]
    assert rows[0] == ["joint", "target", "deg", "position", "deg", "error", "deg", "load", "%", "age", "ms"]
    assert rows[2] == ["J1", "11.5", "10.0", "-1.5", "+5", "4"]
    assert rows[3] == ["J2", "0.0", "0.0", "+0.0", "-", "4"], "never -0.0"
    assert rows[4][0] == "there"
    assert "20.0 Hz, round trip 20.3 ms, 3 retries" in text
    assert "1.5/6.0 s" in text


def test_it_says_which_way_it_is_going() -> None:
    view = LiveView(Console(width=80))
    view.show(sample(time=4.5))
    assert "back" in drawn(view.render())


@pytest.mark.parametrize(("off", "code"), [(0.5, "32"), (3.0, "33"), (9.0, "31")])
def test_the_error_is_coloured_by_its_size(off: float, code: str) -> None:
    view = LiveView(Console(width=80))
    joints = state((math.radians(off),), (0.0,), (0,))
    view.show(sample(state=joints, target=(0.0,)))
    assert f"\x1b[{code}m" in drawn(view.render(), colour=True)


def test_before_the_first_sample_there_is_nothing() -> None:
    assert drawn(LiveView(Console(width=80)).render()).strip() == ""


def test_everything_fits_into_eighty_columns() -> None:
    view = LiveView(Console(width=80))
    view.show(sample(time=9.9, duration=60.0, rate=100.0, round_trip=0.0999, retries=99))
    assert max(len(line) for line in drawn(view.render(), width=200).rstrip().splitlines()) <= 80


def test_a_phase_is_a_line() -> None:
    console = Console(width=40, color_system=None, force_terminal=True)
    view = LiveView(console)
    with console.capture() as capture:
        view.say("pinged", "7 of 7 servos answer, and this line is longer than the terminal is wide")
    assert capture.get() == "    pinged  7 of 7 servos answer, and this line is longer than the terminal is wide\n"


EVIL = "J\x1b[2J\u202e[red]x[/red]\n"
SHOWN = r"J\x1b[2J\u202e[red]x[/red]\n"


@pytest.mark.parametrize("width", [40, 60, 80])
def test_a_narrow_terminal_gets_the_table_in_parts(width: int) -> None:
    head = ("joint", "target deg", "position deg", "error deg", "load %", "age ms", "condition")
    rows = [
        ("J1", "-100.1", "-104.5", "+4.4", "12", "100", "ok"),
        ("J2", "1.5", "2.5", "-1.0", "-", "-", "no answer"),
    ]
    text = drawn(JointTable(head, rows, [False, True]), width=width)
    assert max(map(len, text.splitlines())) <= width
    assert "…" not in text
    for row in (head, *rows):
        assert all(cell in text for cell in row)


def test_a_column_that_is_wider_than_the_terminal_goes_on_in_the_next_line() -> None:
    text = drawn(JointTable(("joint", "condition"), [("J1", "overload, overheated")], [True]), width=12)
    assert max(map(len, text.splitlines())) <= 12
    assert "J1overload,overheated" in "".join(text.split())


def test_names_cannot_command_the_terminal() -> None:
    console = SafeConsole(width=80)
    with console.capture() as capture:
        console.print(JointTable(("joint", "deg"), [(EVIL, "1.0")], [False]))
        console.print(EVIL)
        console.print(Text(EVIL))
    lines = capture.get().splitlines()
    assert any(line.split() == [SHOWN, "1.0"] for line in lines)
    assert sum(SHOWN.removesuffix(r"\n") in line for line in lines) == 3
    assert "\x1b" not in capture.get()
    assert "\u202e" not in capture.get()


def test_text_behind_a_progress_bar_cannot_control_the_terminal_either(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    with progress() as bar:
        bar.add_task(EVIL, total=1.0)
        with bar.console.capture() as capture:
            bar.console.print(bar.get_renderable())
    assert SHOWN.removesuffix(r"\n") in capture.get()
    assert "\x1b" not in capture.get()
