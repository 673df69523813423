"""Plays motions on several arms with a common start time.

Owns who plays what of a file; the order of things: clocks, leases, path checks, torque, a slow approach, the
motion; that either all arms begin or none; that all stop when one fails; and the calls for all arms at the same
time, with who did not answer. The arms' servers follow the motions themselves. Must not know terminals.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass, field
from itertools import permutations
from pathlib import Path
from typing import Any, TypeVar

from hexwire.control.loop.outcomes import Outcome
from hexwire.control.loop.power import give_torque
from hexwire.control.loop.reader import read_known
from hexwire.control.sharing.shared_goals import CONFIRM, HOST
from hexwire.errors import DeviceError, HexwireError, LeaseError, ServoError, UsageError
from hexwire.inputs import LARGEST_DATA, read_bytes
from hexwire.motion.teach import Taught, approach
from hexwire.motion.trajectory import Spline, Trajectory, Waypoint
from hexwire.motion.waypoint_file import parse_waypoints
from hexwire.trace.recording import arm_of, read_joint_states

from . import messages as m
from .remote import RemoteRobot

__all__ = [
    "FleetMotionError",
    "PlayReport",
    "Played",
    "PlayedArm",
    "SilentError",
    "assign",
    "attached_to",
    "each_of",
    "play_together",
    "read_motions",
]

_MOST_ANGLES = 8_000_000
_SPACING = 0.05
"""Seconds between two points of a recorded motion; closer ones would make the noise of a servo look fast."""
_COARSEST = 0.1
"""Greatest spacing to which a long motion is thinned out."""
_Samples = dict[str, list[tuple[float, float]]]
"""Times and positions of each joint."""
_MOST_POINTS = 9_000
"""Most points of a motion; an arm's server accepts 10,000."""


def read_motions(file: str, speed: float = 1.0) -> dict[str, Spline]:
    """The motions in a file, by the name of the arm; the empty name stands for any arm.

    Motions that were recorded together keep their times to each other.

    Args:
        file: A recording (.mcap) or waypoints (.json).
        speed: Factor of the speed.

    Raises:
        UsageError: It has no motion, or one that is too long.
        ConfigError: It cannot be read, or is wrong.
    """
    if file.lower().endswith(".json"):
        return {"": _scaled(parse_waypoints(read_bytes(file, largest=LARGEST_DATA), file), speed)}
    arms: dict[str, _Samples] = {}
    angles = 0
    for state in read_joint_states(file, whole=True, several=True):
        angles += len(state.position)
        if angles > _MOST_ANGLES:
            raise UsageError(f"{file} has more than {_MOST_ANGLES} angles: too many for one motion")
        joints = arms.setdefault(arm_of(state.topic), {})
        for name, angle, values in zip(state.names, state.position, state.values, strict=True):
            # Its own time: a board asks its joints one after the other.
            when, column = state.time - values.get("age", 0.0), joints.setdefault(name, [])
            if not column or when > column[-1][0]:
                column.append((when, angle))
    arms = {arm: joints for arm, joints in arms.items() if joints}
    if not arms:
        raise UsageError(f"{file} has no joint states")
    begin = min(column[0][0] for joints in arms.values() for column in joints.values())
    try:
        return {arm: _motion(joints, begin, speed) for arm, joints in arms.items()}
    except UsageError as error:
        raise UsageError(f"{file}: {error}") from None


def assign(
    motions: Mapping[str, Spline], file: str, arms: Sequence[str], pairs: Mapping[str, str] | None = None
) -> dict[str, Spline]:
    """Assign motions to arms.

    Args:
        motions: From `read_motions`.
        file: Their file, for error texts.
        arms: Names of the arms to move.
        pairs: Arm -> name in the file, where they differ.

    Raises:
        UsageError: There is no motion for an arm; the text says for which.
    """
    pairs = pairs or {}
    given: dict[str, Spline] = {}
    missing = []
    for arm in arms:
        wanted = pairs.get(arm, arm)
        if wanted in motions:
            given[arm] = motions[wanted]
        elif "" in motions and arm not in pairs:
            given[arm] = motions[""]
        else:
            missing.append(arm if wanted == arm else f"{arm} (as {wanted})")
    if missing:
        known = ", ".join(sorted(motions))
        raise UsageError(
            f"{Path(file).name} has no motion for {', '.join(missing)}, but for {known}; give it one with "
            f"--map {sorted(motions)[0]}={missing[0].partition(' ')[0]}"
        )
    return given


