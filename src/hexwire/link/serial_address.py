"""Makes the link of a ``serial:`` address.

Owns which of two links it is: on Linux `SerialLink` (termios), elsewhere `PySerialLink`. Windows has no termios,
and that of macOS cannot set 1,000,000 baud, the usual rate of bus servos.
"""

from __future__ import annotations

import importlib.util
import sys
from typing import TYPE_CHECKING

from hexwire.errors import UsageError

from .serial_port import BAUD_HIGH, BAUD_LOW, DEFAULT_BAUD

if TYPE_CHECKING:
    from .base import Link
    from .url import LinkUrl

__all__ = ["make_serial_link"]

_BACKENDS = ("termios", "pyserial")


def make_serial_link(url: LinkUrl) -> Link:
    """Make a link from ``serial:///dev/ttyUSB0?baud=115200&raise=500000&low_latency=1&reset=0&backend=pyserial``.

    On Windows the path is ``/COM3``. All options but the path may be omitted.

    Raises:
        UsageError: The address is wrong, or this system cannot open a port in that way.
    """
    url.check_keys(("backend", "baud", "low_latency", "raise", "reset"))
    if url.netloc:
        raise UsageError(
            f"{url.text}: a serial address has three slashes, as in serial:///dev/ttyUSB0 "
            f"({url.netloc!r} is in the place of a host)"
        )
    if not url.path.strip("/"):
        raise UsageError(f"{url.text}: the device is missing, as in serial:///dev/ttyUSB0")
    baud = url.integer("baud", DEFAULT_BAUD, BAUD_LOW, BAUD_HIGH)
    raise_to = url.integer("raise", 0, BAUD_LOW, BAUD_HIGH)
    low_latency, reset = url.yes_no("low_latency", True), url.yes_no("reset", False)
    has_termios = sys.platform == "linux" and importlib.util.find_spec("termios") is not None
    backend = url.query.get("backend", _BACKENDS[0] if has_termios else _BACKENDS[1])
    if backend not in _BACKENDS:
        raise UsageError(f"{url.text}: backend must be {' or '.join(_BACKENDS)}, not {backend!r}")
    if backend == "pyserial":
        from .pyserial_link import PySerialLink

        return PySerialLink(_device(url.path), baud, low_latency=low_latency, reset_board=reset, raise_to=raise_to)
    if sys.platform == "linux" and has_termios:
        from .serial import SerialLink

        return SerialLink(url.path, baud, low_latency=low_latency, reset_board=reset, raise_to=raise_to)
    raise UsageError(f"{url.text}: backend=termios is for Linux; omit it")


def _device(path: str) -> str:
    """Name of a port: on Windows a plain one, such as ``COM3``."""
    return path if path.startswith("/dev/") or path.count("/") > 1 else path.lstrip("/")
