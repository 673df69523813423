"""The server of a studio: its pages, the live socket, and STOP by HTTP, behind the gate.

Owns what is served where, and the start and end of the server. The only module that imports the web server: it is
imported late.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket as sockets
import ssl
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp
from starlette.websockets import WebSocket

from hexwire.errors import LinkBusyError

from .access import Access, Right
from .app import Studio
from .camera_views import CameraViews
from .connections import make_protocol
from .files import make_routes
from .fleet_api import fleet_routes
from .foxglove import Foxglove
from .guard import SESSION, Guard
from .packed import Packed
from .servos_api import servos_routes
from .wire_api import wire_routes

__all__ = ["FOXGLOVE", "PAGES", "STATIC", "Server", "make_app", "make_viewers_app", "socket_of", "url_of"]

STATIC = Path(__file__).parent / "static"
"""Folder of the files that pages load."""
FOXGLOVE = "/foxglove"
"""Address of the socket of programs that speak Foxglove's protocol."""
PAGES = ("/move", "/servos", "/signals", "/wire", "/recordings", "/")
"""Addresses of the pages in the header. All are one file; its `studio.js` has their titles and modules."""
FIRST_RUN = "/first"
"""Address of the page of the first run, to which the page Arms leads."""


@dataclass(slots=True)
class Server:
    """Serves an application behind its gate until it is told to end.

    Args:
        make: Makes the application; its argument is to be called when the server has started.
        access: The rules of access.
        host: Address to listen at.
        port: Its port; 0 for a free one.
        certificate: Files of a certificate and its key; none without TLS.
        ca: File of the authority whose client certificates are required; none for no such requirement.
        right_of: As in `make_protocol`.
    """

    make: Callable[[Callable[[], object]], ASGIApp]
    access: Access
    host: str = "127.0.0.1"
    port: int = 0
    certificate: tuple[str, str] | None = None
    ca: str | None = None
    right_of: Callable[[Mapping[str, Any]], Right | None] = lambda peer: None
    _server: Any = None
    _socket: Any = None

    def bind(self) -> int:
        """Take the port, so that its number is known; returns it.

        Raises:
            LinkBusyError: It is in use.
        """
        family = sockets.AF_INET6 if ":" in self.host else sockets.AF_INET
        made = sockets.socket(family, sockets.SOCK_STREAM)
        made.setsockopt(sockets.SOL_SOCKET, sockets.SO_REUSEADDR, 1)
        try:
            made.bind((self.host, self.port))
            # From here on whoever has the address waits for the start, and is not refused.
            made.listen(128)
        except OSError as error:
            made.close()
            raise LinkBusyError(f"{self.host}:{self.port} cannot be used: {error.strerror}") from None
        self._socket, self.port = made, made.getsockname()[1]
        return self.port

    def run(self, on_started: Callable[[], object] = lambda: None) -> None:
        """Serve until `end`, in this thread."""
        app = self.make(on_started)
        config = uvicorn.Config(
            app,
            log_level="warning",
            access_log=False,
            loop="asyncio",
            http=make_protocol(self.access.limits, self.right_of),
            # The parser bounds the heads of requests, and whoever sends one may have no session.
            h11_max_incomplete_event_size=self.access.limits.head,
            ws="websockets-sansio",
            # Compressing frames would take more of the processor than all else that is done for a page.
            ws_per_message_deflate=False,
            ws_max_size=1 << 20,
            ws_ping_interval=5.0,
            ws_ping_timeout=5.0,
            timeout_graceful_shutdown=1,
            server_header=False,
            date_header=False,
            proxy_headers=False,
            ssl_certfile=self.certificate[0] if self.certificate else None,
            ssl_keyfile=self.certificate[1] if self.certificate else None,
            ssl_ca_certs=self.ca,
            ssl_cert_reqs=ssl.CERT_REQUIRED if self.ca else ssl.CERT_NONE,
        )
        self._server = server = uvicorn.Server(config)
        # The command owns the signals.
        server.capture_signals = contextlib.nullcontext  # type: ignore[method-assign,assignment]
        server.run(sockets=[self._socket])

    def end(self) -> None:
        """End `run`, from any thread or signal handler."""
        if self._server is not None:
            self._server.should_exit = True


