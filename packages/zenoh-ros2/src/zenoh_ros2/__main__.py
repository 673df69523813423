"""A Zenoh router for nodes, where there is no ROS to start one: ``python -m zenoh_ros2``.

Owns its options. Settings are those of `rmw_zenohd`, as far as Python can give them.
"""

from __future__ import annotations

import argparse
import signal
import sys
import threading

from .zenoh_session import open_router

ENDPOINT = "tcp/localhost:7447"


def main() -> int:
    """Run the router until a signal ends it; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m zenoh_ros2", description="Run a Zenoh router for ROS 2 nodes.")
    parser.add_argument(
        "--listen",
        metavar="ENDPOINT",
        default=ENDPOINT,
        help="where nodes connect; tcp/[::]:7447 lets every machine of the network in (default: %(default)s)",
    )
    options = parser.parse_args()
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    try:
        router = open_router(options.listen)
    except OSError as error:
        print(error, file=sys.stderr)
        return 1
    print(f"the router is at {options.listen}; Ctrl-C ends it", flush=True)
    ended.wait()
    router.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
