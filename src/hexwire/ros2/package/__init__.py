"""The ROS 2 package of an arm: robot description, controllers, MoveIt configuration and launch files, as text.

Owns what is in these files. Must not know the node's wire.
"""

from __future__ import annotations

from .files import make_package, package_name
from .releases import RELEASES

__all__ = ["RELEASES", "make_package", "package_name"]
