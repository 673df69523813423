"""Fixtures: a router, nodes at it, and a bare session of Zenoh beside them."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import zenoh
from zenoh_ros2_tests.router import Router
from zenoh_ros2_tests.tiny_types import TinyTypes

from zenoh_ros2.node import Node, NodeOptions
from zenoh_ros2.zenoh_session import ZenohSettings


@pytest.fixture
def router() -> Iterator[Router]:
    router = Router()
    yield router
    router.stop()


@pytest.fixture
def settings(router: Router) -> ZenohSettings:
    return ZenohSettings(connect=(router.endpoint,))


@pytest.fixture
def make_node(settings: ZenohSettings) -> Iterator[Callable[..., Node]]:
    """Opens nodes with tiny types, and closes them at the end."""
    with contextlib.ExitStack() as stack:

        def make(name: str = "talker", **options: Any) -> Node:
            types = options.pop("types", None)
            # Tiny types know neither log records nor descriptions.
            extras = {"rosout": types is not None, "type_descriptions": types is not None}
            chosen = NodeOptions(name, zenoh=settings, **(extras | options))
            return stack.enter_context(Node(chosen, types or TinyTypes()))

        yield make


@pytest.fixture
def raw(router: Router) -> Iterator[Any]:
    """A bare Zenoh session at the same router: what others might send."""
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps("peer"))
    config.insert_json5("connect/endpoints", json.dumps([router.endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("scouting/delay", "0")
    config.insert_json5("timestamping/enabled", "true")
    session = zenoh.open(config)
    yield session
    session.close()
