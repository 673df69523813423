"""What other packages bring: the entry points of those that are installed, and the extra of one that is not.

Owns the table of extras and the look-up. A module of its own, since all rooms use it, and `errors.py` has
exceptions only. Must not know what a package is used for: who can say that better catches the error first.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING

from hexwire.errors import UsageError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint, EntryPoints, SelectableGroups

__all__ = ["EXTRAS", "extras_named", "installed"]

EXTRAS = {
    "cryptography": "tls",
    "evdev": "joystick",
    "glfw": "sim",
    "linuxpy": "camera",
    "matplotlib": "plots",
    "msgspec": "fleet",
    "mujoco": "sim",
    "numpy": "numpy",
    "posix_ipc": "mq",
    "pytest": "testing",
    "starlette": "studio",
    "uvicorn": "studio",
    "yaml": "ros2",
    "zenoh": "fleet",
    "zenoh_ros2": "ros2",
}
"""Package as it is imported -> the extra that installs it."""


@contextmanager
def extras_named() -> Iterator[None]:
    """Turn the failed import of a package into an error that names its extra.

    Raises:
        UsageError: The package is of an extra.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package not in EXTRAS:
            raise
        extra = EXTRAS[package]
        raise UsageError(f"this needs {package}, which is not installed: pip install 'hexwire[{extra}]'") from None


def installed(group: str) -> tuple[EntryPoint, ...]:
    """The entry points of a group in all installed packages, in the order in which Python finds these."""
    return tuple(_installed(tuple(sys.path)).select(group=group))


@cache
def _installed(path: tuple[str, ...]) -> EntryPoints | SelectableGroups:
    # Imported late, and read once: reading the metadata of all packages takes longer than what is done with it.
    from importlib.metadata import entry_points

    return entry_points()
