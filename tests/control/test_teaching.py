from __future__ import annotations

import json
import math
import os
import threading
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.model import states

from hexwire.control.requests import teach_mode
from hexwire.control.requests.teach_mode import TOLERANCE, Teacher, save, to_points, tolerance_of
from hexwire.errors import HexwireError, UsageError
from hexwire.model.arm import ArmModel, JointModel
from hexwire.model.arms.hex7bot.joints import HEX7BOT
from hexwire.model.state import JointFlag, JointState
from hexwire.motion.teach import Taught
from hexwire.motion.trajectory import Spline, Waypoint
from hexwire.motion.waypoint_file import parse_waypoints

NAN = math.nan
WHEN = datetime(2024, 1, 31, 23, 59, 58)


def make_state(
    stamp: float,
    *position: float,
    silent: int = -1,
    **known: Any,
) -> JointState:
    flags = tuple(int(JointFlag.SILENT) if i == silent else 0 for i in range(len(position)))
    return states.make_state(*position, flags=flags, stamp=stamp, **known)


def record(states: list[JointState], names: tuple[str, ...] = ("J1", "J2"), now: float = 0.0) -> Taught:
    teacher = Teacher()
    teacher.start(names, now)
    for state in states:
        teacher.take(state)
    return teacher.finish()


def waved(seconds: float, names: int = 3) -> Taught:
    """A hand's motion with rests, as a servo with 4096 counts a turn tells it."""
    count = 2 * math.pi / 4096
    return Taught.of(
        [f"J{i + 1}" for i in range(names)],
        [
            (
                i / 50,
                [
                    round(0.6 * math.sin(0.7 * i / 50 + k) / count) * count if i // 350 % 2 else 0.01 * k
                    for k in range(names)
                ],
            )
            for i in range(round(50 * seconds))
        ],
    )


def miss(taught: Taught, points: tuple[teach_mode.Point, ...]) -> float:
    """By how much lines through the points miss the worst sample, radians."""
    way = Spline(taught.names, [Waypoint(point.time, point.positions) for point in points])
    return max(
        abs(a - b)
        for t, row in zip(taught.times, taught.rows, strict=True)
        for a, b in zip(row, way.sample(t).position, strict=True)
    )


def test_a_recording() -> None:
    teacher = Teacher()
    assert not teacher.active
    teacher.take(make_state(4.9, 1.0, 2.0))
    teacher.start(("J2", "J1"), 5.0)
    assert teacher.active
    for i in range(5):
        teacher.take(make_state(5.0 + 0.1 * i, 0.1 * i, -0.1 * i))
    taught = teacher.finish()
    assert not teacher.active
    assert taught.names == ("J2", "J1")
    assert taught.times == pytest.approx((0.0, 0.1, 0.2, 0.3, 0.4))
    assert taught.rows[3] == pytest.approx((-0.3, 0.3))


def test_a_new_start_forgets() -> None:
    teacher = Teacher()
    for begin in (5.0, 9.0):
        teacher.start(("J1",), begin)
        for i in range(3):
            teacher.take(make_state(begin + 0.1 * i, begin))
    assert teacher.finish().rows == ((9.0,),) * 3
    with pytest.raises(UsageError, match="nothing was recorded"):
        teacher.finish()


@pytest.mark.parametrize("names", [(), ("J1", "J1")])
def test_joints_are_named_once(names: tuple[str, ...]) -> None:
    teacher = Teacher()
    with pytest.raises(UsageError, match="must be named once each"):
        teacher.start(names, 0.0)
    assert not teacher.active


def test_nothing_recorded_says_what_to_do() -> None:
    with pytest.raises(UsageError, match="nothing was recorded: start teaching, move"):
        record([])
    with pytest.raises(UsageError, match="nothing was recorded"):
        record([make_state(1.0, 0.0, 0.0)])


def test_a_row_needs_all_its_joints() -> None:
    taught = record(
        [
            make_state(1.0, 0.0, 0.0),
            make_state(1.1, 0.1, NAN),
            make_state(1.2, 0.2, 0.2, silent=0),
            make_state(1.3, 0.3, 0.3, age=(0.0, math.inf)),
            make_state(1.4, 0.4),
            make_state(1.5, 0.5, 0.5, NAN, age=(0.0, 0.0, math.inf)),
        ]
    )
    assert taught.rows == ((0.0, 0.0), (0.5, 0.5)), "but not those that are not recorded"


