"""What the tests of the package share: the fixtures here, and those of every test of the repository."""

from __future__ import annotations

from tests.conftest import _no_thread_left
from zenoh_ros2_tests.fixtures import make_node, raw, router, settings

__all__ = ["_no_thread_left", "make_node", "raw", "router", "settings"]
