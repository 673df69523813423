"""The options that name a router and certificates, shared by several commands.

Owns their names and help. Must not know what they are used for.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import click

from hexwire.errors import UsageError

__all__ = ["certificate_options", "router_options"]

_F = TypeVar("_F", bound=Callable[..., Any])


def certificate_options(owner: str) -> Callable[[_F], _F]:
    """``--ca``, ``--cert``, ``--key`` and ``--reachable-without-certificates``, under these names.

    Args:
        owner: Owner of the certificate, for the help.
    """
    files = (
        ("--ca", "Certificate of the lab's authority, for tls endpoints."),
        ("--cert", f"Certificate of {owner}."),
        ("--key", "Its key."),
    )

    def add(command: _F) -> _F:
        command = click.option(
            "--reachable-without-certificates",
            is_flag=True,
            help="Allow tcp endpoints beyond this machine: anybody there can then move the arms.",
        )(command)
        for name, words in reversed(files):
            command = click.option(name, default="", metavar="FILE", help=words)(command)
        return command

    return add


def router_options(command: Callable[..., Any], *, stops: bool = False) -> Callable[..., Any]:
    """``--router`` and `certificate_options`; the command gets ``router``, a Network or None.

    What is not typed comes from the file in HEXWIRE_FLEET.

    Args:
        command: The command.
        stops: It stops arms: certificates that cannot be used keep no stop from the arms of this machine.
    """

    @functools.wraps(command)
    def packed(
        *args: Any, router: str, ca: str, cert: str, key: str, reachable_without_certificates: bool, **rest: Any
    ) -> Any:
        from hexwire.fleet.address import router_network

        plain = reachable_without_certificates
        try:
            network = router_network(router, ca=ca, cert=cert, key=key, without_certificates=plain, check=not stops)
        except UsageError as error:
            raise UsageError(f"nothing was stopped: {error}") if stops else error from None
        return command(*args, router=network, **rest)

    with_certificates = certificate_options("this program")(packed)
    return click.option(
        "--router",
        default="",
        metavar="ENDPOINT",
        help="Router of the fleet, as in tls/lab-pc:7447.  [env var: HEXWIRE_FLEET]",
    )(with_certificates)