def test_time_is_when_the_newest_joint_was_sampled() -> None:
    taught = record([make_state(1.0, 0.0, 0.0, age=(0.05, 0.02)), make_state(1.5, 1.0, 1.0, age=(0.4, 0.1))])
    assert taught.times == pytest.approx((0.0, 0.42))


def test_time_is_the_boards_where_it_has_a_clock() -> None:
    late = [0.0, 0.008, 0.002, 0.009]
    taught = record([make_state(1.0 + 0.1 * i + d, 0.0, 0.0, board_time=7.0 + 0.1 * i) for i, d in enumerate(late)])
    assert taught.times == pytest.approx((0.0, 0.1, 0.2, 0.3))


def test_the_same_sample_counts_once() -> None:
    states = [make_state(1.0 + 0.03 * i, 0.0, 0.0, age=(0.03 * i,) * 2) for i in range(5)]
    with pytest.raises(UsageError, match="nothing was recorded"):
        record(states)


def test_samples_from_before_the_start_do_not_count() -> None:
    states = [make_state(5.1, 0.0, 0.0, age=(0.3, 0.2)), make_state(5.2, 1.0, 1.0), make_state(5.3, 2.0, 2.0)]
    assert record(states, now=5.0).rows == ((1.0, 1.0), (2.0, 2.0))


def test_at_most_fifty_samples_a_second() -> None:
    taught = record([make_state(1.0 + i / 400, 0.001 * i, 0.0) for i in range(4001)])
    assert 495 <= len(taught.times) <= 502
    assert taught.duration == pytest.approx(10.0, abs=0.03)


def test_the_limit_ends_it_and_keeps_what_there_is() -> None:
    teacher = Teacher(limit=2.0)
    teacher.start(("J1",), 10.0)
    for i in range(200):
        teacher.take(make_state(10.0 + 0.02 * i, 0.0))
        assert teacher.full == (0.02 * i > 2.0)
    assert teacher.active
    assert teacher.finish().duration == pytest.approx(2.0, abs=0.03)
    teacher.start(("J1",), 20.0)
    assert not teacher.full


def test_ten_minutes_can_be_taught() -> None:
    assert Teacher().limit == 600.0


def test_the_limit_counts_though_nothing_can_be_taken() -> None:
    teacher = Teacher(limit=2.0)
    teacher.start(("J1",), 10.0)
    teacher.take(make_state(12.1, NAN))
    assert teacher.full


def test_points_are_few_and_miss_no_sample() -> None:
    taught = waved(60.0)
    points = to_points(taught)
    assert len(points) < len(taught.times) / 10
    assert miss(taught, points) <= TOLERANCE + 1e-6
    assert points[0].time == 0.0
    assert points[-1].time == pytest.approx(taught.duration)
    assert points[-1].positions == pytest.approx(taught.rows[-1], abs=1e-6)
    assert points[0].velocities == ()


def test_an_arm_at_rest_needs_two_points() -> None:
    still = Taught.of(("J1",), [(i / 50, (0.1 + 0.001 * (i % 2),)) for i in range(1000)])
    assert len(to_points(still)) == 2
    assert len(to_points(Taught.of(("J1",), [(3.0, (0.1,))]))) == 1


def test_a_corner_is_kept() -> None:
    corner = Taught.of(("J1",), [(i / 50, (max(0.0, i - 25) / 50,)) for i in range(51)])
    points = to_points(corner, 1e-9)
    assert [point.time for point in points] == pytest.approx([0.0, 0.5, 1.0])


def test_no_tolerance_keeps_what_is_not_on_a_line() -> None:
    zigzag = Taught.of(("J1",), [(i / 50, (float(i % 2),)) for i in range(20)])
    assert len(to_points(zigzag)) == 20


@given(
    st.lists(
        st.tuples(st.floats(0.02, 0.7), st.floats(-1.0, 1.0), st.floats(-0.01, 0.01)), min_size=1, max_size=60
    ),
    st.floats(1e-3, 0.1),
)
def test_whatever_was_taught_the_tolerance_holds(
    samples: list[tuple[float, float, float]], tolerance: float
) -> None:
    time, rows = 0.0, []
    for step, a, b in samples:
        time += step
        rows.append((time, (a, b)))
    taught = Taught.of(("J1", "J2"), rows)
    points = to_points(taught, tolerance)
    # Rounding moves both ends by half a microsecond, and with them a line of 100 rad/s.
    assert miss(taught, points) <= tolerance + 1.5e-4
    assert {point.time for point in points} <= {round(t, 6) for t in taught.times}


