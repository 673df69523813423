"""A router in the test's process, at a port of its own."""

from __future__ import annotations

import json
from typing import Any

import zenoh
from tests.link.far_ends import free_port


class Router:
    """A router in this process, which can be restarted at the same place."""

    def __init__(self, endpoint: str = "") -> None:
        self.endpoint = endpoint or f"tcp/127.0.0.1:{free_port()}"
        self._session: Any = None
        self.start()

    def start(self) -> None:
        config = zenoh.Config()
        config.insert_json5("mode", json.dumps("router"))
        config.insert_json5("listen/endpoints", json.dumps([self.endpoint]))
        config.insert_json5("scouting/multicast/enabled", "false")
        # Otherwise it waits half a second for what it finds.
        config.insert_json5("scouting/delay", "0")
        self._session = zenoh.open(config)

    def stop(self) -> None:
        self._session.close()
