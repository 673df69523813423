"""The judge of the fault tests: it finds a violation of each promise, and none where there is none."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from tests.system.fleet_watch import HOLD, SETTLING, TIMEOUT, BoardLog, ClientLog, Servo, violations
from tests.system.watched_board import ROW, Notes

from hexwire.emulator.bus_arms import make_hex7bot_servos

END = 30.0


def servo(*moves: tuple[float, float]) -> dict[int, Servo]:
    """A servo at 2000 that sets out at these times for these targets, with 100 counts a second; from 0 to `END`."""
    log = Servo()
    log.add(0.0, 1, 2000.0, 2000.0)
    for begin, target in moves:
        here = log.positions[-1]
        log.add(begin, 1, log.targets[-1], here)
        steps = max(1, round(abs(target - here)))
        for step in range(steps + 1):
            log.add(
                begin + step * abs(target - here) / steps / 100, 1, target, here + step * (target - here) / steps
            )
    return {4: log}


class Log:
    """The log of a client."""

    def __init__(self) -> None:
        self.rows: list[dict[str, Any]] = []
        self._number = itertools.count(1)

    def says(self, what: str, begin: float, end: float | None, refused: str = "", duration: float = 0.0) -> Log:
        number = next(self._number)
        sent = {"e": "sent", "n": number, "what": what, "t": begin, "wait": 0.5, "duration": duration}
        self.rows.append({**sent, "finish": what == "Leave", "client": 0})
        if end is not None:
            self.rows.append({"e": "answered", "n": number, "t": end, "refused": refused, "client": 0})
        return self

    def reads(
        self, stamp: float, counts: float, age: float = 0.0, arrived: float = 3.01, booted: float = 0.1
    ) -> Log:
        row = {"stamp": stamp, "t": arrived, "booted": booted, "client": 0}
        self.rows.append({"e": "state", "ids": [4], "counts": [counts], "age": [age], **row})
        return self


def held() -> Log:
    """The lease from 1 to 10 s."""
    log = Log().says("Take", 1.0, 1.01)
    for i in range(1, 90):
        log.says("Beat", 1.0 + 0.1 * i, 1.0 + 0.1 * i + 0.01)
    return log


def check(servos: dict[int, Servo], log: Log, cuts: Sequence[tuple[float, float]] = ()) -> list[str]:
    return violations(servos, log.rows, END, cuts)


def test_what_a_holder_moves_is_allowed_as_long_as_it_has_the_lease() -> None:
    assert not check(servo((2.0, 2500.0)), held())
    lost = 9.91 + TIMEOUT
    assert not check(servo((lost + HOLD - 0.5, 2030.0)), held())
    found = check(servo((lost + HOLD + 0.1, 2030.0)), held())
    assert "without a lease" in found[0]
    assert "servo 4 had targets [2000.0, 2030.0]" in found[0]


def test_a_motion_that_nobody_asked_for_is_found() -> None:
    assert check(servo((2.0, 2500.0)), Log())
    # A motion that goes on without a new target, and a position that jumps.
    assert check(servo((9.0, 2900.0)), held())
    jumped = servo()
    jumped[4].add(20.0, 1, 2000.0, 2005.0)
    assert check(jumped, held())


def test_a_refused_order_is_no_lease() -> None:
    log = Log().says("Write", 1.0, 1.01, "LeaseError").says("Take", 1.1, 1.2, "LeaseError")
    assert check(servo((1.3, 2010.0)), log)


def test_what_was_sent_in_a_cut_gives_no_lease() -> None:
    log = held().says("Beat", 12.0, None).says("Beat", 15.0, 15.01, "LeaseError")
    assert not check(servo((12.6, 2005.0)), log)
    assert "without a lease" in check(servo((12.6, 2005.0)), log, [(10.0, 14.0)])[0]


def test_a_motion_ends_by_itself_after_a_lease_that_was_given_back() -> None:
    log = Log().says("Take", 1.0, 1.01).says("Write", 1.1, 1.2, duration=8.0).says("Leave", 1.3, 1.4)
    assert not check(servo((1.15, 2780.0)), log)
    assert check(servo((1.15, 2780.0), (8.96, 2000.0)), log)


def test_a_motion_after_a_stop_is_found_until_somebody_resumes() -> None:
    stopped = held().says("StopRequest", 3.0, 3.1)
    assert not check(servo((2.0, 2100.0 + 100 * SETTLING)), stopped)
    found = check(servo((3.0 + SETTLING + 0.2, 2010.0)), stopped)
    assert found[0].startswith("after a stop, from 3.60 to 30.00 s: servo 4")
    assert not check(servo((5.1, 2200.0)), stopped.says("Resume", 5.0, 5.05))
    # A stop that was not confirmed promises nothing.
    assert not check(servo((4.0, 2100.0)), held().says("StopRequest", 3.0, None))


@pytest.mark.parametrize(
    ("counts", "age", "arrived", "true"),
    [
        (2100.0, 0.0, 3.01, True),
        (2101.9, 0.0, 3.01, True),
        (2090.0, 0.0, 3.01, False),
        (2090.0, 0.1, 3.01, True),
        (2110.0, 0.0, 3.01, False),
        (2110.0, 0.0, 3.5, True),
        (float("nan"), 0.0, 3.01, True),
    ],
)
def test_a_position_that_the_servo_did_not_have_is_found(
    counts: float, age: float, arrived: float, true: bool
) -> None:
    found = check(servo((2.0, 2200.0)), held().reads(3.0, counts, age, arrived))
    assert bool(found) is not true
    assert true or "of servo 4, which had" in found[0]


def test_a_servo_was_anywhere_between_its_rows_while_its_board_stalled() -> None:
    log = Servo()
    for time, position in ((0.0, 2331.0), (3.0, 2331.0), (3.12, 2308.0), (END, 2308.0)):
        log.add(time, 1, 2308.0, position)
    # It was at rest since 3.06 s, which the straight line between the rows does not show.
    assert not check({4: log}, held().reads(3.08, 2308.0, arrived=3.09))
    assert check({4: log}, held().reads(3.08, 2306.0, arrived=3.09))
    assert check({4: log}, held().reads(3.18, 2331.0, arrived=3.2))


def test_a_state_of_another_board_is_found() -> None:
    log = Log().reads(3.0, 2000.0, booted=2.0)
    assert check(servo(), log) == ["at 3.01 s client 0 read another board"]
    assert not violations(servo(), log.rows, END, others=[(2.5, 3.5)])


def test_the_board_writes_down_every_change(tmp_path: Path) -> None:
    (moving, *_) = make_hex7bot_servos(start=0.0)
    notes, log = Notes(moving), b""
    moving.registers.put("torque_enable", 1)
    for i in range(200):
        if i == 100:
            moving.motion.position += 5.0
        log += notes.look(0.01 * i)
    path = tmp_path / "log"
    path.write_bytes(log + b"a row that was cut")
    servos = BoardLog(path).read()
    assert servos[0].times == pytest.approx([0.0, 0.99, 1.0])
    assert servos[0].positions[2] - servos[0].positions[1] == 5.0
    assert len(log) == 3 * ROW.size


def test_the_last_line_of_a_killed_client_may_be_cut(tmp_path: Path) -> None:
    (tmp_path / "a").write_text('{"e": "lost"}\n{"e": "sta', encoding="utf-8")
    log = ClientLog(tmp_path / "a", 3)
    assert log.read() == [{"e": "lost", "client": 3}]
    (tmp_path / "a").write_text('{"e": "lost"}\n{"e": "state"}\n', encoding="utf-8")
    assert [row["e"] for row in log.read()] == ["lost", "state"]
