"""A leader arm beside the arm of a front: read all the time, and followed while a person attends to that.

Owns what may be asked for, which arm can lead which, that a leader has no torque while it is followed, and what a
person is told of it. Must not know pages.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hexwire.drivers.registry import is_same_arm
from hexwire.errors import LinkLostError, StoppedError, UsageError
from hexwire.inputs import Item
from hexwire.wire.command_frame import Status

from ..loop.known_state import known_joints
from ..loop.owner import RobotOwner
from ..loop.power import STOP_LATCHED, Torques, switch_torque
from ..motion.following import following_rules
from ..motion.held_following import HeldFollowing
from ..motion.path_check import PathCheck

if TYPE_CHECKING:
    from hexwire.drivers.base import RobotDriver
    from hexwire.epochs import Token
    from hexwire.model.state import JointState

    from .controlled_arm import ControlledArm

__all__ = ["FollowRequest", "Leader", "read_following"]

_MEET = 0.2
"""Share of the speed limits until the follower has met the leader, as for `hexwire follow`."""

_SLOWEST = 0.2
"""Seconds between two targets of an arm whose states are as rare, as from a board with the chapter's sketch."""


@dataclass(frozen=True, slots=True)
class FollowRequest:
    """What is asked for.

    Attributes:
        speed: Share of the joints' speed limits that the follower may use.
        force: Load, as a fraction of full scale, at which its gripper stops closing; 1 for no limit.
    """

    speed: float = 0.3
    force: float = 0.35


def read_following(args: Mapping[str, object]) -> FollowRequest:
    """Check a request from outside; it may have ``speed`` and ``force``.

    Raises:
        UsageError: It is malformed; the text names the value.
    """
    row = Item(args).table((), ("speed", "force"))
    return FollowRequest(**{name: each.number(0.01, 1.0) for name, each in row.items()})


class Leader:
    """A leader for one arm. Any thread may call its methods.

    Args:
        robot: The leader, not attached.
        arm: The arm that may follow it.
        mirror: The arms face each other: base and wrist turn the other way.

    Attributes:
        owner: Reads the leader; it has no controllers.
        mirror: The arms face each other.

    Raises:
        UsageError: It cannot lead this arm: it is the same one, or has other joints.
    """

    def __init__(self, robot: RobotDriver, arm: ControlledArm, *, mirror: bool = False) -> None:
        follower = arm.owner.robot
        if is_same_arm(robot, follower):
            raise UsageError("an arm cannot follow itself")
        self.mirror, self._arm = mirror, arm
        self._check = PathCheck(arm.settings.model, arm.settings.kinematics, arm.settings.table)
        self._rules = following_rules(robot, follower, self._check, mirror=mirror)
        # Nothing is sent to it but "torque off": no watchdog, and no stop when its cable comes off.
        limits = PathCheck.limits_only(robot.model)
        self.owner = RobotOwner(robot, check=limits, watchdog=0.0, stop_on_failure=False)

    def open(self) -> None:
        """Connect, and read from now on; its torque stays as it is.

        Raises:
            UsageError: Its line is too slow: what it tells would always count as silence.
            HexwireError: As `RobotOwner.connect`.
        """
        try:
            self.owner.connect()
            if self.owner.command_period > _SLOWEST:
                url = self.owner.robot.url
                raise UsageError(
                    f"{url} says too rarely where it is to be followed; use a board with hexwire's firmware"
                )
            self.owner.start(())
        except BaseException:
            self.owner.shutdown()
            raise

    def close(self) -> None:
        """Read no more, and detach; its torque stays as it is."""
        self.owner.shutdown()

    @property
    def lost(self) -> str:
        """Why it cannot be read; empty if it can."""
        return "" if self.owner.connected else f"the leader is not connected: {self.owner.error}"

    def release(self, asked: Token) -> None:
        """Switch its torque off, so that a hand can move it.

        Args:
            asked: When following was asked for, a mark of the follower's stops.

        Raises:
            StoppedError: It is stopped, or the follower was stopped since.
            HexwireError: It does not answer, or a joint does not confirm it: it would work against the hand.
        """
        if self.owner.newest().stopped:
            raise StoppedError("following", Status.STOPPED, f"the leader is stopped; {STOP_LATCHED}")
        self._arm.owner.robot.epochs.check(asked, "following")
        switch_torque(self.owner, False, self.owner.model.names)

    def following(
        self,
        request: FollowRequest,
        age: Callable[[], float],
        silence: float,
        on_end: Callable[[str], object],
    ) -> HeldFollowing:
        """The controller of the follower for one following.

        Args:
            request: What is asked for.
            age: As in `HeldFollowing`.
            silence: As in `HeldFollowing`.
            on_end: As in `HeldFollowing`.

        Raises:
            HexwireError: The leader cannot be read.
        """
        arm, owner = self._arm, self.owner
        if not owner.connected:
            raise LinkLostError(f"the leader is not connected: {owner.error}")
        newest = owner.newest()
        speeds = {
            joint.name: min(request.speed * joint.max_speed, joint.guided_speed)
            for joint in arm.settings.model.joints
        }
        rules = following_rules(
            owner.robot,
            arm.owner.robot,
            self._check,
            mirror=self.mirror,
            meet=min(_MEET, request.speed),
            force=request.force,
            max_speed=speeds,
        )
        return HeldFollowing(
            rules,
            lambda: owner.state or newest,
            owner.now,
            arm.owner.command_period,
            age=age,
            silence=silence,
            check=self._check,
            lost=lambda: self.lost,
            on_end=on_end,
        )

    def row(self) -> dict[str, object]:
        """What a person is told of it, for JSON.

        ``led`` is where it leads each joint of the follower: radians by name, None where that is unknown.
        """
        owner = self.owner
        state: JointState | None = owner.state if owner.connected else None
        known = known_joints(state, owner.now())
        positions = {} if state is None else {name: state[name].position for name in known}
        led = self._rules.led(positions)
        return {
            "robot": owner.model.name,
            "url": owner.robot.url,
            "mirror": self.mirror,
            "error": self.lost or ("" if known else "the leader is silent"),
            "stopped": bool(state is not None and known and state.stopped),
            "torque": Torques.of(owner.model.names, state, owner.now()).short,
            "led": {name: round(angle, 4) if math.isfinite(angle) else None for name, angle in led.items()},
        }
