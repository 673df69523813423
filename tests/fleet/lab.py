"""A lab of certificates, and sessions with them, for the tests."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from tests.link.far_ends import free_port

from hexwire.fleet.network import Network
from hexwire.fleet.node import Node
from hexwire.fleet.rights import Kind, Rights, access_control
from hexwire.link.certs import issue_certificate, make_authority, read_certificate

LONG_AGO = datetime(2020, 1, 1, tzinfo=UTC)


class Lab:
    """An authority with certificates in a folder, and a router that knows them.

    Args:
        folder: The folder.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.port = free_port()
        self.endpoint = f"tls/localhost:{self.port}"
        self._known: list[tuple[str, Rights]] = []
        make_authority(folder)
        self.issue("router", Kind.ROUTER)

    def issue(
        self, name: str, kind: Kind, *arms: str, known: bool = True, subject: str = "", **options: Any
    ) -> None:
        """Issue a certificate, which the next router knows by its subject."""
        rights = Rights(kind, arms)
        purpose = "both" if rights.role is None else "client"
        subject = subject or f"{name} 1"
        files = issue_certificate(self.folder, name, purpose, uris=rights.uris(), subject=subject, **options)
        if known:
            self._known.append((read_certificate(files.cert).common_name, rights))

    def files(self, name: str, ca: Path | None = None) -> dict[str, str]:
        """The arguments of a `Network` for a certificate."""
        return {
            "ca": str((ca or self.folder) / "ca.pem"),
            "cert": str(self.folder / f"{name}.pem"),
            "key": str(self.folder / f"{name}.key"),
        }

    def url(self, arm: str, name: str, more: str = "") -> str:
        """The address of an arm behind the router, with a certificate."""
        options = "&".join(f"{key}={value}" for key, value in self.files(name).items())
        return f"zenoh:{arm}?router={self.endpoint}&{options}{more}"

    def network(self, name: str, **options: Any) -> Network:
        """The way to the router with a certificate."""
        return Network(connect=(self.endpoint,), **self.files(name), **options)

    def access(self) -> dict[str, Any]:
        """The rights of the certificates so far."""
        rows: dict[str, Any] = json.loads(json.dumps(access_control(self._known)))
        return rows

    @contextlib.contextmanager
    def routing(self) -> Iterator[Node]:
        """A router that knows the certificates so far."""
        network = Network(listen=(self.endpoint,), **self.files("router"), router=True, access=self.access())
        node = network.open()
        try:
            yield node
        finally:
            node.close()

    @contextlib.contextmanager
    def session(self, name: str, *, wait: bool = True) -> Iterator[Node]:
        """A session with the router."""
        node = self.network(name).open(wait=wait)
        try:
            yield node
        finally:
            node.close()
