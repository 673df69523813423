from __future__ import annotations

import itertools
import math
import struct
import threading
import tracemalloc

import pytest

from hexwire.control.requests.history import ARM_SIGNALS, JOINT_SIGNALS, History
from hexwire.model.state import JointFlag, JointState

NAN = math.nan


def _state(stamp: float, value: float = 0.0, names: tuple[str, ...] = ("J1", "J2"), flags: int = 0) -> JointState:
    n = len(names)
    row = (value,) * n
    return JointState(
        names=names,
        position=row,
        velocity=(0.5,) * n,
        load=(0.1,) * n,
        current=(NAN,) * n,
        voltage=(7.4,) * n,
        temperature=(30.0,) * n,
        flags=(flags,) * n,
        age=(0.0,) * n,
        stamp=stamp,
    )


def test_a_row_has_every_signal_of_every_joint_and_of_the_arm() -> None:
    history = History(("J1", "J2"))
    assert history.append(_state(5.0, 1.25), {"J2": 0.75}, rate=50.0, round_trip=0.002)
    ((time, row),) = history.rows()
    found = {(joint, signal.name): value for (joint, signal), value in zip(history.columns, row, strict=True)}
    assert time == 5.0
    assert found["J1", "position"] == 1.25
    assert math.isnan(found["J1", "goal"])
    assert found["J2", "goal"] == 0.75
    assert found["J2", "voltage"] == pytest.approx(7.4)
    assert math.isnan(found["J1", "current"])
    assert (found["", "rate"], found["", "round_trip"], found["", "faults"]) == pytest.approx((50.0, 0.002, 0))
    assert history.width == 2 * len(JOINT_SIGNALS) + len(ARM_SIGNALS) == len(row)


def test_joints_of_a_state_may_be_missing_or_in_another_order() -> None:
    history = History(("J1", "J2"))
    silent = _state(1.0, 2.0, ("J2",), int(JointFlag.SILENT))
    history.append(silent, {})
    ((_, row),) = history.rows()
    found = {(joint, signal.name): value for (joint, signal), value in zip(history.columns, row, strict=True)}
    assert math.isnan(found["J1", "position"])
    assert found["J2", "position"] == 2.0
    assert found["", "faults"] == 1


def test_an_old_state_is_not_added_and_a_fast_robot_is_thinned() -> None:
    history = History(("J1", "J2"), rate=100.0)
    # 400 states a second for two seconds.
    for i in range(800):
        history.append(_state(i / 400), {})
    times = history.rows().times
    assert 195 <= len(times) <= 205
    assert not history.append(_state(1.0), {})
    # A robot of just under the rate loses nothing.
    history = History(("J1", "J2"), rate=100.0)
    assert all(history.append(_state(i / 99), {}) for i in range(300))


def test_ten_minutes_are_kept_and_no_more() -> None:
    history = History(("J1", "J2"), seconds=600.0, rate=10.0)
    for i in range(12_345):
        history.append(_state(i / 10, float(i)), {})
    rows = history.rows()
    assert rows.times[-1] == 1234.4
    assert rows.times[0] == pytest.approx(634.5)
    assert [row[0] for _, row in rows] == [float(i) for i in range(6345, 12_345)]
    part = rows.between(1000.0, 1000.95)
    assert list(part.times) == [i / 10 for i in range(10_000, 10_010)]
    assert [row[0] for _, row in part] == [float(i) for i in range(10_000, 10_010)]


def test_only_what_is_newer_is_read_again() -> None:
    history = History(("J1", "J2"))
    for i in range(50):
        history.append(_state(i / 10, float(i)), {})
    assert [row[0] for _, row in history.rows(after=4.5)] == [46.0, 47.0, 48.0, 49.0]
    assert len(history.rows(after=99.0)) == 0
    assert len(History(("J1",)).rows()) == 0


@pytest.mark.slow
def test_memory_is_that_of_ten_minutes_after_an_hour_of_samples() -> None:
    tracemalloc.start()
    try:
        history = History([f"J{i}" for i in range(1, 8)], seconds=600.0, rate=100.0)
        state = [_state(0.0, names=history.names)]

        def memory(begin: int, end: int) -> float:
            for i in range(begin, end):
                object.__setattr__(state[0], "stamp", i / 100)
                history.append(state[0], {})
            return tracemalloc.get_traced_memory()[0]

        assert memory(0, 1000) < 5e5
        before = memory(330_000, 345_000)
        assert memory(345_000, 420_000) < 14e6
        # The last minutes of an hour, at 100 Hz.
        assert abs(memory(420_000, 480_000) - memory(480_000, 510_000)) < 3e5
        assert before < 14e6
    finally:
        tracemalloc.stop()
    assert history.rows().times[-1] == 5099.99


def test_a_reader_in_another_thread_sees_only_whole_rows_in_their_order() -> None:
    history, over = History(("J1", "J2"), seconds=60.0, rate=100.0), threading.Event()

    def write() -> None:
        for i in range(40_000):
            history.append(_state(i / 100, i / 100), {})
        over.set()

    writer = threading.Thread(target=write)
    writer.start()
    while not over.is_set():
        rows = history.rows()
        times = list(rows.times)
        assert [row[0] for _, row in rows] == pytest.approx(times)
        assert all(b - a == pytest.approx(0.01) for a, b in itertools.pairwise(times))
        # What comes while it reads is there as well.
        assert not times or times[-1] - times[0] < 120.0
    writer.join()
    assert len(history.rows()) == 6000


def test_values_are_floats_of_32_bits() -> None:
    history = History(("J1",))
    history.append(_state(1.0, 0.1, ("J1",)), {})
    rows = history.rows()
    assert len(rows.blocks[0]) == 4 * rows.width
    assert struct.unpack_from("<f", rows.blocks[0])[0] == pytest.approx(0.1, rel=1e-6)
