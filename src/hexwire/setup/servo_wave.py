"""Waves with one servo of a bus: the servo as an arm of one joint, moved by the owner like every other robot.

Owns the controller that moves it back and forth about a position and records how it follows, the limits of such an
arm, the torque around a wave, the measurement of backlash by a small one, and what ends it: time, the caller, a
fault, silence, a stop. Must not know terminals or pages; the shape is a `Wave` or any function of time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from hexwire.bus.setup import read_raw
from hexwire.control.loop.owner import RobotOwner
from hexwire.control.loop.reader import read_known
from hexwire.control.loop.target import SingleMotion
from hexwire.control.motion.path_check import PathCheck
from hexwire.drivers.arm_file import BusArmFile
from hexwire.drivers.bus_arm import BusArm
from hexwire.errors import HexwireError, ServoError, UsageError
from hexwire.model.arm import ArmModel, JointModel
from hexwire.model.state import JointFlag, JointReading, JointState, JointTarget
from hexwire.motion.backlash import BACKLASH_AMPLITUDE, BACKLASH_SECONDS, backlash, backlash_angle

if TYPE_CHECKING:
    from hexwire.bus.servo_bus import ServoBus

__all__ = [
    "WAVE_RATE",
    "WaveController",
    "WaveEnd",
    "WaveSample",
    "and_back",
    "bring_back",
    "measure_backlash",
    "one_servo",
    "own_limits",
    "run_wave",
    "standing",
]


class WaveController(SingleMotion):
    """Moves one joint for a time. Nothing is sent ahead: each target lasts one period.

    The wave waits while its program does not run, so that the joint makes no jump, and goes as far as it was to.

    Args:
        start: The joint, where it stands.
        wave: Distance from there at a time since the beginning, radians.
        seconds: Duration.
        period: Seconds between two targets.
        most_silent: Number of states in a row without an answer of the joint that end the wave.
        on_sample: Called with the time of each answer since the beginning, the last target, and the answer.

    Attributes:
        fault: Why it ended early; empty if it did not.
        missed: Number of states without an answer.
    """

    def __init__(
        self,
        start: JointReading,
        wave: Callable[[float], float],
        seconds: float,
        *,
        period: float,
        most_silent: int,
        on_sample: Callable[[float, float, JointReading], object],
    ) -> None:
        super().__init__((start.name,))
        self.fault, self.missed = "", 0
        self._start, self._wave, self._seconds, self._period = start, wave, seconds, period
        self._most_silent, self._on_sample = most_silent, on_sample
        self._silent, self._target = 0, math.nan
        self._looked = math.inf

    def judge(self, state: JointState, velocity: Sequence[float], now: float) -> None:
        """Record an answer; end at a fault, or if the joint stays silent."""
        joint = state[self._start.name]
        # Noise destroys an answer now and then; that is no reason to stop.
        self._silent = self._silent + 1 if joint.flags & JointFlag.SILENT else 0
        self.missed += bool(self._silent)
        if self._silent >= self._most_silent:
            self._end(f"fell silent: {self._silent} samples in a row are missing; check cable and power")
        elif faults := joint.flags.faults & ~JointFlag.SILENT:
            self._end(f"stopped: {faults}")
        elif not self._silent and self.moving:
            self._on_sample(self._elapsed(now), self._target, joint)

    def cycle(self, state: JointState, now: float, lead: float) -> JointTarget | None:
        """The next target."""
        if self._begun == -math.inf:
            self._begun = now
        t = self._elapsed(now)
        if t >= self._seconds:
            self.over = True
        if self.over:
            return None
        self._target = self._start.position + self._wave(t)
        return JointTarget.of({self._start.name: self._target}, self._period)

    def _elapsed(self, now: float) -> float:
        """Seconds of the wave."""
        self._begun += max(0.0, now - self._looked - _MOST_LATE * self._period)
        self._looked = now
        return now - self._begun

    def _end(self, fault: str) -> None:
        if not self.over:
            self.fault, self.over = fault, True


WAVE_RATE = 50.0
"""Goals and samples per second."""
_MOST_SILENT = 25
"""Samples in a row that may be missing: half a second."""
_RETURN = 0.5
"""Seconds for the way back to the start."""
_MOST_LATE = 2
"""Periods from one target to the next that count for a wave."""


class WaveSample(NamedTuple):
    """One answer of the servo during a wave. Angles are measured from where it stood at the beginning.

    Attributes:
        t: Seconds since the beginning.
        goal: The last goal, radians.
        position: Its position, radians.
        velocity: Radians per second.
        load: Fraction of full load.
    """

    t: float
    goal: float
    position: float
    velocity: float
    load: float


@dataclass
class WaveEnd:
    """How a wave ended.

    Attributes:
        complete: It lasted as long as it was to.
        missed: Number of samples without an answer.
        samples: The samples.
    """

    complete: bool = False
    missed: int = 0
    samples: list[WaveSample] = field(default_factory=list)

    @property
    def farthest_off(self) -> float:
        """Largest distance between goal and position, radians; 0.0 without samples."""
        return max((abs(row.goal - row.position) for row in self.samples), default=0.0)


def own_limits(bus: ServoBus, servo_id: int) -> tuple[int, int] | None:
    """The limits that a servo keeps, counts; None if it has none.

    Raises:
        UsageError: It does not control its position.
        ServoError: It does not answer.
    """
    registers = bus.series_of(servo_id).registers
    if "mode" in registers and (mode := read_raw(bus, servo_id, "mode")):
        raise UsageError(f"servo {servo_id} is in mode {mode}, not in position mode (0): a goal would not stop it")
    for name in ("min_position_limit", "min_angle_limit"):
        if name in registers:
            least, most = read_raw(bus, servo_id, name), read_raw(bus, servo_id, name.replace("min", "max"))
            return (least, most) if most > least else None
    return None


def one_servo(bus: ServoBus, servo_id: int, amplitude: float) -> BusArm:
    """Make an arm of one servo on an open bus, limited to a wave and to the servo's own limits.

    Args:
        bus: The bus, which knows the servo's series; it stays open when the arm is detached.
        servo_id: The servo.
        amplitude: Distance to either side of where it stands, radians.

    Raises:
        UsageError: The wave would leave the servo's own limits, or the servo does not control its position.
        ServoError: The servo does not answer, or has a fault.
    """
    series = bus.series_of(servo_id)
    limits = own_limits(bus, servo_id)
    reading = bus.read(servo_id, "present_position").check()
    scale = reading.register.si_factor
    counts = reading.raw or 0
    reach = math.ceil(amplitude / scale) + 2
    if limits is not None:
        least, most = limits
        if counts - reach < least or counts + reach > most:
            raise UsageError(
                f"servo {servo_id} is at {counts} and may move from {least} to {most}: "
                f"{math.degrees(amplitude):g} deg to either side is too much"
            )
    name = f"servo {servo_id}"
    joint = JointModel(name, servo_id, series.value, counts, 1, 0.0, scale, -reach * scale, reach * scale, math.inf)
    return BusArm(bus.link, arm=BusArmFile(ArmModel("one servo", (joint,)), bus.timing.baud), bus=bus)


def standing(arm: BusArm) -> JointReading:
    """Read the state of the only servo before it is moved.

    Raises:
        ServoError: It does not report its position.
    """
    joint = read_known(arm)[arm.model.names[0]]
    if not joint.flags & JointFlag.SILENT:
        return joint
    servo_id = arm.model.joints[0].servo_id
    raise ServoError(f"servo {servo_id} does not answer: check cable and power", servo_id=servo_id)


def and_back(angle: Callable[[float], float], seconds: float) -> tuple[Callable[[float], float], float]:
    """Add the way back to the start: returns the longer wave and its duration."""
    last = angle(seconds)

    def longer(t: float) -> float:
        return angle(t) if t < seconds else last * max(0.0, 1.0 - (t - seconds) / _RETURN)

    # The last goal must be the start itself, however late it is.
    return longer, seconds + _RETURN + _MOST_LATE / WAVE_RATE


def run_wave(
    arm: BusArm,
    start: JointReading,
    angle: Callable[[float], float],
    seconds: float,
    end: WaveEnd,
    *,
    go_on: Callable[[], bool],
    clock: Callable[[], float],
    sleep: Callable[[float], object],
    on_sample: Callable[[WaveSample], object] = lambda sample: None,
) -> None:
    """Move the servo and collect samples, which are in `end` whatever ends the wave.

    The servo is left where the wave ends, with torque; each goal lasts 20 ms, so it stops as soon as none comes.

    Args:
        arm: From `one_servo`, attached, with torque.
        start: The servo, where it stands.
        angle: Distance from there at a time since the beginning, radians.
        seconds: Duration.
        end: Receives the samples.
        go_on: Asked before each goal; the wave ends as soon as it returns False.
        clock: Monotonic seconds.
        sleep: Waits for a number of seconds.
        on_sample: Called with each sample, in the thread of the caller.

    Raises:
        ServoError: The servo has a fault, is silent for too long, or was stopped.
    """
    servo_id = arm.model.joints[0].servo_id

    def sample(t: float, target: float, joint: JointReading) -> None:
        row = WaveSample(t, target - start.position, joint.position - start.position, joint.velocity, joint.load)
        end.samples.append(row)
        on_sample(row)

    controller = WaveController(
        start, angle, seconds, period=1 / WAVE_RATE, most_silent=_MOST_SILENT, on_sample=sample
    )
    # After a failure the servo is brought back or held where it is, as the caller wants.
    owner = RobotOwner(
        arm,
        # One servo, on a bench or in an arm whose other joints it does not know.
        check=PathCheck.limits_only(arm.model),
        borrowed=True,
        command_rate=WAVE_RATE,
        stop_on_failure=False,
        clock=clock,
        sleep=sleep,
    )
    asked = True
    with owner:
        owner.group.members = (controller,)
        while not controller.over and (asked := go_on()):
            owner.turn()
        stopped = controller.reason
    end.missed = controller.missed
    if controller.fault:
        raise ServoError(f"servo {servo_id} {controller.fault}", servo_id=servo_id)
    if stopped is not None:
        raise ServoError(f"stopped: {stopped}; clear it with 'hexwire resume'", servo_id=servo_id)
    end.complete = asked


def bring_back(arm: BusArm, start: JointReading, *, keep_torque: bool, sleep: Callable[[float], object]) -> bool:
    """Return the servo to its start, and switch its torque off unless it had some.

    Returns:
        False if it does not confirm that its torque is off.
    """
    arm.write(JointTarget.of({start.name: start.position}, duration=_RETURN))
    sleep(_RETURN + 0.2)
    return keep_torque or bool(arm.torque(False))


def measure_backlash(
    bus: ServoBus,
    servo_id: int,
    *,
    clock: Callable[[], float],
    sleep: Callable[[float], object],
    go_on: Callable[[], bool] = lambda: True,
    shield: Callable[[], AbstractContextManager[object]] = nullcontext,
) -> float:
    """Move a servo by 3 degrees to either side, three times, and back.

    Args:
        bus: The open bus, which knows the servo's series.
        servo_id: The servo.
        clock: Monotonic seconds.
        sleep: Waits for a number of seconds.
        go_on: Asked before each goal; the wave ends as soon as it returns False.
        shield: Protects the way back from signals.

    Returns:
        The backlash, radians; NaN if it was ended early.

    Raises:
        UsageError: The servo is too near to one of its limits, or not in position mode.
        ServoError: It is silent, has a fault, or was stopped.
        StoppedError: The arm is stopped.
    """
    with one_servo(bus, servo_id, BACKLASH_AMPLITUDE) as arm:
        start = standing(arm)
        had_torque = bool(start.flags & JointFlag.TORQUE_ON)
        if not arm.torque(True):
            raise ServoError(f"servo {servo_id} does not confirm its torque", servo_id=servo_id)
        end = WaveEnd()

        def back() -> None:
            # Refused after a stop: the servo holds where it is.
            with shield():
                if not bring_back(arm, start, keep_torque=had_torque, sleep=sleep):
                    raise ServoError(f"servo {servo_id} does not confirm its torque off", servo_id=servo_id)

        try:
            run_wave(arm, start, backlash_angle, BACKLASH_SECONDS, end, go_on=go_on, clock=clock, sleep=sleep)
        except BaseException:
            # What ended it must be reported first.
            with suppress(HexwireError):
                back()
            raise
        back()
    return backlash((row.t, row.position) for row in end.samples)