def make_viewers_app(foxglove: Foxglove, access: Access, on_started: Callable[[], object] = lambda: None) -> Guard:
    """Build what `hexwire serve` serves to viewers, behind the gate: no pages.

    Args:
        foxglove: The arms to watch.
        access: The rules of access.
        on_started: Called when the server has started.
    """

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        with foxglove.running():
            on_started()
            yield

    return Guard(Starlette(routes=[WebSocketRoute(FOXGLOVE, foxglove.serve)], lifespan=lifespan), access)


def make_app(studio: Studio, on_started: Callable[[], object] = lambda: None) -> Guard:
    """Build what is served, behind the gate.

    Args:
        studio: The studio.
        on_started: Called when the server has started.
    """
    foxglove = studio.foxglove
    cameras = CameraViews(studio.cameras, studio.tabs, studio.access.limits.patience)
    static = Packed(STATIC)

    @asynccontextmanager
    async def lifespan(app: Starlette) -> AsyncIterator[None]:
        studio.begin(asyncio.get_running_loop())
        pump = asyncio.create_task(studio.live.pump())
        with contextlib.nullcontext() if foxglove is None else foxglove.running():
            on_started()
            try:
                yield
            finally:
                pump.cancel()

    async def live(websocket: WebSocket) -> None:
        await studio.live.serve(websocket)

    async def stop(request: Request) -> Response:
        if not _is_heard(studio, request):
            studio.stop("a page")
        return JSONResponse({"stopping": True})

    async def page(request: Request) -> Response:
        session = request.scope[SESSION]
        tab = studio.tabs.open(session.key, session.right)
        return static.page(request, "studio.html", {"tab": tab.key, "right": str(int(tab.right))})

    async def mesh(request: Request) -> Response:
        meshes, number = [] if studio.urdf is None else studio.urdf.meshes, request.path_params["number"]
        if number >= len(meshes):
            return Response("There is no such mesh.", 404)
        headers = {"cache-control": "no-store"}
        return Response(meshes[number].body, 200, headers, "application/octet-stream")

    found = lambda: studio  # noqa: E731
    routes = [
        WebSocketRoute("/live", live),
        WebSocketRoute("/camera/{name}", cameras.serve),
        WebSocketRoute("/camera", cameras.take),
        *([] if foxglove is None else [WebSocketRoute(FOXGLOVE, foxglove.serve)]),
        Route("/stop", stop, methods=["POST"]),
        Route("/static/{name:path}", static.answer),
        Route("/meshes/{number:int}", mesh),
        *(Route(path, page) for path in (*PAGES, FIRST_RUN)),
        *make_routes(found),
        *wire_routes(found),
        *fleet_routes(found),
        *servos_routes(found),
    ]
    return Guard(Starlette(routes=routes, lifespan=lifespan), studio.access)


def _is_heard(studio: Studio, request: Request) -> bool:
    """A stop has come over the socket of its page already, which only did not learn of it in time."""
    session, number = request.scope.get(SESSION), request.query_params.get("id", "")
    tab = studio.tabs.find(request.query_params.get("tab", ""), session.key) if session is not None else None
    return tab is not None and 0 < len(number) < 10 and number.isdecimal() and int(number) in tab.stops


def url_of(server: Server, token: str, path: str = "/") -> str:
    """The address to open.

    Args:
        server: The server.
        token: Of an operator or a watcher.
        path: The page to begin with.
    """
    host = f"[{server.host}]" if ":" in server.host else server.host
    return f"{server.access.scheme}://{host}:{server.port}{path}?token={token}"


def socket_of(server: Server) -> str:
    """The address for programs that speak Foxglove's protocol; whoever knows it may watch."""
    return "ws" + url_of(server, server.access.watch_token, FOXGLOVE).removeprefix("http")
