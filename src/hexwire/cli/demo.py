"""`demo`: the whole chain, from a joint command to a moving servo and back, on an emulated arm.

Owns the order of the phases, that the arm is always safe at the end, and the emulated board in a separate process:
it reads a pipe that only this program holds open, so it ends however this program ends.
"""

from __future__ import annotations

import contextlib
import math
import os
import select
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from typing import IO, TYPE_CHECKING

import click

from hexwire.errors import DeviceError, HexwireError, ServoError, UsageError

from .exits import USAGE, note, shielded
from .options import attached, early_port, is_typed, number_option, observed_driver, on_terminal, resolve_url
from .output import say

if TYPE_CHECKING:
    from hexwire.control.loop.loop import LoopCounters, RateLoop
    from hexwire.drivers.hex7bot import Hex7BotDriver
    from hexwire.model.arm import ArmModel
    from hexwire.model.state import JointState

    from .draw import CycleSample, LiveView

__all__ = ["PlainView", "board_process", "demo", "in_degrees", "turning_pose"]

_START_TIMEOUT = 30.0
_END_TIMEOUT = 5.0


@contextmanager
def board_process(
    *, baud: int = 115200, dialect: int = 2, faults: Sequence[str] = (), physics: bool = False
) -> Iterator[str]:
    """Run `hexwire sim board` and yield the path of its terminal.

    Args:
        baud: Line rate; 0 is unpaced.
        dialect: Dialect of the board.
        faults: Fault specifications.
        physics: Simulate weight, sag and a table.

    Raises:
        UsageError: The emulator does not know a fault, or MuJoCo is not installed.
        DeviceError: The board did not start.
    """
    # -P: a file in the present folder must not stand in for a module.
    command = [sys.executable, "-P", "-m", "hexwire.cli", "sim", "board", "--until-eof"]
    command += ["--baud", str(baud), "--dialect", str(dialect), *(f"--fault={fault}" for fault in faults)]
    if sys.platform != "linux":
        command.append("--tcp=127.0.0.1:0")
    command += ["--physics"] if physics else []
    with tempfile.TemporaryFile() as errors:
        # A separate session: Ctrl-C must reach only this program, which needs the board to make the arm safe.
        process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, start_new_session=True
        )
        try:
            yield _read_path(process, errors)
        finally:
            with shielded():
                _end(process)


def _read_path(process: subprocess.Popen[bytes], errors: IO[bytes]) -> str:
    assert process.stdout is not None
    deadline = time.monotonic() + _START_TIMEOUT
    line = b""
    while not line.endswith(b"\n"):
        # Windows waits for sockets only; there the read waits until the board starts or ends.
        pipes = [] if sys.platform == "win32" else [process.stdout]
        if pipes and not select.select(pipes, [], [], max(deadline - time.monotonic(), 0))[0]:
            raise DeviceError(f"the emulated board did not start within {_START_TIMEOUT:g} s")
        byte = process.stdout.read1(256)  # type: ignore[attr-defined]  # a BufferedReader, says the documentation
        if not byte:
            status = process.wait()
            errors.seek(0)
            said = errors.read().decode(errors="replace").strip().splitlines() or [f"exit status {status}"]
            raise (UsageError if status == USAGE else DeviceError)(
                f"the emulated board did not start: {said[-1].removeprefix('error: ')}"
            )
        line += byte
    return line.decode().strip()


def _end(process: subprocess.Popen[bytes]) -> None:
    for pipe in (process.stdin, process.stdout):
        if pipe is not None:
            # It may be gone already.
            with contextlib.suppress(BrokenPipeError):
                pipe.close()
    for last_resort in (process.terminate, process.kill, None):
        try:
            process.wait(_END_TIMEOUT)
            return
        except subprocess.TimeoutExpired:
            if last_resort is not None:
                last_resort()


class PlainView:
    """Prints plain lines for a log: one per phase, and one per second while the arm moves."""

    def __init__(self) -> None:
        self._next = 0.0

    def say(self, phase: str, text: str) -> None:
        """Show the result of a phase."""
        say(f"{phase}: {text}", flush=True)

    def moving(self) -> AbstractContextManager[object]:
        """A context for the time in which the arm moves."""
        return nullcontext()

    def show(self, sample: CycleSample) -> None:
        """Show a cycle."""
        if sample.time < self._next:
            return
        self._next = math.floor(sample.time) + 1.0
        error = max(abs(a - b) for a, b in zip(sample.state.position, sample.target, strict=True))
        pose = in_degrees(sample.state)
        self.say(f"{sample.time:5.1f} s", f"{pose} deg, off by at most {math.degrees(error):.1f}")


def in_degrees(state: JointState) -> str:
    """The position of each joint in degrees, on one line."""
    return "  ".join(f"{joint.name} {math.degrees(joint.position):.1f}" for joint in state)


