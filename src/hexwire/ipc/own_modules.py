"""Module types that other packages add, through the entry-point group ``hexwire.modules``.

Owns finding them. The value of an entry point is an `IntEnum`, or a mapping from name to id. `hexwire.wire.modules`
keeps their names.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from enum import Enum
from functools import cache

from hexwire.errors import UsageError
from hexwire.wire.modules import register_module

__all__ = ["ENTRY_POINT_GROUP", "load_own_modules"]

ENTRY_POINT_GROUP = "hexwire.modules"


def load_own_modules() -> None:
    """Register the modules of all installed packages. It takes time only at the first call.

    Raises:
        UsageError: A package names something else, or an id or a name that another module has.
    """
    _load(tuple(sys.path))


@cache
def _load(path: tuple[str, ...]) -> None:
    # Imported late: it takes longer than everything else here.
    from importlib.metadata import entry_points

    for point in entry_points(group=ENTRY_POINT_GROUP):
        found = point.load()
        if isinstance(found, type) and issubclass(found, Enum):
            found = {name: member.value for name, member in found.__members__.items()}
        if not isinstance(found, Mapping):
            raise UsageError(
                f"entry point {point.value!r} of {ENTRY_POINT_GROUP} is neither an enumeration nor a mapping"
            )
        for name, number in found.items():
            register_module(str(name), number)
