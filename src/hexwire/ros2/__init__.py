"""A node of ROS 2 on the wire of rmw_zenoh, without ROS.

Owns what only ROS 2 needs of an arm; `zenoh_ros2` has the wire. What an arm does is decided in `hexwire.control`.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zenoh_ros2.node import Node

__all__ = ["LOGGERS", "ros_node"]

LOGGERS = ("hexwire", "zenoh_ros2")
"""Names of the loggers whose records are the log of a node."""


def ros_node(name: str) -> Node:
    """A node of ROS 2 for a program of yours, without ROS; as a context manager it is open in its block.

    Its domain is that of ROS_DOMAIN_ID, its router that of rmw_zenoh's environment variables, and its `types` makes
    messages of ROS's own packages.

    Args:
        name: Its name.

    Raises:
        UsageError: A variable is not valid.
    """
    from zenoh_ros2.node import Node, NodeOptions
    from zenoh_ros2.types import Types
    from zenoh_ros2.zenoh_session import ZenohSettings

    from .arguments import domain_of

    zenoh = ZenohSettings.from_environment(os.environ)
    return Node(NodeOptions(name, domain=domain_of(os.environ), zenoh=zenoh, loggers=LOGGERS), Types())
