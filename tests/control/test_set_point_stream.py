"""Streams of set-points that go on while their arm is stopped, without torque, or out of reach of their network."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from tests.control.arm_bench import Bench, guide, make_bench
from tests.motion.arms import HOME

from hexwire.control.requests.set_point_stream import PAUSE, SetPointStream
from hexwire.errors import GoalError, UsageError

J1 = HOME["J1"]
THERE = {"J1": J1 + 0.5}
GOES_ON = "come since before the arm was stopped or had torque; pause them for"


def play(bench: Bench, stream: SetPointStream, seconds: float, where: dict[str, float] = THERE) -> list[str]:
    """Publish at 50 Hz; returns the refusals."""
    refused = []
    for _ in range(round(seconds * 50)):
        try:
            stream.follow(where)
        except (GoalError, UsageError) as error:
            refused.append(str(error))
        bench.turn(0.02)
    return refused


def stop_and_reset(bench: Bench) -> None:
    bench.ask(lambda: bench.arm.stop("by the test"))
    bench.ask(bench.arm.reset)


def test_set_points_are_followed_also_far_ones() -> None:
    bench = make_bench()
    assert play(bench, SetPointStream(bench.arm), 2.0) == []
    assert bench.where("J1") == pytest.approx(THERE["J1"], abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("seen", [False, True], ids=["between two set-points", "for longer"])
def test_a_stream_that_goes_on_through_a_stop_moves_nothing_after_the_reset(seen: bool) -> None:
    bench = make_bench()
    stream = SetPointStream(bench.arm)
    play(bench, stream, 0.1)
    bench.ask(lambda: bench.arm.stop("by the test"))
    if seen:
        assert "the arm is stopped (by the test" in play(bench, stream, 0.3)[0]
    bench.ask(bench.arm.reset)
    bench.turn(0.2)
    stood = bench.where("J1")
    assert stood < THERE["J1"] - 0.1
    refused = play(bench, stream, 2.0)
    assert len(refused) == 100
    assert all(GOES_ON in text for text in refused)
    assert bench.where("J1") == pytest.approx(stood, abs=0.005)
    # A pause shows that its program means it.
    bench.turn(PAUSE + 0.1)
    assert play(bench, stream, 2.0) == []
    assert bench.where("J1") == pytest.approx(THERE["J1"], abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("prevent", "permit", "text"),
    [
        (lambda b: b.arm.stop("by the test"), lambda b: b.arm.reset(), "the arm is stopped"),
        (lambda b: b.arm.enable(False), lambda b: b.arm.enable(True), "no torque on J1"),
        (lambda b: b.arm.teach_start(), lambda b: b.arm.teach_stop(), "in teach mode"),
    ],
    ids=["stop", "torque off", "teach mode"],
)
def test_a_stream_that_begins_while_the_arm_cannot_move_does_not_move_it_later(
    prevent: Callable[[Bench], str], permit: Callable[[Bench], str], text: str
) -> None:
    bench = make_bench()
    stream = SetPointStream(bench.arm)
    bench.ask(lambda: prevent(bench))
    refused = play(bench, stream, 0.6)
    assert text in refused[0]
    if text == "in teach mode":
        # Or nothing would have been taught. Shorter than a pause.
        guide(bench, "J2", 0.1, 0.2)
    bench.ask(lambda: permit(bench))
    before = bench.where("J1")
    assert GOES_ON in play(bench, stream, 1.0)[-1]
    assert bench.where("J1") == pytest.approx(before, abs=0.005)
    bench.turn(PAUSE + 0.1)
    assert play(bench, stream, 0.3) == []


def test_a_wrong_set_point_does_not_end_a_stream() -> None:
    bench = make_bench()
    stream = SetPointStream(bench.arm)
    play(bench, stream, 0.2)
    assert "limits" in play(bench, stream, 0.02, {"J1": 9.0})[0]
    assert play(bench, stream, 0.2) == []


def test_a_pause_is_as_long_as_the_command_timeout() -> None:
    bench = make_bench(command_timeout=2.0)
    stream = SetPointStream(bench.arm)
    stream.follow(THERE)
    stop_and_reset(bench)
    bench.turn(1.0)
    with pytest.raises(GoalError, match="pause them for 2 s"):
        stream.follow(THERE)
    bench.turn(2.1)
    stream.follow(THERE)


@pytest.mark.slow
@pytest.mark.parametrize("apart", [0.02, -0.02])
def test_what_a_network_held_back_is_no_pause(apart: float) -> None:
    bench = make_bench()
    stream = SetPointStream(bench.arm)
    stream.follow(THERE, sent=100.0)
    stop_and_reset(bench)
    bench.turn(3.0)
    with pytest.raises(GoalError, match=GOES_ON):
        stream.follow(THERE, sent=100.0 + apart)
    # Another sender, whose clock is an hour behind.
    bench.turn(PAUSE + 0.1)
    stream.follow(THERE, sent=100.0 - 3600.0)
