"""Addresses of shared arms: ``zenoh:lab/arm1``, with options after a question mark.

Owns how an address, the environment and a file of this user together name an arm and its router. Must not know
Zenoh's session, nor arms.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import parse_qsl, urlencode

from hexwire.errors import LinkNotFoundError, UsageError
from hexwire.inputs import parse_toml, read_text

from .endpoints import endpoints_of, is_served, local_name, local_socket, local_sockets
from .names import SCHEME, ClientRole, check_name
from .network import Network
from .rights import Rights

__all__ = ["FLEET_VARIABLE", "Address", "address_text", "read_fleet_file", "rights_of", "router_network"]

FLEET_VARIABLE = "HEXWIRE_FLEET"
"""Environment variable with the path of a file that names router and certificates."""

_MOST_NAMES = 8
"""Most names of other arms listed in the error for an unknown one."""
_ROUTER_KEYS = ("router", "ca", "cert", "key")
_KEYS = (*_ROUTER_KEYS, "role", "take", "without-certificates")


@dataclass(frozen=True, slots=True)
class Address:
    """The address of a shared arm.

    Attributes:
        name: Its name.
        router: Endpoint of the router or server; empty for an arm of this machine.
        ca: Certificate of the lab's authority.
        cert: Own certificate.
        key: Its key.
        role: Role in which this program commands the arm; None for the highest that it has, see `role_by`.
        take: Pre-empt another holder of the lease.
        without_certificates: The router may be on another machine although it asks for no certificates.
    """

    name: str
    router: str = ""
    ca: str = ""
    cert: str = ""
    key: str = ""
    role: ClientRole | None = None
    take: bool = False
    without_certificates: bool = False

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
        plain = values.pop("without-certificates", "")
        for option, value in (("take", take), ("without-certificates", plain)):
            if value not in ("", "0", "1"):
                raise UsageError(f"{text!r}: {option} is 0 or 1")
        return cls(
            check_name(name.removeprefix("//")),
            role=_role(role) if role else None,
            take=take == "1",
            without_certificates=plain == "1",
            **values,
        )

    @property
    def text(self) -> str:
        """The address, without certificates."""
        return f"{SCHEME}:{self.name}"

    def role_by(self, cert: str) -> ClientRole:
        """Role in which a program commands the arm.

        Args:
            cert: The certificate by which the other side knows it; empty for none, which is for every role.
        """
        return role_of(cert) if self.role is None else self.role

    def network(self) -> Network:
        """The network with the arm: the socket of a server of this user, otherwise the router.

        Raises:
            LinkNotFoundError: No server of this user offers it, and no router is named.
        """
        try:
            path = local_socket(self.name)
        except UsageError:
            # A folder with too long a name matters only without a router.
            if not self.router:
                raise
        else:
            if is_served(path):
                return Network(connect=endpoints_of([path]))
        if not self.router:
            others = ", ".join([name for name in map(local_name, local_sockets()) if name][:_MOST_NAMES])
            raise LinkNotFoundError(
                f"no arm {self.name} is served on this machine by this user"
                f"{f', but {others}' if others else ''}: start 'hexwire serve --name "
                f"{self.name}', or name a router ({SCHEME}:{self.name}?router=tls/HOST:7447, or a file in "
                f"{FLEET_VARIABLE})",
                url=self.text,
            )
        return Network(
            connect=(self.router,),
            ca=self.ca,
            cert=self.cert,
            key=self.key,
            reachable_without_certificates=self.without_certificates,
        )


def role_of(cert: str) -> ClientRole:
    """Role that a certificate gives to a program; maintainer without a certificate.

    Raises:
        UsageError: It cannot be read.
    """
    rights = rights_of(cert) if cert else None
    if rights is not None and rights.role is not None:
        return rights.role
    return ClientRole.OPERATOR if cert else ClientRole.MAINTAINER


def rights_of(cert: str) -> Rights | None:
    """The rights in a certificate; None for one without a role.

    Raises:
        UsageError: It cannot be read.
    """
    # Here and below: loaded only where there are certificates.
    from hexwire.link.certs import read_certificate

    try:
        return Rights.from_uris(read_certificate(cert).uris)
    except UsageError as error:
        raise UsageError(f"{cert}: {error}" if cert not in str(error) else str(error)) from None


def router_network(
    router: str = "",
    *,
    ca: str = "",
    cert: str = "",
    key: str = "",
    without_certificates: bool = False,
    check: bool = True,
    environ: Mapping[str, str] | None = None,
) -> Network | None:
    """The network of a router; what is left out comes from the file in `FLEET_VARIABLE`.

    Args:
        router: Its endpoint.
        ca: Certificate of the lab's authority.
        cert: Own certificate.
        key: Its key.
        without_certificates: The router may be on another machine although it asks for no certificates.
        check: Read the certificates now, so that an error in them names their file.
        environ: The environment; that of this program if None.

    Returns:
        None if neither arguments nor file name anything.

    Raises:
        UsageError: The endpoint is wrong; certificates are missing or cannot be used; or no router is named.
        ConfigError: The file cannot be read or is wrong.
    """
    file = (os.environ if environ is None else environ).get(FLEET_VARIABLE)
    given = {name: value for name, value in zip(_ROUTER_KEYS, (router, ca, cert, key), strict=True) if value}
    values = {**(read_fleet_file(file) if file else {}), **given}
    endpoint, ca, cert, key = (values.get(name, "") for name in _ROUTER_KEYS)
    if not endpoint:
        if given or without_certificates:
            raise UsageError("these options need a router: name it, as in --router tls/HOST:7447")
        return None
    network = Network(
        connect=(endpoint,),
        ca=ca,
        cert=cert,
        key=key,
        reachable_without_certificates=without_certificates,
    )
    if check and network.files is not None:
        from hexwire.link.certs import check_usable

        check_usable(network.files)
    return network


def address_text(name: str, network: Network | None) -> str:
    """The address of an arm.

    Args:
        name: Its name.
        network: As from `router_network`; None for an arm of this machine.
    """
    if network is None:
        return f"{SCHEME}:{name}"
    values = dict(zip(_ROUTER_KEYS, (network.connect[0], network.ca, network.cert, network.key), strict=True))
    given = {key: value for key, value in values.items() if value}
    if network.reachable_without_certificates:
        given["without-certificates"] = "1"
    return f"{SCHEME}:{name}?{urlencode(given, safe='/:[]')}"


def _role(word: str) -> ClientRole:
    try:
        return ClientRole[word.upper()]
    except KeyError:
        raise UsageError(f"{word!r} is not a role; choose {', '.join(role.word for role in ClientRole)}") from None


def read_fleet_file(path: str) -> dict[str, str]:
    """Read a file with router, certificates and role; paths in it are relative to it.

    Raises:
        ConfigError: The file cannot be read or is wrong.
    """
    values = {}
    folder = Path(path).resolve().parent
    for key, item in parse_toml(read_text(path), path).table((), (*_ROUTER_KEYS, "role")).items():
        value = item.text()
        values[key] = str(folder / value) if key in ("ca", "cert", "key") else value
    return values