_SWING = math.radians(30.0)
_WATCHDOG = 1.0
"""Seconds of silence after which the board switches torque off."""
_SETTLE = 1.0
_BACK_WITHIN = math.radians(3.0)


@click.command()
@click.option("--port", metavar="URL", help="Move the real arm behind this port instead of an emulated one.")
@click.option("--yes-move-the-arm", "--yes", is_flag=True, help="Confirm that the real arm has room to move.")
@click.option(
    "--baud",
    type=click.IntRange(min=0),
    default=115200,
    show_default=True,
    metavar="N|0",
    help="Line rate; 0 runs the emulated board at full speed.",
)
@click.option("--dialect", type=click.IntRange(1, 2), metavar="1|2", help="Dialect of the board (2).")
@click.option("--fault", "faults", multiple=True, metavar="SPEC", help="A fault, as for 'sim board'.")
@number_option(
    "--duration", "SECONDS", "Time there and back; longer if a speed limit requires it.", above=0, default=6.0
)
@number_option("--rate", "HZ", "Cycles per second (20; 1.5 with dialect 1).", above=0)
def demo(
    port: str | None,
    yes_move_the_arm: bool,
    baud: int,
    dialect: int | None,
    faults: tuple[str, ...],
    duration: float,
    rate: float | None,
) -> None:
    """Move an emulated Hex7Bot there and back, with a live table.

    No hardware is needed: the board and its seven servos are emulated on a pseudo-terminal, which is opened like
    any serial port. With --yes-move-the-arm, the demo moves each joint of the real arm on --port or HEXWIRE_PORT by
    30 degrees.
    """
    port = early_port(port)
    if port is None and yes_move_the_arm:
        # A variable that is always set must not make every demo move the real arm.
        port = os.environ.get("HEXWIRE_PORT") or None
    view: PlainView | LiveView = PlainView()
    if on_terminal():
        from .draw import LiveView

        view = LiveView()
    if port is None:
        if yes_move_the_arm:
            raise UsageError("--yes-move-the-arm needs the port of the arm: give --port")
        with board_process(baud=baud, dialect=dialect or 2, faults=faults) as path:
            pace = f"at {baud} baud" if baud else "unpaced"
            view.say("started", f"an emulated Hex7Bot on {path}, {pace}")
            _run(resolve_url(path, baud or None), dialect, duration, rate, view)
        return
    if not yes_move_the_arm:
        raise UsageError("--port moves a real arm: make room for it, then add --yes-move-the-arm")
    if faults or not baud:
        raise UsageError("--fault and --baud 0 are for the emulated board, not for --port")
    # Only a serial port has a rate, and its address may name another one.
    _run(resolve_url(port, baud if is_typed("baud") else None), dialect, duration, rate, view)


def turning_pose(model: ArmModel, start: tuple[float, ...]) -> tuple[float, ...]:
    """The turning point: 30 degrees from `start` in the direction with more room, at most halfway to the limit.

    Raises:
        LimitError: A joint is outside its limits.
    """
    goal = []
    for joint, angle in zip(model.joints, start, strict=True):
        joint.check(angle)
        up, down = joint.maximum - angle, angle - joint.minimum
        goal.append(angle + min(_SWING, up / 2) if up >= down else angle - min(_SWING, down / 2))
    return tuple(goal)


def _run(url: str, dialect: int | None, duration: float, rate: float | None, view: PlainView | LiveView) -> None:
    from hexwire.control.loop.reader import raise_if_silent, read_known
    from hexwire.drivers.hex7bot import Hex7BotDriver

    robot = observed_driver(Hex7BotDriver).from_url(url, dialect=dialect)
    with attached(robot):
        report = robot.probe()
        who = f", firmware {report.firmware}" if report.firmware else ", the chapter's"
        view.say("identified", f"dialect {report.dialect}{who}")
        ids = [joint.servo_id for joint in robot.model.joints]
        silent = [servo_id for servo_id in ids if robot.ping(servo_id) is None]
        view.say("pinged", f"{len(ids) - len(silent)} of {len(ids)} servos answer")
        raise_if_silent([(i, joint.name) for i in silent if (joint := robot.model.by_servo(i))])
        state = read_known(robot)
        view.say("read", f"{in_degrees(state)} deg")
        goal = turning_pose(robot.model, state.position)
        # The arm is made safe before the drawing ends, since a blocked terminal must not delay that.
        with view.moving():
            summary = _move(robot, state.position, goal, duration, rate or robot.command_rate, view)
        view.say("torque off", "all joints")
    view.say("summary", summary)


