"""Another node in a process of its own: subscribes, asks a service without end, and says what it got.

python other_process.py ENDPOINT
"""

from __future__ import annotations

import contextlib
import sys
import threading
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from zenoh_ros2_tests.tiny_types import TinyTypes

from zenoh_ros2.errors import ServiceTimeoutError
from zenoh_ros2.node import Node, NodeOptions
from zenoh_ros2.zenoh_session import ZenohSettings


def main() -> None:
    zenoh = ZenohSettings(connect=(sys.argv[1],))
    options = NodeOptions("other", zenoh=zenoh, rosout=False, type_descriptions=False)
    with Node(options, TinyTypes()) as node:
        node.subscribe("chatter", "std_msgs/msg/String", lambda message, _: print(len(message.data), flush=True))
        client = node.client("never", "tiny_msgs/srv/Echo")
        client.wait_for_service(20)
        request = client.type.request(data="x")

        def ask() -> None:
            with contextlib.suppress(ServiceTimeoutError):
                client.call(request, 600)

        threading.Thread(target=ask, daemon=True).start()
        print("ready", flush=True)
        sys.stdin.read()


if __name__ == "__main__":
    main()