def _motion(joints: _Samples, begin: float, speed: float) -> Spline:
    """The motion of one arm; an arm that was recorded later waits at its first position."""
    duration = max(column[-1][0] for column in joints.values()) - begin
    spacing = max(_SPACING * speed, duration / _MOST_POINTS)
    if spacing > _COARSEST * max(speed, 1.0):
        raise UsageError(
            f"the recording lasts {duration:.0f} s, and {_MOST_POINTS * _COARSEST:.0f} s of one can be played"
        )
    count = max(1, math.ceil(duration / spacing))
    times = [duration * i / count for i in range(count + 1)]
    columns = [_at(column, begin, times) for column in joints.values()]
    taught = Taught(tuple(joints), tuple(times), tuple(zip(*columns, strict=True)))
    return taught.faster(speed).trajectory()


def _at(column: Sequence[tuple[float, float]], begin: float, times: Sequence[float]) -> list[float]:
    """A joint's positions at some times, interpolated; before the first sample it rests, and after the last."""
    found, i = [], 0
    for t in times:
        while i < len(column) - 1 and column[i + 1][0] <= begin + t:
            i += 1
        when, angle = column[i]
        if i < len(column) - 1 and begin + t > when:
            after, there = column[i + 1]
            angle += (there - angle) * (begin + t - when) / (after - when)
        found.append(angle)
    return found


def _scaled(path: Spline, speed: float) -> Spline:
    points = []
    for p in path.waypoints:
        velocity = None if p.velocity is None else tuple(speed * v for v in p.velocity)
        acceleration = None if p.acceleration is None else tuple(speed * speed * a for a in p.acceleration)
        points.append(Waypoint(p.time / speed, p.position, velocity, acceleration))
    return Spline(path.names, points)


_T = TypeVar("_T")
_A = TypeVar("_A")
Shield = Callable[[], AbstractContextManager[object]]
MOST_DOUBT = 0.010
"""Default greatest uncertainty of an arm's clock, seconds."""
_CLOCKS = 3.0
"""Seconds for the clocks of all arms to become known so well: on a busy machine the first exchanges are poor, and
others follow twice a second."""
_LEAD = 1.4
"""Least seconds from the request to the start: a refusal of one arm must reach the others before."""
_READY = CONFIRM + 0.3
"""Seconds before the start at which all arms must be ready for it."""
_MARGIN = 0.1
"""Seconds before the start at which all arms must have confirmed it; and those that an arm has to call it off."""
_LOOK, _SLACK = 0.02, 0.1
"""Seconds between two questions whether an arm is ready, and for the answer to the last one."""
_KNOT = 0.05
"""Seconds between two points of an approach."""
_SHORTEST = 0.5
"""Shortest approach, seconds."""
_POLL = 0.1
"""Seconds between two questions about the progress of a motion."""
_GRACE = 5.0
"""Seconds after its end in which an arm must arrive."""
_WATCHDOG = 1.0
"""Seconds without a call of this program after which an arm's server stops it."""
_PATIENCE = 30.0
"""Seconds for a step that needs the arm's line."""
_RESTING = 1e-6


class SilentError(HexwireError):
    """There was no result in time."""


