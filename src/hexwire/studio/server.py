"""The server of a studio: its pages, the live socket, and STOP by HTTP, behind the gate.

Owns what is served where, and the start and end of the server. The only module that imports the web server and all
of NiceGUI at once, which takes a second: it is imported late. Must not know what a page shows.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket as sockets
import ssl
import tempfile
from collections.abc import AsyncIterator, Callable, Mapping
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# Nothing of the folder in which the program runs is read or written.
os.environ.setdefault("NICEGUI_STORAGE_PATH", str(Path(tempfile.gettempdir()) / f"hexwire-none-{os.getpid()}"))

import uvicorn
from fastapi import FastAPI
from nicegui import app as nicegui_app
from nicegui import ui
from nicegui.elements.scene import scene as _scene  # noqa: F401  # puts three.js where `static/arm3d.js` finds it
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Mount, Route, WebSocketRoute
from starlette.staticfiles import StaticFiles
from starlette.websockets import WebSocket

from hexwire.errors import LinkBusyError

from .access import Right
from .app import Studio
from .connections import make_protocol
from .files import make_routes
from .fleet_api import fleet_routes
from .guard import SESSION, Guard
from .layout import build_page
from .page_sockets import guard_page_sockets
from .recordings_api import recordings_routes
from .wire_api import wire_routes

__all__ = ["KEPT", "STATIC", "Server", "make_app", "url_of"]

STATIC = Path(__file__).parent / "static"
"""Folder of the files that pages load."""
KEPT = 60.0
"""Seconds for which a page without its socket is kept. A browser that returns later loads it anew, and what was
typed into it is lost. A computer that sleeps for a moment, or a change of the network, takes part of a minute."""
_BUILT = 20.0
"""Seconds in which a page must be built."""


@dataclass(slots=True)
class Server:
    """Serves the pages of a studio until it is told to end. One at a time in a program, as NiceGUI has one app.

    Args:
        studio: The studio.
        host: Address to listen at.
        port: Its port; 0 for a free one.
        certificate: Files of a certificate and its key; none without TLS.
        ca: File of the authority whose client certificates are required; none for no such requirement.
        right_of: As in `make_protocol`.
    """

    studio: Studio
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
        app = make_app(self.studio, on_started)
        config = uvicorn.Config(
            app,
            log_level="warning",
            access_log=False,
            http=make_protocol(self.studio.access.limits, self.right_of),
            ws="websockets-sansio",
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


_app: Any = None
_studio: Studio | None = None


def make_app(studio: Studio, on_started: Callable[[], object] = lambda: None) -> Guard:
    """Build what is served, behind the gate.

    NiceGUI has one app in a program: a second studio in one program takes the place of the first.
    """
    global _app, _studio
    _studio = studio
    if _app is None:
        _app = _make_pages()
    _app.state.on_started = on_started
    return Guard(_app, studio.access)


def _present() -> Studio:
    assert _studio is not None
    return _studio


def _is_heard(request: Request) -> bool:
    """A stop has come over the socket of its page already, which only did not learn of it in time."""
    session, number = request.scope.get(SESSION), request.query_params.get("id", "")
    tab = _present().tabs.find(request.query_params.get("tab", ""), session.key) if session is not None else None
    return tab is not None and 0 < len(number) < 10 and number.isdecimal() and int(number) in tab.stops


def _make_pages() -> Any:
    @asynccontextmanager
    async def lifespan(app: Any) -> AsyncIterator[None]:
        studio = _present()
        studio.begin(asyncio.get_running_loop())
        pump = asyncio.create_task(studio.live.pump())
        app.state.on_started()
        try:
            yield
        finally:
            pump.cancel()

    async def live(websocket: WebSocket) -> None:
        await _present().live.serve(websocket)

    async def stop(request: Request) -> Response:
        if not _is_heard(request):
            _present().stop("a page")
        return JSONResponse({"stopping": True})

    async def icon(request: Request) -> Response:
        return FileResponse(STATIC / "icon.svg", media_type="image/svg+xml")

    app = FastAPI(lifespan=lifespan, openapi_url=None, docs_url=None, redoc_url=None)
    app.router.routes += [
        WebSocketRoute("/live", live),
        Route("/stop", stop, methods=["POST"]),
        Route("/favicon.ico", icon),
        *make_routes(_present),
        *recordings_routes(_present),
        Mount("/static", StaticFiles(directory=STATIC)),
        *wire_routes(_present),
        *fleet_routes(_present),
    ]

    async def page(request: Request) -> None:
        session = request.scope[SESSION]
        await build_page(_present(), session)

    guard_page_sockets()
    for path in ("/", "/{_:path}"):
        ui.page(path, reconnect_timeout=KEPT, response_timeout=_BUILT)(page)
    # Its bar runs at every request of a page, says nothing, and has no name for a screen reader.
    nicegui_app.config.quasar_config["loadingBar"]["skipHijack"] = True
    ui.run_with(
        app,
        title="hexwire studio",
        tailwind=False,
        show_welcome_message=False,
        language="en-US",
        dark=None,
        # How often a browser must answer follows from it; how long a page is kept does not, see above.
        reconnect_timeout=5.0,
        gzip_middleware_factory=None,
    )
    return app


def url_of(server: Server, token: str, path: str = "/") -> str:
    """The address to open.

    Args:
        server: The server.
        token: Of an operator or a watcher.
        path: The page to begin with.
    """
    host = f"[{server.host}]" if ":" in server.host else server.host
    return f"{server.studio.access.scheme}://{host}:{server.port}{path}?token={token}"