def _move(
    robot: Hex7BotDriver,
    start: tuple[float, ...],
    goal: tuple[float, ...],
    duration: float,
    rate: float,
    view: PlainView | LiveView,
) -> str:
    """Torque on, there and back, torque off; returns the summary.

    Raises:
        ServoError: The arm did not come back.
    """
    from hexwire.control.motion.motions import MotionObserver, MotionOptions, run_motion
    from hexwire.drivers.base import StopMode
    from hexwire.model.state import JointFlag
    from hexwire.motion.quintic import Quintic
    from hexwire.motion.safety import SafetyLimits
    from hexwire.motion.trajectory import Spline, Waypoint

    from .draw import CycleSample

    names = robot.model.names
    leg = max(duration / 2, Quintic.shortest_duration(start, goal, [j.max_speed for j in robot.model.joints]))
    rest = (0.0,) * len(names)
    path = Spline(names, [Waypoint(t, at, rest, rest) for t, at in ((0.0, start), (leg, goal), (2 * leg, start))])

    class Watch(MotionObserver):
        """Draws every cycle, and keeps how those of the path itself kept their time."""

        timing: RateLoop | None = None
        first: JointState

        def started(self, timing: RateLoop) -> None:
            self.timing, self.began, self.before = timing, robot.now(), _counters(robot)
            self.seen(self.first)

        def seen(self, state: JointState) -> None:
            if self.timing is None:
                self.first = state
                return
            due, rate = self.timing.due, self.timing.achieved
            if due < path.duration - 1e-6:
                self.cycles, self.rate = replace(self.timing.counters), rate
            retries = robot.host_counters()["retries"] - self.before["retries"]
            # Where the joints should have been when they were sampled, not where they are sent next.
            target = path.sample(state.stamp - self.began).position
            t = min(due, path.duration)
            view.show(CycleSample(t, path.duration, state, target, rate, robot.round_trips[-1], retries))

    watch = Watch()
    options = MotionOptions(
        tolerance=_BACK_WITHIN,
        grace=max(_SETTLE, 3 / rate),
        rate=rate,
        # Its view shows the loop and each target.
        host_timed=True,
        # Faults must be visible during the demo, and reported at its end.
        limits=SafetyLimits(
            following_error=math.inf,
            load=math.inf,
            collision_load=math.inf,
            max_age=math.inf,
            faults=JointFlag(0),
        ),
        watchdog=_WATCHDOG,
        watchdog_mode=StopMode.TORQUE_OFF,
    )
    result = run_motion(robot, path, options, observer=watch, safe=_torque(robot, view))
    if result.off:
        off = ", ".join(f"{row.joint} by {math.degrees(row.by):.1f} deg" for row in result.off)
        raise ServoError(f"the arm did not come back to where it started: {off}")
    result.require()
    return _summary(robot, watch.cycles, watch.rate, watch.before)


def _summary(robot: Hex7BotDriver, cycles: LoopCounters, rate: float, before: dict[str, int]) -> str:
    count = {name: value - before[name] for name, value in _counters(robot).items()}
    trips = sorted(list(robot.round_trips)[-count["requests"] :])
    p50, p99 = (1000 * trips[min(int(share * len(trips)), len(trips) - 1)] for share in (0.50, 0.99))
    return (
        f"dialect {robot.dialect}, {cycles.cycles} cycles at {rate:.2f} Hz ({cycles.late} late, "
        f"{cycles.skipped} skipped), round trip p50 {p50:.1f} ms p99 {p99:.1f} ms, "
        f"{count['retries']} retries, {count['dropped']} dropped frames"
    )


def _counters(robot: Hex7BotDriver) -> dict[str, int]:
    """Requests and retries of this side, and frames dropped by either side; an old board does not count them."""
    host, board = robot.host_counters(), robot.board_counters()
    dropped = host["bad_frames"] + host["stale_frames"] + board.get("bad_checks", 0) + board.get("bad_frames", 0)
    return {"requests": host["requests"], "retries": host["retries"], "dropped": dropped}


@contextmanager
def _torque(robot: Hex7BotDriver, view: PlainView | LiveView) -> Iterator[None]:
    """Switch torque on, and off at the end, even after an error.

    Raises:
        ServoError: A joint did not confirm that torque is off.
    """
    from hexwire.control.loop.power import switch_torque
    from hexwire.drivers.abilities import Watchdog

    safety = "; the board switches it off if this program dies"
    if not robot.can(Watchdog):
        safety = "; it stays on if this program is killed: dialect 1 has no watchdog"
    try:
        view.say("torque on", " ".join(robot.torque(True)) + safety)
        yield
    except BaseException:
        with shielded():
            try:
                switch_torque(robot, False, robot.model.names)
            except HexwireError as error:
                note(f"warning: the arm may still have torque: {error}")
            else:
                note("torque off: all joints")
        raise
    with shielded():
        switch_torque(robot, False, robot.model.names)
