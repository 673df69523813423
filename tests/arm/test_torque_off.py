"""Nothing that was asked of an arm before torque off moves it or gives it torque after that."""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from tests.arm.arms import connected
from tests.waits import PATIENCE, eventually

from hexwire import Arm, deg, mm
from hexwire.arm.handle import Handle
from hexwire.bus.line import BusLine
from hexwire.epochs import Epochs
from hexwire.errors import ServoError, StoppedError, UsageError
from hexwire.fleet.remote import RemoteRobot
from hexwire.ipc.session import Session
from hexwire.motion.teach import Taught

STEPS: tuple[tuple[type, str], ...] = (
    (Epochs, "check"),
    (Epochs, "check_leaving"),
    (Epochs, "holds"),
    (Session, "_step"),
    (BusLine, "run"),
    (BusLine, "post"),
    (RemoteRobot, "_exchange"),
)
"""What torque off does on its way: asks whether it is void, and sends."""
CALLS = ("read", "write", "torque", "path", "clear_path", "read_positions", "left_path", "watchdog")


def insisted(call: Callable[[], object]) -> None:
    """Make a call until all joints confirm it: on a busy machine one may not answer in time."""

    def confirmed() -> bool:
        try:
            call()
        except ServoError:
            return False
        return True

    eventually(confirmed)


def a_way(arm: Arm) -> Taught:
    here = arm.read()
    rows = [
        [angle + (deg(0.5) * i if name == here.names[0] else 0.0) for name, angle in here.positions.items()]
        for i in range(8)
    ]
    return Taught.of(here.names, [(0.05 * i, row) for i, row in enumerate(rows)])


def other_opening(arm: Arm) -> float:
    return 0.3 if arm.opening > 0.6 else 0.9


def a_program(arm: Arm, way: float = 4.0, speed: float = 1.0) -> Path:
    """Two motions, there and back, and a pause between them; degrees, and a share of the speed."""
    joint, here = arm.model.names[0], arm.read().position[0]
    rows = [f"joints = {{ {joint} = {math.degrees(here) + by} }}\nspeed = {speed}" for by in (way, 0.0)]
    file = Path(os.environ["XDG_CONFIG_HOME"]) / "a.toml"
    file.write_text("\n".join(f"[[steps]]\n{row}" for row in (rows[0], "wait = 0.05", rows[1])))
    return file


VERBS: dict[str, Callable[[Arm], Callable[[], Handle[Any]]]] = {
    "move": lambda arm: partial(arm.move, {arm.model.names[0]: deg(4)}, relative=True, wait=False),
    "goto": lambda arm: partial(arm.goto, (0, 0, -mm(8)), relative=True, wait=False),
    "line": lambda arm: partial(arm.line, (0, 0, mm(8)), relative=True, tip_speed=0.1, wait=False),
    "home": lambda arm: partial(arm.home, wait=False),
    "play": lambda arm: partial(arm.play, a_way(arm), wait=False),
    "program": lambda arm: partial(arm.play, a_program(arm), wait=False),
}
GRIPS: dict[str, Callable[[Arm], Callable[[], Handle[Any]]]] = {
    "grip": lambda arm: partial(arm.grip, other_opening(arm), wait=False),
    "open": lambda arm: partial(arm.open, wait=False),
    "close": lambda arm: partial(arm.close, wait=False),
    "move and grip": lambda arm: partial(
        arm.move, {arm.model.names[0]: -deg(4)}, relative=True, grip=other_opening(arm), wait=False
    ),
}


def tried(arm: Arm, call_verb: Callable[[], Handle[Any]], number: int) -> bool:
    """Switch torque off right before a verb's call of that number; whether it made so many."""
    calls = 0

    def counted(name: str) -> Callable[..., Any]:
        method = getattr(arm.driver, name)

        def call(*given: Any, **named: Any) -> Any:
            nonlocal calls
            # Of this program's thread of torque off nothing counts.
            if threading.current_thread().name != "torque off":
                calls += 1
                if calls == number:
                    other = threading.Thread(target=insisted, args=[partial(arm.torque, False)], name="torque off")
                    other.start()
                    other.join(PATIENCE)
                    assert not other.is_alive()
            return method(*given, **named)

        return call

    with pytest.MonkeyPatch.context() as patch:
        for name in filter(partial(hasattr, arm.driver), CALLS):
            patch.setattr(arm.driver, name, counted(name))
        with suppress(StoppedError):
            call_verb().wait(PATIENCE)
    return calls >= number


