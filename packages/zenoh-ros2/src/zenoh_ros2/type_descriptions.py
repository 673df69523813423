"""The service ``~/get_type_description``: what the messages of this node consist of.

Owns which types are told, and `rcl`'s words. Must not know how types are described.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any, Protocol

__all__ = ["NAME", "PARAMETER", "TYPE", "Described", "make_answer"]

NAME, TYPE = "~/get_type_description", "type_description_interfaces/srv/GetTypeDescription"
PARAMETER = "start_type_description_service"
"""The parameter of a node that says whether it offers the service."""
_HASH = re.compile(r"RIHS01_[0-9a-fA-F]{64}", re.ASCII)


class Described(Protocol):
    """A type that can tell what it consists of."""

    @property
    def description(self) -> Any:
        """A ``type_description_interfaces/msg/TypeDescription``."""

    @property
    def sources(self) -> list[Any]:
        """``type_description_interfaces/msg/TypeSource`` of it and of those in it."""


def make_answer(
    response: Callable[..., Any], in_use: Callable[[], Mapping[str, Described]]
) -> Callable[[Any], Any]:
    """The callback of the service.

    Args:
        response: Makes a response.
        in_use: The types of this node by their hashes.
    """

    def answer(request: Any) -> Any:
        if not _HASH.fullmatch(request.type_hash):
            return response(successful=False, failure_reason="Failed to parse type hash")
        found = in_use().get(request.type_hash)
        if found is None:
            return response(successful=False, failure_reason="Type not currently in use by this node")
        sources = found.sources if request.include_type_sources else []
        return response(successful=True, type_description=found.description, type_sources=sources)

    return answer
