"""How a node of an arm reaches its router: as any node, but beyond this machine with certificates only.

Owns what these settings add to those of any node: the fleet's certificates, the check of endpoints, and the fleet's
words for what cannot be reached. Must not know nodes.
"""

from __future__ import annotations

import contextlib
import logging
from dataclasses import dataclass
from typing import Any

from hexwire.errors import UsageError
from hexwire.fleet.endpoints import check_endpoint
from hexwire.fleet.network import tls_settings, why_unreachable
from hexwire.link.certs import check_usable
from hexwire.link.tls import TlsFiles
from zenoh_ros2 import LISTEN, endpoints_in

from .wire import RouterSettings

__all__ = ["SecureSettings"]

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class SecureSettings(RouterSettings):
    """Settings of a session that moves an arm; with certificates, all passes through the router.

    Attributes:
        ca: Certificate of the lab's authority; empty for no certificates.
        cert: Own certificate.
        key: Its key.
        reachable_without_certificates: Allow endpoints beyond this machine without TLS.

    Raises:
        UsageError: An endpoint reaches beyond this machine without certificates, or a file of them is missing.
    """

    ca: str = ""
    cert: str = ""
    key: str = ""
    reachable_without_certificates: bool = False

    def __post_init__(self) -> None:
        given = [bool(self.ca), bool(self.cert), bool(self.key)]
        if any(given) and not all(given):
            raise UsageError("TLS needs all of ca, cert and key; 'hexwire cert' creates the files")
        for field in ("connect", "listen"):
            object.__setattr__(self, field, self._checked(getattr(self, field)))

    def _checked(self, endpoints: tuple[str, ...] | None) -> tuple[str, ...] | None:
        options = {"certificates": bool(self.ca), "anywhere": self.reachable_without_certificates}
        if endpoints is None:
            return None
        return tuple(each if each == LISTEN else check_endpoint(each, **options) for each in endpoints)

    @property
    def files(self) -> TlsFiles | None:
        """The certificates; None for none."""
        return TlsFiles(self.ca, self.cert, self.key) if self.ca else None

    @property
    def is_local(self) -> bool:
        """Whether it connects to routers of this machine only, without certificates."""
        if self.ca:
            return False
        try:
            for each in self.connect:
                check_endpoint(each, certificates=False, anywhere=False)
        except UsageError:
            return False
        return True

    def rows(self) -> dict[str, Any]:
        """Zenoh's settings: those of any node, and the certificates."""
        rows = RouterSettings.rows(self)
        return rows | (tls_settings(self.files) if self.files is not None else {})

    def check(self) -> None:
        """Check the certificates.

        Raises:
            UsageError: They cannot be used.
        """
        if self.files is not None:
            check_usable(self.files)

    def why_unreachable(self, endpoint: str) -> str:
        """Why the router at an endpoint cannot be reached, in one line."""
        return why_unreachable(endpoint, self.files)

    def check_replaced(self, config: Any) -> None:
        """Warn of endpoints where anybody may move the arm.

        Args:
            config: A ``zenoh.Config``.
        """
        for kind in ("listen", "connect"):
            for endpoint in endpoints_in(config, kind):
                if endpoint == LISTEN:
                    continue
                with contextlib.suppress(UsageError):
                    check_endpoint(endpoint, certificates=True, anywhere=False)
                    continue
                _log.warning("Zenoh's settings %s to %s, where anybody may move the arm", kind, endpoint[:200])
