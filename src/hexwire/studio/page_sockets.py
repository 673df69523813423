"""NiceGUI's own socket: a browser may speak only for the pages that its session has loaded.

Owns this check, in front of NiceGUI's handlers: NiceGUI trusts whoever names the id of a page. Must not know what a
page shows.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

from nicegui import Client, core

from .guard import SESSION

__all__ = ["OWNER", "guard_page_sockets"]

_log = logging.getLogger(__name__)

OWNER = "hexwire.session"
"""Key in the storage of a page, with the key of the session that has loaded it."""

_EVENTS = ("event", "javascript_response", "ack", "log")


def guard_page_sockets() -> None:
    """Put the check in front of NiceGUI's handlers; once in a program."""
    handlers = core.sio.handlers["/"]
    for name in _EVENTS:
        handlers[name] = _checked(handlers[name])
    shake_hands = handlers["handshake"]

    async def handshake(sid: str, data: Any) -> bool:
        if not _owns(sid, data):
            _log.warning("a socket asked for a page of another session")
            return False
        done: bool = await shake_hands(sid, data)
        return done

    handlers["handshake"] = handshake
    connect = handlers["connect"]

    async def on_connect(sid: str, environ: dict[str, Any], auth: object = None) -> object:
        from urllib.parse import parse_qs

        query = parse_qs(environ.get("QUERY_STRING", ""))
        claimed = query.get("client_id", [None])[0]
        # NiceGUI itself refuses a page that it has forgotten, in the words on which the page loads itself again.
        if claimed in Client.instances and not _owns(sid, {"client_id": claimed}, environ):
            _log.warning("a socket asked for a page of another session")
            return False
        return await connect(sid, environ, auth)

    handlers["connect"] = on_connect


def _checked(handler: Callable[[str, Any], object]) -> Callable[[str, Any], object]:
    def checked(sid: str, message: Any) -> object:
        # The handshake, which was checked, has put the socket into the room of its page.
        if isinstance(message, dict) and message.get("client_id") in core.sio.rooms(sid):
            return handler(sid, message)
        _log.warning("a socket spoke for a page that is not its own")
        return None

    return checked


def _owns(sid: str, data: Any, environ: dict[str, Any] | None = None) -> bool:
    client = Client.instances.get(data.get("client_id", "")) if isinstance(data, dict) else None
    environ = environ or core.sio.get_environ(sid) or {}
    session = environ.get("asgi.scope", {}).get(SESSION)
    return client is not None and session is not None and client.storage.get(OWNER) == session.key