def each_of(
    arms: Mapping[str, _A], call: Callable[[_A], _T], patience: float, *, together: bool = False
) -> tuple[dict[str, _T], dict[str, HexwireError]]:
    """Call for all arms at the same time, so that none delays another.

    Args:
        arms: The arms by name.
        call: What to do.
        patience: Seconds to wait; an interruption ends the wait at once.
        together: The first failure ends the wait.

    Returns:
        Results and errors by name.
    """
    done: dict[str, _T] = {}
    failed: dict[str, HexwireError] = {}
    changed = threading.Condition()

    def run(name: str, arm: _A) -> None:
        result: Any = None
        error: HexwireError | None = None
        try:
            result = call(arm)
        except HexwireError as problem:
            error = problem
        except Exception as problem:  # noqa: BLE001  # the other arms must learn of it
            error = DeviceError(f"the program failed: {problem}")
        with changed:
            if error is not None:
                failed[name] = error
            else:
                done[name] = result
            changed.notify_all()

    for name, arm in arms.items():
        threading.Thread(target=run, args=(name, arm), name=f"play {name}", daemon=True).start()
    deadline = time.monotonic() + patience
    with changed:
        while len(done) + len(failed) < len(arms) and not (together and failed):
            left = deadline - time.monotonic()
            if left <= 0:
                break
            changed.wait(min(left, 0.5))
        errors = dict(failed)
        if not together or not errors:
            for name in arms:
                if name not in done and name not in errors:
                    errors[name] = SilentError(f"no answer in {patience:.1f} s")
        return dict(done), errors


class FleetMotionError(DeviceError):
    """Arms that refused or failed.

    Args:
        text: What happened to the motion.
        why: Reasons by the arms' names.
    """

    def __init__(self, text: str, why: Mapping[str, str]) -> None:
        super().__init__(f"{text}: {'; '.join(f'{name}: {reason}' for name, reason in sorted(why.items()))}")
        self.why = dict(why)


@dataclass(slots=True)
class PlayedArm:
    """An arm and its motion.

    Attributes:
        robot: Attached.
        path: The motion of some joints; the others stay where they are.
    """

    robot: RemoteRobot
    path: Spline

    @property
    def name(self) -> str:
        """Its name in the fleet."""
        return self.robot.address.name


@dataclass(frozen=True, slots=True)
class Played:
    """What one arm did.

    Attributes:
        moved: When it had begun to move, seconds after the common start; NaN if it did not move.
        doubt: Uncertainty of its clock, seconds.
        slips: Stalls of its server, by which its motion was shifted.
        off: How far off the end of its motion the worst joint is, in words; empty if it is not.
        kept_by: Who kept the time of its motion: its ``board``, or the ``host``, its server.
        late: How far off the start was in the server's time at most: the uncertainty of the board's clock, or the
            period of targets of a server that sends them one by one, seconds.
    """

    moved: float
    doubt: float
    slips: int
    off: str = ""
    kept_by: str = HOST
    late: float = 0.0


@dataclass(frozen=True, slots=True)
class PlayReport:
    """How a motion went.

    Attributes:
        duration: Of the longest motion, seconds.
        arms: By name; empty after a dry run.
    """

    duration: float
    arms: Mapping[str, Played] = field(default_factory=dict)

    @property
    def skew(self) -> float:
        """Seconds between the first movement of the first and of the last arm; NaN if fewer than two moved."""
        times = [row.moved for row in self.arms.values() if math.isfinite(row.moved)]
        return max(times) - min(times) if len(times) > 1 else math.nan

    @property
    def doubt(self) -> float:
        """Uncertainty of the skew that comes from the clocks of the servers, seconds."""
        rows = sorted((row.doubt for row in self.arms.values()), reverse=True)
        return sum(rows[:2])

    @property
    def apart(self) -> float:
        """Most seconds between the starts of two arms, as far as is known before anything moves."""
        # A server begins late, but a clock is off either way.
        spans = [
            (row.doubt + (row.late if row.kept_by != HOST else 0.0), row.doubt + row.late)
            for row in self.arms.values()
        ]
        return max((early + late for (early, _), (_, late) in permutations(spans, 2)), default=0.0)