@pytest.mark.parametrize("name", VERBS | GRIPS)
def test_what_was_asked_before_torque_off_gives_no_torque_after_it(arm: Arm, name: str) -> None:
    if arm.model.name == "puma260" and name in GRIPS:
        with pytest.raises(UsageError, match="no gripper"):
            arm.open()
        return
    prepare, number = (VERBS | GRIPS)[name], 1
    while tried(arm, prepare(arm), number):
        state = arm.read()
        assert (state.torque_on, state.stopped) == ((), False), number
        number += 1 if number < 8 else number // 2
    # The last one was not disturbed, and gave the joints their torque again.
    assert number > 4
    assert arm.read().torque_on


def test_a_motion_that_torque_off_has_ended_says_so_and_the_next_one_may_follow_at_once(arm: Arm) -> None:
    motion = arm.move({arm.model.names[0]: deg(20)}, relative=True, duration=20.0, wait=False)
    before = arm.read().position[0]
    eventually(lambda: abs(arm.read().position[0] - before) > deg(0.5))
    insisted(partial(arm.torque, False))
    assert arm.home().arrived
    with pytest.raises(StoppedError, match="torque was switched off; nothing is latched"):
        motion.wait()


def test_torque_off_during_a_lesson_stays_off_at_its_end(arm: Arm) -> None:
    with arm.teach() as lesson:
        eventually(lambda: len(lesson._states) > 2)
        insisted(partial(arm.torque, False))
    assert not arm.read().torque_on
    assert arm.home().arrived


@pytest.mark.parametrize("ends", ["torque off", "a stop"])
def test_following_ends_with_the_torque_of_the_follower_or_a_stop(ends: str, tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    with connected("bus", tmp_path / "a") as leader, connected("bus", tmp_path / "a") as arm:
        following = arm.follow(leader, wait=False)
        eventually(lambda: set(arm.read().torque_on) == set(arm.model.names) or following.done)
        if ends == "a stop":
            insisted(arm.stop)
            arm.resume()
        else:
            insisted(partial(arm.torque, False))
        with pytest.raises(StoppedError):
            following.wait(PATIENCE)
        assert bool(arm.read().torque_on) == (ends == "a stop")
        assert not arm.read().stopped
        assert arm.home().arrived


def freed(arm: Arm, stop: Callable[[], object], number: int) -> bool:
    """Switch torque off, and stop from another thread at its step of that number; whether it made so many.

    The steps of a shared arm's server count, too, which stops it by then.
    """
    calls, stops = 0, threading.Semaphore(0)
    stopper = threading.Thread(target=insisted, args=[stop], name="stop")
    begin = Epochs.begin

    def begun(epochs: Epochs, stop: object) -> None:
        begin(epochs, stop)
        stops.release()

    def counted(method: Callable[..., Any]) -> Callable[..., Any]:
        def call(*given: Any) -> Any:
            nonlocal calls
            calls += 1
            if calls == number:
                stopper.start()
                for _ in range(2 if arm.driver.url.startswith("zenoh:") else 1):
                    assert stops.acquire(timeout=PATIENCE)
            return method(*given)

        return call

    arm.resume()
    insisted(arm.torque)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Epochs, "begin", begun)
        for cls, name in STEPS:
            patch.setattr(cls, name, counted(getattr(cls, name)))
        insisted(partial(arm.torque, False))
        made = calls >= number
    if made:
        stopper.join(PATIENCE)
        assert not stopper.is_alive()
    return made


@pytest.mark.parametrize("limp", [False, True])
def test_torque_off_is_refused_by_no_stop_whenever_it_comes(arm: Arm, limp: bool) -> None:
    number = 1
    while number < 40 and freed(arm, partial(arm.stop, limp=limp), number):
        state = arm.read()
        assert (state.torque_on, state.stopped) == ((), True), number
        number += 1 if number < 8 else number // 3
    arm.resume()
    assert number > 3


def test_torque_off_is_sent_while_another_thread_stops_the_arm(arm: Arm) -> None:
    inside, over = threading.Event(), threading.Event()

    def stop() -> None:
        with arm.driver.epochs.stopping():
            inside.set()
            over.wait(PATIENCE)

    insisted(arm.torque)
    thread = threading.Thread(target=stop)
    thread.start()
    assert inside.wait(PATIENCE)
    try:
        insisted(partial(arm.torque, False))
        assert not arm.read().torque_on
    finally:
        over.set()
        thread.join(PATIENCE)
        arm.resume()
