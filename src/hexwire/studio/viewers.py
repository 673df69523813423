"""A server for viewers of shared arms, in a thread of its own: `hexwire serve --foxglove`.

Owns its start and end. Only this machine can reach it: elsewhere a studio shows a shared arm, with TLS.
"""

from __future__ import annotations

import threading
from functools import partial
from typing import TYPE_CHECKING

from hexwire.errors import UsageError

from .access import Access
from .foxglove import Foxglove
from .listening import host_names, is_local, parse_listen
from .server import Server, make_viewers_app, socket_of

if TYPE_CHECKING:
    from hexwire.control.requests.settings import Settings

    from .cameras import Cameras
    from .foxglove import OnState

__all__ = ["Viewers"]

_PATIENCE = 5.0
"""Seconds for the server to end."""


class Viewers:
    """Shows arms to whoever watches. Call `watch` for each arm, then `start`, finally `end`.

    Args:
        listen: Where, as for `hexwire studio --listen`.
        origins: Of web pages that may connect.
        cameras: Cameras of this computer that are shown, too; none if None.

    Raises:
        UsageError: Other machines could reach it, or `listen` is no address.
    """

    def __init__(self, listen: str, origins: frozenset[str], cameras: Cameras | None = None) -> None:
        host, port = parse_listen(listen)
        if not is_local(host):
            raise UsageError(
                f"--foxglove {listen}: other machines can reach {host}; show the arm there by "
                "'hexwire studio --foxglove --port zenoh:NAME', which has TLS and a password"
            )
        access = Access(frozenset(), origins=origins)
        self._cameras = cameras
        self._foxglove = Foxglove("hexwire serve", cameras=cameras)
        self._server = Server(partial(make_viewers_app, self._foxglove, access), access, host, port)
        self._thread = threading.Thread(target=self._server.run, name="viewers", daemon=True)

    def watch(self, name: str, settings: Settings) -> OnState:
        """What is to be called with the states of an arm; its topics and frames begin with its name."""
        return self._foxglove.show(f"{name}/", settings.model, settings.links)

    def start(self) -> str:
        """Begin to serve; returns the address, which whoever watches must know.

        Raises:
            LinkBusyError: The port is in use.
        """
        server = self._server
        server.access.hosts = host_names(server.host, server.bind(), "", secure=False)
        self._thread.start()
        return socket_of(server)

    def end(self) -> None:
        """End."""
        self._server.end()
        self._thread.join(_PATIENCE)
        if self._cameras is not None:
            self._cameras.close()