def play_together(
    arms: Sequence[PlayedArm],
    *,
    take: bool = False,
    dry_run: bool = False,
    most_doubt: float = MOST_DOUBT,
    tell: Callable[[str], object] = lambda text: None,
    shield: Shield = nullcontext,
) -> PlayReport:
    """Play motions on several arms; returns when all have arrived.

    If one arm refuses, none begins. If one fails, or this call is interrupted, all are stopped: the others might
    run into it.

    Args:
        arms: At least one; each name once.
        take: Pre-empt other holders of the leases.
        dry_run: Have the servers check the paths, and move nothing; then no holder is pre-empted.
        most_doubt: Greatest uncertainty of an arm's clock, and of its start if its board executes it, seconds.
        tell: Called with a text for each event.
        shield: Keeps signals away while the arms are stopped.

    Raises:
        FleetMotionError: Arms refused, and nothing moved; or one failed, and all were stopped.
    """
    player = _Player(arms, tell, shield, most_doubt)
    player.check_clocks()
    player.each(lambda arm: arm.robot.take(force=take and not dry_run), "no arm moved")
    try:
        player.prepare()
        if dry_run:
            return PlayReport(player.duration)
        return player.play()
    finally:
        player.give_back()


@contextmanager
def attached_to(urls: Mapping[str, str]) -> Iterator[dict[str, RemoteRobot]]:
    """Attach to several arms at once, for a `with` block.

    Args:
        urls: Addresses by the arms' names.

    Raises:
        FleetMotionError: Some cannot be reached.
    """

    def attach(url: str) -> RemoteRobot:
        robot = RemoteRobot.from_url(url)
        robot.attach()
        return robot

    robots, failed = each_of(urls, attach, _PATIENCE)
    try:
        if failed:
            raise FleetMotionError("no arm moved", {name: str(error) for name, error in failed.items()})
        yield robots
    finally:
        each_of(robots, lambda robot: robot.abort(), _PATIENCE)


