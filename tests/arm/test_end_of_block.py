"""What becomes of a motion that a verb in another thread waits for when the arm's ``with`` block ends."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from itertools import product
from pathlib import Path
from typing import Any

from tests.arm.arms import KINDS, TIMED, connected
from tests.few import few
from tests.waits import PATIENCE, eventually

from hexwire import Arm, deg
from hexwire.arm.front import Front
from hexwire.control.motion.motion_options import MotionObserver
from hexwire.control.motion.motion_result import MotionResult
from hexwire.errors import HexwireError, StoppedError, UsageError


def normally(arm: Arm) -> None:
    arm.__exit__(None, None, None)


def raising(error: BaseException) -> Callable[[Arm], None]:
    return lambda arm: arm.__exit__(type(error), error, None)


WAYS: dict[str, tuple[Callable[[Arm], None], bool]] = {
    "the end": (normally, False),
    "an error": (raising(ValueError("mine")), False),
    "ctrl-c": (raising(KeyboardInterrupt()), True),
    "detach": (lambda arm: arm.detach(), False),
    "the end of the program": (lambda arm: arm._leave(), False),
}


@few(
    "kind, way",
    product(KINDS | TIMED, WAYS),
    *product(["bus"], WAYS),
    ("board", "the end"),
    ("board", "ctrl-c"),
    ("timed board", "ctrl-c"),
)
def test_the_end_of_the_block_ends_the_motion_of_a_verb_in_another_thread(
    kind: str, way: str, tmp_path: Path
) -> None:
    leave, stops = WAYS[way]
    raised: list[HexwireError] = []
    left: list[tuple[bool, bool]] = []
    with connected(kind, tmp_path) as arm:
        arm.home()
        joint = arm.model.names[0]

        def move() -> None:
            try:
                arm.move({joint: deg(40)}, relative=True, duration=30.0)
            except HexwireError as error:
                raised.append(error)

        def seen(*, torque_off: bool = False) -> None:
            if not left:
                left.append((arm._claims.now is not None, arm.read().stopped))
            detach(torque_off=torque_off)

        detach: Any = arm.driver.detach
        arm.driver.detach = seen  # type: ignore[method-assign]
        before = arm.read()[joint].position
        thread = threading.Thread(target=move, daemon=True)
        thread.start()
        eventually(lambda: abs(arm.read()[joint].position - before) > deg(0.3))
        with suppress(ValueError, KeyboardInterrupt):
            leave(arm)
        thread.join(PATIENCE)
        assert not thread.is_alive()
        assert left == [(False, stops)]
        assert [type(error) for error in raised] == [StoppedError if stops else UsageError]
        assert stops or "the motion was ended before it arrived" in str(raised[0])


def test_a_motion_that_has_arrived_when_the_block_ends_is_no_error(tmp_path: Path) -> None:
    class Ends(MotionObserver):
        def ended(self, result: MotionResult) -> None:
            claim = arm._claims.now
            assert claim is not None
            claim.end("the block has ended")

    with connected("board", tmp_path) as first:
        arm = Arm(first.driver, front=Front(Ends()))
        assert arm.move({"J1": deg(1)}, relative=True).arrived


@few("kind, way", product(KINDS | TIMED, WAYS), *product(["board"], WAYS))
def test_who_is_asked_by_a_program_may_end_the_block_without_waiting_for_that_program(
    kind: str, way: str, tmp_path: Path
) -> None:
    leave, _ = WAYS[way]
    raised: list[HexwireError] = []
    with connected(kind, tmp_path) as arm:
        file = tmp_path / "program.toml"
        file.write_text('[[steps]]\nask = "go on?"\n[[steps]]\npose = "home"\n')

        def ask(text: str) -> None:
            with suppress(ValueError, KeyboardInterrupt):
                leave(arm)

        def play() -> None:
            try:
                arm.play(file, ask=ask)
            except HexwireError as error:
                raised.append(error)

        thread = threading.Thread(target=play, daemon=True)
        thread.start()
        thread.join(PATIENCE)
        assert not thread.is_alive()
        assert len(raised) == 1
        assert not arm.driver.is_attached
