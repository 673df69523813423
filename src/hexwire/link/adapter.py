"""The latency timer of a USB adapter: read, reported, and set if the system permits.

Owns the paths of the kernel's setting and the advice. Must not know the protocol on the line.

An FTDI chip delivers bytes when its buffer is full or its timer ends, 16 ms by default; every answer of a servo
waits for it, so at most 61 requests per second are possible. CH340, CP210x and CDC-ACM adapters have no such timer.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

__all__ = ["AdapterReport", "inspect_adapter", "set_latency"]

_SYSFS = Path("/sys/bus/usb-serial/devices")
_GOOD_MS = 2
_UDEV_RULE = 'ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"'


@dataclass(frozen=True, slots=True)
class AdapterReport:
    """The latency of an adapter.

    Attributes:
        device: Path of the port.
        driver: Kernel driver, such as ``ftdi_sio``; empty if unknown.
        latency_ms: Its latency timer; None if it has none.
        overhead: Measured seconds that an answer takes beyond the time on the line; NaN without a measurement.
        held_back: Whether the measured times indicate a latency timer, whatever the system reports.
        advice: What to do, one line; empty if nothing.
    """

    device: str
    driver: str
    latency_ms: int | None
    overhead: float
    held_back: bool
    advice: str


def _timer(device: str, sysfs: Path) -> Path:
    return sysfs / Path(device).resolve().name / "latency_timer"


def set_latency(device: str, *, sysfs: Path = _SYSFS) -> bool:
    """Set an adapter's latency timer to 1 ms; False if it has none or this user has no permission."""
    try:
        _timer(device, sysfs).write_text("1\n", encoding="ascii")
    except OSError:
        return False
    return True


def inspect_adapter(
    device: str, overhead: float = float("nan"), held_back: bool = False, *, sysfs: Path = _SYSFS
) -> AdapterReport:
    """Read an adapter's latency timer, set it low if permitted, and report what is left to do.

    Args:
        device: Path of the port.
        overhead: `LineTiming.overhead` of a bus on it.
        held_back: `LineTiming.holds_back` of that bus.
        sysfs: Folder of the kernel's setting.
    """
    latency = _read(device, sysfs)
    if latency is not None and latency > _GOOD_MS and set_latency(device, sysfs=sysfs):
        latency = _read(device, sysfs)
    try:
        driver = (sysfs / Path(device).resolve().name / "driver").resolve(strict=True).name
    except OSError:
        driver = ""
    advice = ""
    if latency is not None and latency > _GOOD_MS:
        timer = _timer(device, sysfs)
        advice = (
            f"the adapter delays every answer by up to {latency} ms: run 'echo 1 | sudo tee {timer}', and to make "
            f"it permanent add this line to /etc/udev/rules.d/99-servo-adapter.rules: {_UDEV_RULE}"
        )
    elif held_back:
        advice = (
            f"every answer takes {overhead * 1000:.0f} ms longer than the line needs: an adapter's latency timer, "
            "a hub, or a program in between; try another adapter or port"
        )
    return AdapterReport(device, driver, latency, overhead, held_back, advice)


def _read(device: str, sysfs: Path) -> int | None:
    try:
        return int(_timer(device, sysfs).read_text(encoding="ascii"))
    except (OSError, ValueError):
        return None