class _Player:
    def __init__(
        self, arms: Sequence[PlayedArm], tell: Callable[[str], object], shield: Shield, most_doubt: float
    ) -> None:
        if not arms or len({arm.name for arm in arms}) < len(arms):
            raise UsageError("a motion needs arms, each once")
        self._arms, self._tell, self._shield = {arm.name: arm for arm in arms}, tell, shield
        self._paths: dict[str, tuple[Spline, Spline]] = {}
        self._most_doubt, self._lead = most_doubt, _LEAD

    @property
    def duration(self) -> float:
        """Seconds of the longest motion."""
        return max(path.duration for _, path in self._paths.values())

    def check_clocks(self) -> None:
        """Refuse arms whose clock does not become known well enough."""
        deadline = time.monotonic() + _CLOCKS
        while bad := self._doubtful(
            {arm.name: arm.robot.clock_offset[1] for arm in self._arms.values()}, "its clock"
        ):
            if time.monotonic() >= deadline:
                raise FleetMotionError("no arm moved", {name: str(error) for name, error in bad.items()})
            time.sleep(_LOOK)

    def _doubtful(self, doubts: Mapping[str, float], what: str) -> dict[str, HexwireError]:
        """Errors for arms of which something is not known well enough."""
        most = self._most_doubt
        return {
            name: ServoError(f"{what} is known to {1000 * doubt:.1f} ms only, and {1000 * most:.1f} ms are needed")
            for name, doubt in doubts.items()
            if not doubt <= most
        }

    def prepare(self) -> None:
        """Plan the approaches, and have the servers check everything; nothing moves."""
        began = time.monotonic()

        def check(arm: PlayedArm) -> tuple[Spline, Spline]:
            paths = _paths(arm)
            for path in paths:
                arm.robot.check_path(path)
            return paths

        self._paths = self.each(check, "no arm moved")
        # Each server checks the path again before it accepts the motion.
        self._lead = _LEAD + 2.0 * (time.monotonic() - began)

    def play(self) -> PlayReport:
        self.each(lambda arm: arm.robot.watchdog(_WATCHDOG), "no arm moved")
        powered = self.each(
            lambda arm: give_torque(arm.robot, arm.robot.model.names, arm.robot.read()), "no arm moved"
        )
        for name, joints in powered.items():
            if joints:
                self._tell(f"{name}: torque on: {' '.join(joints)}")
        # An arm without torque may have sunk since it was checked.
        self._paths = self.each(_paths, "no arm moved")
        try:
            self._run("approach", 0)
            start, ended = self._run("motion", 1)
        except _NotBegunError:
            raise
        except FleetMotionError as error:
            if self.stop(lambda arm: arm.robot.stop_own()):
                raise
            raise FleetMotionError("the arms that nobody else has taken are stopped", error.why) from None
        except BaseException:
            # Whoever interrupts this means all arms.
            self.stop()
            raise
        rows = {}
        for arm in self._arms.values():
            offset, doubt = arm.robot.clock_offset
            goal = ended[arm.name]
            moved = math.nan if goal.moved is None else goal.moved - offset - start
            rows[arm.name] = Played(moved, doubt, goal.slips, goal.text, goal.ready, goal.doubt)
        return PlayReport(self.duration, rows)

    def _run(self, what: str, number: int) -> tuple[float, dict[str, m.Goal]]:
        """Run the approaches (0) or the motions (1); returns the start time and the results."""
        longest = max(paths[number].duration for paths in self._paths.values())
        self._tell(f"{what}: {longest:.2f} s, starts in {self._lead:.1f} s")
        start, goals = self._begin(number)
        return start, self._wait(number, goals, start)

    def _begin(self, number: int) -> tuple[float, dict[str, int]]:
        """Have all arms prepare their motions, and confirm the start when all are ready.

        Returns:
            The start time and the numbers of the motions.

        Raises:
            FleetMotionError: An arm refused, and none has begun.
        """
        start = time.monotonic() + self._lead
        goals: dict[str, int] = {}

        def prepare(arm: PlayedArm) -> m.Goal:
            path = self._paths[arm.name][number]
            goal = goals[arm.name] = arm.robot.follow(path, start, anywhere=number == 0, confirm=True)
            while True:
                row = arm.robot.goal(goal)
                if row.outcome:
                    raise ServoError(row.text or row.reason)
                # Until then the board's clock is compared again and again.
                over = time.monotonic() > start - _READY
                if row.ready and (over or not number or self._doubt(arm.name, row) <= self._most_doubt):
                    return row
                if over:
                    raise ServoError("it is not ready in time")
                time.sleep(_LOOK)

        ready, failed = each_of(self._arms, prepare, self._lead - _READY + _SLACK)
        if number and not failed:
            failed = self._check_starts(ready)
        if not failed:
            patience = start - _MARGIN - time.monotonic()
            _, failed = each_of(self._arms, lambda arm: arm.robot.confirm(goals[arm.name]), patience)
        if not failed:
            return start, goals
        # Without those that still prepare: nobody confirms theirs.
        sent = dict(goals)
        accepted = {name: arm for name, arm in self._arms.items() if name in sent}
        _, kept = each_of(accepted, lambda arm: arm.robot.cancel(sent[arm.name]), _MARGIN)
        # It is not known whether these will start.
        unknown = {
            name: arm
            for name, arm in self._arms.items()
            if name in kept or isinstance(failed.get(name), SilentError)
        }
        if unknown:
            self.stop(arms=unknown)
        raise _NotBegunError("no arm began", {name: str(error) for name, error in failed.items()})

    def _check_starts(self, ready: Mapping[str, m.Goal]) -> dict[str, HexwireError]:
        """Errors of boards that do not know well enough when to start; tells whose server sends the targets."""
        for name, row in ready.items():
            if row.ready == HOST:
                self._tell(f"{name}: its server sends the targets: it may begin {1000 * row.doubt:.0f} ms late")
        return self._doubtful({name: self._doubt(name, row) for name, row in ready.items()}, "its start")

    def _doubt(self, name: str, row: m.Goal) -> float:
        """How far off the start of an arm may be because of the clocks, seconds."""
        board = row.doubt if row.ready != HOST else 0.0
        return self._arms[name].robot.clock_offset[1] + board

    def _wait(self, number: int, goals: Mapping[str, int], start: float) -> dict[str, m.Goal]:
        """Wait until all have arrived.

        Raises:
            FleetMotionError: One failed.
        """
        over = threading.Event()

        def watch(arm: PlayedArm) -> m.Goal:
            deadline = start + self._paths[arm.name][number].duration + _GRACE
            while True:
                row = arm.robot.goal(goals[arm.name])
                if row.outcome == Outcome.SUCCEEDED:
                    return row
                if row.outcome:
                    raise ServoError(row.text or row.reason)
                if time.monotonic() > deadline:
                    raise ServoError(f"has not arrived {_GRACE:g} s after the end of its motion")
                if over.wait(_POLL):
                    raise ServoError("another arm failed")

        longest = max(self._paths[arm.name][number].duration for arm in self._arms.values())
        try:
            done, failed = each_of(
                self._arms, watch, start - time.monotonic() + longest + _GRACE + _PATIENCE, together=True
            )
        finally:
            over.set()
        if failed:
            raise FleetMotionError("all arms are stopped", {name: str(error) for name, error in failed.items()})
        return done

    def each(self, call: Callable[[PlayedArm], _T], text: str) -> dict[str, _T]:
        """Call for all arms at once.

        Raises:
            FleetMotionError: It failed for some; begins with the text.
        """
        done, failed = each_of(self._arms, call, _PATIENCE)
        if failed:
            if not self._paths:
                self.give_back()
            raise FleetMotionError(text, {name: str(error) for name, error in failed.items()})
        return done

    def stop(
        self,
        call: Callable[[PlayedArm], object] = lambda arm: arm.robot.stop(),
        arms: Mapping[str, PlayedArm] | None = None,
    ) -> bool:
        """Stop arms at once, and tell which did not confirm it.

        Args:
            call: Stops one; raises `LeaseError` if another program has taken it.
            arms: All if None.

        Returns:
            False if another program has taken some.
        """
        with self._shield():
            _, failed = each_of(self._arms if arms is None else arms, call, _PATIENCE)
        taken = {name: error for name, error in failed.items() if isinstance(error, LeaseError)}
        for name, error in failed.items():
            missed = "not stopped, since" if name in taken else "THE STOP IS NOT CONFIRMED:"
            self._tell(f"{name}: {missed} {error}")
        return not taken

    def give_back(self) -> None:
        """Give the leases back; moving joints hold."""

        def leave(arm: PlayedArm) -> None:
            with suppress(HexwireError):
                arm.robot.release()

        each_of(self._arms, leave, _PATIENCE)


