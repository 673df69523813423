"""Addresses of shared arms: ``zenoh:lab/arm1``, with options after a question mark.

Owns how an address, the environment and a file of this user together name an arm and the way to it. Must not know
Zenoh's session, nor arms.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import parse_qsl

from hexwire.errors import LinkNotFoundError, UsageError
from hexwire.inputs import parse_toml, read_text

from .names import SCHEME, Role, check_name
from .network import Network, endpoints_of, is_served, local_socket

__all__ = ["FLEET_VARIABLE", "Address", "read_fleet_file"]

FLEET_VARIABLE = "HEXWIRE_FLEET"
"""Environment variable with the path of a file that names router and certificates."""

_KEYS = ("router", "ca", "cert", "key", "role", "take")


@dataclass(frozen=True, slots=True)
class Address:
    """The address of a shared arm.

    Attributes:
        name: Its name.
        router: Endpoint of the router or server; empty for an arm of this machine.
        ca: Certificate of the lab's authority.
        cert: Own certificate.
        key: Its key.
        role: Role in which this program commands the arm.
        take: Pre-empt another holder of the lease.
    """

    name: str
    router: str = ""
    ca: str = ""
    cert: str = ""
    key: str = ""
    role: Role = Role.MAINTAINER
    take: bool = False

    @classmethod
    def parse(cls, text: str, environ: Mapping[str, str] | None = None) -> Address:
        """Parse an address; what it leaves out comes from the file in `FLEET_VARIABLE`.

        Raises:
            UsageError: It is not such an address; or the file is wrong.
        """
        scheme, colon, rest = text.partition(":")
        if scheme != SCHEME or not colon:
            raise UsageError(f"{text!r} is not the address of a shared arm; write {SCHEME}:lab/arm1")
        name, _, query = rest.partition("?")
        given: dict[str, str] = {}
        for key, value in parse_qsl(query, keep_blank_values=True):
            if key not in _KEYS or key in given:
                raise UsageError(f"{text!r}: option {key!r} is unknown or doubled; known are {', '.join(_KEYS)}")
            given[key] = value
        file = (os.environ if environ is None else environ).get(FLEET_VARIABLE)
        values = {**(read_fleet_file(file) if file else {}), **given}
        role = values.pop("role", "")
        take = values.pop("take", "")
        if take not in ("", "0", "1"):
            raise UsageError(f"{text!r}: take is 0 or 1")
        return cls(
            check_name(name.removeprefix("//")),
            role=_role(role) if role else Role.OPERATOR if values.get("cert") else Role.MAINTAINER,
            take=take == "1",
            **values,
        )

    @property
    def text(self) -> str:
        """The address, without certificates."""
        return f"{SCHEME}:{self.name}"

    def network(self) -> Network:
        """The way to the arm: the socket of a server of this user, else the router.

        Raises:
            LinkNotFoundError: No server of this user offers it, and no router is named.
        """
        path = local_socket(self.name)
        if is_served(path):
            return Network(connect=endpoints_of([path]))
        if not self.router:
            raise LinkNotFoundError(
                f"no arm {self.name} is served on this machine by this user: start 'hexwire serve --name "
                f"{self.name}', or name a router ({SCHEME}:{self.name}?router=tls/HOST:7447, or a file in "
                f"{FLEET_VARIABLE})",
                url=self.text,
            )
        return Network(connect=(self.router,), ca=self.ca, cert=self.cert, key=self.key)


def _role(word: str) -> Role:
    try:
        return Role[word.upper()]
    except KeyError:
        raise UsageError(f"{word!r} is not a role; choose {', '.join(role.word for role in Role)}") from None


def read_fleet_file(path: str) -> dict[str, str]:
    """Read a file with router, certificates and role; paths in it are relative to it.

    Raises:
        ConfigError: The file cannot be read or is wrong.
    """
    values = {}
    folder = Path(path).resolve().parent
    for key, item in parse_toml(read_text(path), path).table(("router", "ca", "cert", "key", "role")).items():
        value = item.text()
        values[key] = str(folder / value) if key in ("ca", "cert", "key") else value
    return values