def test_a_coarse_servo_gets_a_wider_tolerance() -> None:
    assert tolerance_of(HEX7BOT) == TOLERANCE
    count = math.radians(300 / 1024)
    coarse = ArmModel("coarse", (JointModel("J1", 1, "scs", 512, 1, 0.0, count, -2.0, 2.0, 5.0),))
    flicker = Taught.of(("J1",), [(i / 50, (count * (i % 3 == 0),)) for i in range(500)])
    assert len(to_points(flicker)) > 300
    assert len(to_points(flicker, tolerance_of(coarse))) == 2


def test_the_file_plays_as_what_was_taught(tmp_path: Path) -> None:
    taught = waved(30.0)
    path = save(taught, tmp_path, WHEN)
    assert path == tmp_path / "taught-20240131-235958.json"
    way = parse_waypoints(path.read_bytes(), path.name)
    assert way.names == taught.names
    assert way.duration == pytest.approx(taught.duration)
    for t, row in zip(taught.times, taught.rows, strict=True):
        assert way.sample(t).position == pytest.approx(row, abs=TOLERANCE + 1e-6)
    points = to_points(taught)
    assert isinstance(way, Spline)
    assert way.waypoints == tuple(Waypoint(point.time, point.positions) for point in points)
    assert [p.name for p in tmp_path.iterdir()] == [path.name], "nothing else is left"


def test_the_file_has_a_line_a_point(tmp_path: Path) -> None:
    path = save(Taught.of(("J1",), [(0.0, (0.0,)), (0.5, (-1e-9,))]), tmp_path, WHEN)
    assert path.read_text(encoding="utf-8") == (
        '{"joint_names":["J1"],"points":[\n'
        '{"time_from_start":0.0,"positions":[0.0]},\n'
        '{"time_from_start":0.5,"positions":[0.0]}]}\n'
    )


def test_a_name_like_the_files_own_keys_survives(tmp_path: Path) -> None:
    name = 'a {"time_from_start" joint'
    path = save(Taught.of((name,), [(0.0, (0.0,)), (0.5, (1.0,))]), tmp_path, WHEN)
    assert json.loads(path.read_text(encoding="utf-8"))["joint_names"] == [name]


def test_no_file_is_overwritten(tmp_path: Path) -> None:
    folder = tmp_path / "made" / "for it"
    saved = [save(waved(1.0 + i), folder, WHEN) for i in range(3)]
    assert [path.name for path in saved] == [
        "taught-20240131-235958.json",
        "taught-20240131-235958-2.json",
        "taught-20240131-235958-3.json",
    ]
    ways = [parse_waypoints(path.read_bytes(), path.name) for path in saved]
    assert [way.duration for way in ways] == pytest.approx([0.98, 1.98, 2.98])


def test_a_coarser_file_is_smaller(tmp_path: Path) -> None:
    fine, coarse = (save(waved(20.0), tmp_path, WHEN, tolerance=t) for t in (0.001, 0.05))
    assert coarse.stat().st_size < fine.stat().st_size


def test_a_folder_that_is_a_file(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("mine")
    with pytest.raises(HexwireError, match=r"cannot be saved in .*taken \(.+\); name a folder"):
        save(waved(1.0), tmp_path / "taken", WHEN)
    assert (tmp_path / "taken").read_text() == "mine"


def test_a_write_that_fails_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    first = save(waved(1.0), tmp_path, WHEN)
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(HexwireError, match="No space left on device"):
        save(waved(1.0), tmp_path, WHEN)
    assert [path.name for path in tmp_path.iterdir()] == [first.name]


def test_a_recording_is_not_ended_in_the_midst_of_a_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    teacher = Teacher()
    teacher.start(("J1",), 0.0)
    teacher.take(make_state(1.0, 0.1))
    ended: list[Taught] = []
    ending = threading.Thread(target=lambda: ended.append(teacher.finish()), daemon=True)
    clock = teacher._clock.time

    def end_meanwhile(state: JointState) -> float:
        ending.start()
        ending.join(0.05)
        return clock(state)

    monkeypatch.setattr(teacher._clock, "time", end_meanwhile)
    teacher.take(make_state(1.5, 0.2))
    ending.join(30.0)
    assert [taught.rows for taught in ended] == [((0.1,), (0.2,))]