class _NotBegunError(FleetMotionError):
    """No arm has started; those that might have were stopped."""


def _paths(arm: PlayedArm) -> tuple[Spline, Spline]:
    """The approach and the motion of all joints of an arm.

    Raises:
        ServoError: A joint does not answer, or the arm is stopped.
    """
    robot = arm.robot
    state = read_known(robot)
    if state.stopped:
        raise ServoError(f"it is stopped; 'hexwire --port {robot.url} resume' ends the stop")
    if state.silent:
        raise ServoError(f"the position of {', '.join(state.silent)} is unknown: no answer")
    here = state.positions
    unknown = [name for name in arm.path.names if name not in here]
    if unknown:
        raise UsageError(f"it has no {', '.join(unknown)}, but {', '.join(here)}")
    path = _filled(arm.path, here)
    way = approach(robot.model, path.names, [here[name] for name in path.names], path.start)
    return _as_spline(way), path


def _filled(path: Spline, here: Mapping[str, float]) -> Spline:
    """The motion with all joints of the arm, in its order; those that it omits rest."""
    places = {name: i for i, name in enumerate(path.names)}

    def row(values: Sequence[float] | None, rest: Callable[[str], float]) -> tuple[float, ...] | None:
        if values is None:
            return None
        return tuple(values[places[name]] if name in places else rest(name) for name in here)

    points = []
    for point in path.waypoints:
        position = row(point.position, lambda name: here[name])
        still = (row(point.velocity, lambda name: 0.0), row(point.acceleration, lambda name: 0.0))
        points.append(Waypoint(point.time, position or (), *still))
    return Spline(tuple(here), points)


def _as_spline(way: Trajectory) -> Spline:
    rest = (0.0,) * len(way.names)
    if way.duration < _SHORTEST:
        return Spline(way.names, [Waypoint(0.0, way.start, rest), Waypoint(_SHORTEST, way.goal, rest)])
    points = [Waypoint(t, sample.position, sample.velocity) for t, sample in way.samples(_KNOT)]
    # Knots closer than that at the end add nothing.
    if len(points) > 2 and points[-1].time - points[-2].time < _RESTING:
        del points[-2]
    return Spline(way.names, points)
