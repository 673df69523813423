"""The serial ports of this machine, as a test needs them."""

from __future__ import annotations

import pytest

from hexwire.drivers import registry
from hexwire.link import ports


def likely_boards(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Addresses of the likely boards of this machine, for a test to add to; none at first."""
    found: list[str] = []
    monkeypatch.delenv(registry.PORT_VARIABLE, raising=False)
    monkeypatch.setattr(
        ports, "list_ports", lambda: [ports.PortInfo(name, likely_board=True, guess="a board") for name in found]
    )
    return found
