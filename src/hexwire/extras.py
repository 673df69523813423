"""Which extra of hexwire installs a package that is not there.

Owns the table. A module of its own, since drivers and fronts use it, and `errors.py` has exceptions only. Must not
know what a package is used for: who can say that better catches the error first.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from hexwire.errors import UsageError

__all__ = ["EXTRAS", "extras_named"]

EXTRAS = {
    "cryptography": "tls",
    "evdev": "joystick",
    "fastapi": "studio",
    "glfw": "sim",
    "matplotlib": "plots",
    "msgspec": "fleet",
    "mujoco": "sim",
    "nicegui": "studio",
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
