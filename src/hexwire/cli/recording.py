"""What records while a command runs, for `--record` and `--record-ros2`.

Owns the relation of the wall clock to the links' clock, and what happens if a recording fails. `hexwire.trace` owns
the contents of a recording.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING
from weakref import WeakKeyDictionary

from hexwire.errors import UsageError
from hexwire.link.base import Link
from hexwire.link.tap import Missed, TapLink, wrap_new_links

from .common import observing_states
from .exits import tell_missed

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.model.state import JointState
    from hexwire.trace.capture import Writer

__all__ = ["capturing", "record_as", "recording", "topic_for"]

_arms: WeakKeyDictionary[RobotDriver, str] = WeakKeyDictionary()
"""Names of the robots that have a topic of their own."""


def record_as(robot: RobotDriver, arm: str) -> None:
    """Record the states of a robot on a topic of their own: a command with several arms names each."""
    _arms[robot] = arm


def topic_for(robot: RobotDriver) -> str:
    """The topic of a robot's states in a recording."""
    from hexwire.trace.recording import JOINT_STATES, topic_of

    arm = _arms.get(robot)
    return JOINT_STATES if arm is None else topic_of(arm)


@contextmanager
def recording(path: str, *, force: bool, optional: bool = False) -> Iterator[None]:
    """In this context, traffic and joint states are recorded.

    A recording that cannot be started is an error before anything happens. Later write errors are counted and
    reported at the end, in one line; the command continues.

    Args:
        path: The file.
        force: Overwrite an existing file.
        optional: Continue without a recording: a stop must not fail because a disk is full.

    Raises:
        UsageError: The file cannot be created, or the package for recordings is not installed.
    """
    with capturing(path, lambda: path, force=force, optional=optional):
        yield


@contextmanager
def capturing(
    path: str,
    make_writer: Callable[[], str | Writer],
    *,
    force: bool = False,
    optional: bool = False,
    observe: Callable[[RobotDriver], object] = lambda _: None,
) -> Iterator[None]:
    """As `recording`, in any format.

    Args:
        path: Its name in messages.
        make_writer: Makes what writes it, or gives the file of a recording.
        force: For the file of a recording.
        optional: As for `recording`.
        observe: Gets the robot, before each of its states is recorded.
    """
    from hexwire.trace.capture import Capture

    missed = Missed()
    try:
        capture = Capture(make_writer(), offset=time.time() - time.monotonic(), force=force)
    except (OSError, UsageError) as error:
        if not optional:
            raise
        missed.add(error)
        try:
            yield
        finally:
            tell_missed(f"the recording {path}", missed)
        return

    def state(robot: RobotDriver, joints: JointState) -> None:
        observe(robot)
        capture.joint_state(joints, time.time(), topic_for(robot))

    def tap(link: Link) -> Link:
        return TapLink(link, missed.guard(capture.passed))

    try:
        with wrap_new_links(tap), observing_states(missed.guard(state)):
            yield
    except BaseException:
        missed.guard(capture.abandon)()
        raise
    finally:
        missed.guard(capture.close)()
        tell_missed(f"the recording {path}", missed)
