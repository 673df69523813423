"""Which interfaces and which type hashes each distribution of ROS 2 has.

Owns what differs between them. Must not know what a message is used for. The versions are those of the index of
released packages (ros/rosdistro) of August 2026.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import Enum

from .errors import UsageError

__all__ = ["NO_TYPE_HASH", "Distribution"]

NO_TYPE_HASH = "TypeHashNotSupported"
"""What rmw_zenoh writes in place of a type hash where ROS has none."""


class Distribution(Enum):
    """A distribution of ROS 2; its value is the name that ROS gives it."""

    HUMBLE = "humble"
    JAZZY = "jazzy"
    KILTED = "kilted"
    LYRICAL = "lyrical"
    ROLLING = "rolling"

    @classmethod
    def from_environment(cls, environment: Mapping[str, str]) -> Distribution:
        """The distribution that ROS_DISTRO names; Jazzy if it is not set.

        Raises:
            UsageError: There is no such distribution here.
        """
        name = environment.get("ROS_DISTRO", "") or cls.JAZZY.value
        try:
            return cls(name)
        except ValueError:
            known = ", ".join(each.value for each in cls)
            raise UsageError(f"ROS_DISTRO is {name[:80]!r}; this package knows {known}") from None

    @property
    def has_type_hashes(self) -> bool:
        """Whether peers know type hashes and descriptions; they came after Humble."""
        return self is not Distribution.HUMBLE

    @property
    def variants(self) -> tuple[str, ...]:
        """Folders of ``interfaces/variants`` whose files replace those of the same package.

        control_msgs is 4.9 in Humble, 5.9 in Jazzy and 6.10 in Kilted, Lyrical and Rolling.
        `JointTrajectoryControllerState` has ``desired`` and ``actual`` in Humble only, and ``speed_scaling_factor``
        after it, from 5.3. The feedback of `FollowJointTrajectory` has ``index`` and ``multi_dof_index`` from 6.3.
        `TransitionEvent` has ``stamp`` in place of ``timestamp`` from lifecycle_msgs 2.4.3, in Lyrical and Rolling.
        """
        return _VARIANTS.get(self, ())


_VARIANTS = {
    Distribution.HUMBLE: ("control_msgs_4",),
    Distribution.KILTED: ("control_msgs_6.3",),
    Distribution.LYRICAL: ("control_msgs_6.3", "lifecycle_msgs_2.4.3"),
    Distribution.ROLLING: ("control_msgs_6.3", "lifecycle_msgs_2.4.3"),
}
