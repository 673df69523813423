"""A node of ROS 2 on the wire of rmw_zenoh, without ROS.

Owns what only ROS 2 needs of an arm; `zenoh_ros2` has the wire. What an arm does is decided in `hexwire.control`.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zenoh_ros2 import Node

__all__ = ["ros_node"]


def ros_node(name: str) -> Node:
    """A node of ROS 2 for a program of yours, without ROS; as a context manager it is open in its block.

    Its domain is that of ROS_DOMAIN_ID, its router that of rmw_zenoh's environment variables, and its `types` makes
    messages of ROS's own packages. It is one of the package `zenoh_ros2`, which has its exceptions.

    Args:
        name: Its name.

    Raises:
        UsageError: A variable is not valid.
    """
    from zenoh_ros2 import Node, NodeOptions, Types, domain_of

    from .wire import LOGGERS, RouterSettings, own_errors

    with own_errors():
        zenoh = RouterSettings.from_environment(os.environ)
        return Node(NodeOptions(name, domain=domain_of(os.environ), zenoh=zenoh, loggers=LOGGERS), Types())
