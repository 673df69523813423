"""Finds the program that has a port or queue open, for error texts.

Owns the reading of ``/proc``. Everything here is a best guess: without permission the result is an empty text.
"""

from __future__ import annotations

import os
from pathlib import Path

from hexwire.system import device_number, device_parts

from .port_identity import same_device

__all__ = ["device_owner", "lock_owner"]


def lock_owner(status: os.stat_result) -> str:
    """Name of the program that holds the lock on a file: ``hexwire (pid 4711)``; empty if unknown."""
    try:
        locks = Path("/proc/locks").read_text(encoding="ascii", errors="replace")
    except OSError:
        return ""
    major, minor = device_parts(status.st_dev)
    wanted = f"{major:02x}:{minor:02x}:{status.st_ino}"
    for line in locks.splitlines():
        fields = line.split()
        if "FLOCK" in fields and wanted in fields:
            return _program(fields[fields.index(wanted) - 1])
    return ""


def device_owner(device: str) -> str:
    """Name of the program that has a device open; empty if unknown.

    The file lock is checked first, since the program that serves a pseudo-terminal also holds it open.
    """
    try:
        status = Path(device).stat()
    except OSError:
        return ""
    owner = lock_owner(status)
    if owner or not device_number(status):
        return owner
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if any(same_device(fd.stat(), status) for fd in (process / "fd").iterdir()):
                return _program(process.name)
        except OSError:
            continue  # it has ended, or belongs to another user
    return ""


def _program(pid: str) -> str:
    if pid == str(os.getpid()):
        return "this program"
    try:
        name = Path(f"/proc/{pid}/comm").read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return ""
    return f"{name} (pid {pid})"
