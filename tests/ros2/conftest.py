from __future__ import annotations

from zenoh_ros2_tests.fixtures import make_node, router, settings

__all__ = ["make_node", "router", "settings"]
