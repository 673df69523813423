"""Connections of Zenoh whose end makes nobody wait.

Zenoh gives a TCP connection that it closes 10 s to deliver what is left (SO_LINGER), and its thread waits for that:
often the one that receives. Then nothing arrives from any other program either, not even a stop, because one
computer has vanished. Owns taking this time from each connection when it begins; the system delivers what is left
all the same. Must not know what is sent, nor import Zenoh.
"""

from __future__ import annotations

import threading
from typing import Any

from hexwire import system

__all__ = ["close_at_once"]


def close_at_once(session: Any, one: Any) -> threading.Thread:
    """Let no connection of a session wait when it ends; returns the thread that sees to it until the session ends.

    Args:
        session: Zenoh's, open.
        one: Zenoh's channel for one event: where several come at once, one look at all connections is enough.
    """
    events = session.info.declare_link_events_listener(one, history=True)

    def look() -> None:
        # It ends without an error when the session is closed.
        for _ in events:
            system.close_at_once({_ports(link) for link in session.info.links()})

    thread = threading.Thread(target=look, name="links", daemon=True)
    thread.start()
    return thread


def _ports(link: Any) -> tuple[int, int]:
    """Its own port and that of the other side; zeros for a link that has none."""
    own, other = (str(place).rpartition(":")[2] for place in (link.src, link.dst))
    return (int(own), int(other)) if own.isdecimal() and other.isdecimal() else (0, 0)
