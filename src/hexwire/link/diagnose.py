"""Checks of a serial port without opening it: chip, permissions, udev rules, competing programs, rate.

Owns the checks and the advice, each finding with a remedy. Only reads the system; `write_udev_rule` is the only
function that writes, and only on request. Must not know frames or servos.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from hexwire.errors import LinkPermissionError, UsageError
from hexwire.folders import make_folder
from hexwire.new_file import OutputFile
from hexwire.system import group_name, user_id, user_name

from .adapter import inspect_adapter
from .ports import PortInfo

__all__ = [
    "RULE_PATH",
    "Finding",
    "Level",
    "avr_baud_error",
    "diagnose_baud",
    "diagnose_port",
    "diagnose_system",
    "udev_rule",
    "write_udev_rule",
]

RULE_PATH = Path("etc/udev/rules.d/70-hexwire.rules")
"""Path of the rule, relative to the root folder."""

_RULE_FOLDERS = ("etc/udev/rules.d", "run/udev/rules.d", "usr/lib/udev/rules.d", "lib/udev/rules.d")
_CH340 = "1a86:7523"
_AVR_CLOCK = 16_000_000
_GOOD_BAUD_ERROR = 0.015
"""Recommended limit for 8N1 with U2X (ATmega2560 datasheet); the receiver tolerates up to 3.9 %."""


class Level(Enum):
    """Severity of a finding."""

    OK = "ok"
    HINT = "hint"
    BAD = "bad"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of one check.

    Attributes:
        level: Severity.
        about: What was checked.
        text: What was found.
        advice: What to do; empty if nothing.
        port: The port concerned, if several were checked.
    """

    level: Level
    about: str
    text: str
    advice: str = ""
    port: str = ""


def udev_rule(usb_ids: Iterable[str]) -> str:
    """Text of a udev rule that gives access to these devices only to users who may use serial ports.

    Args:
        usb_ids: Such as ``1a86:7523``.
    """
    lines = [
        "# Servo boards and adapters: group dialout and local users may use them, and ModemManager ignores them.",
    ]
    for usb_id in sorted(set(usb_ids)):
        vid, pid = usb_id.split(":")
        lines.append(
            f'SUBSYSTEM=="tty", ATTRS{{idVendor}}=="{vid}", ATTRS{{idProduct}}=="{pid}", MODE="0660", '
            f'GROUP="dialout", TAG+="uaccess", ENV{{ID_MM_DEVICE_IGNORE}}="1"'
        )
    return "\n".join(lines) + "\n"


def write_udev_rule(usb_ids: Iterable[str], root: Path = Path("/")) -> Path:
    """Write the rule.

    Raises:
        LinkPermissionError: This user has no permission.
    """
    path = root / RULE_PATH
    try:
        make_folder(path.parent)
        with OutputFile(path, force=True, mode=0o644) as out:
            out.file.write(udev_rule(usb_ids).encode())
    except (OSError, UsageError) as error:
        raise LinkPermissionError(f"{path} cannot be written ({error}); run it with sudo") from error
    return path


def diagnose_port(port: PortInfo, root: Path = Path("/")) -> list[Finding]:
    """Check one port: its chip, permissions, udev rules and latency timer."""
    findings = [Finding(Level.OK, port.device, port.guess + (f", USB {port.usb_id}" if port.usb_id else ""))]
    findings.append(_permission(port.device))
    if port.usb_id:
        ruled = _mentioned_in_rules(port.usb_id, root)
        if ruled:
            findings.append(Finding(Level.OK, port.device, f"udev rule in {ruled}"))
        else:
            advice = "hexwire doctor --fix writes one; then unplug the device and plug it in"
            findings.append(Finding(Level.HINT, port.device, f"no udev rule for USB {port.usb_id}", advice))
    report = inspect_adapter(port.device) if root == Path("/") else None
    if report is not None and report.latency_ms is not None:
        level = Level.BAD if report.advice else Level.OK
        findings.append(Finding(level, port.device, f"latency timer {report.latency_ms} ms", report.advice))
    return findings


def diagnose_system(ports: Iterable[PortInfo], root: Path = Path("/")) -> list[Finding]:
    """Check for programs that are known to open serial ports of others."""
    findings = []
    ids = {port.usb_id for port in ports if port.usb_id}
    if ids and "ModemManager" in _running(root):
        ignored = all(_mentioned_in_rules(usb_id, root, also="ID_MM_DEVICE_IGNORE") for usb_id in ids)
        if ignored:
            findings.append(Finding(Level.OK, "ModemManager", "runs, but ignores these ports"))
        else:
            advice = "hexwire doctor --fix writes a rule against it, or: sudo systemctl disable ModemManager"
            findings.append(Finding(Level.BAD, "ModemManager", "runs, and talks to every new serial port", advice))
    if _CH340 in ids:
        rule = _mentioned_in_rules(_CH340, root, named="brltty")
        if rule or "brltty" in _running(root):
            advice = "sudo apt-get remove brltty, or mask its rule for 1a86:7523"
            findings.append(Finding(Level.BAD, "brltty", "mistakes CH340 ports for a braille display", advice))
    return findings


def avr_baud_error(baud: int) -> float:
    """Rate error of the UART of an AVR at 16 MHz (double speed), as a signed fraction."""
    divisor = max(1, round(_AVR_CLOCK / 8 / baud))
    return _AVR_CLOCK / 8 / divisor / baud - 1.0


def diagnose_baud(baud: int) -> Finding:
    """Check a rate for a 16 MHz Mega 2560."""
    error = avr_baud_error(baud)
    text = f"a 16 MHz board is {error:+.1%} off {baud} baud"
    if abs(error) <= _GOOD_BAUD_ERROR:
        return Finding(Level.OK, "baud rate", text)
    advice = "works if the other side is accurate; 250000, 500000 and 1000000 are exact"
    return Finding(Level.HINT if abs(error) < 0.039 else Level.BAD, "baud rate", text, advice)


def _permission(device: str) -> Finding:
    try:
        status = Path(device).stat()
    except OSError as error:
        return Finding(Level.BAD, device, f"cannot be checked: {error.strerror}", "is it still plugged in?")
    group = group_name(status.st_gid) or str(status.st_gid)
    mode = stat.filemode(status.st_mode)
    if os.access(device, os.R_OK | os.W_OK):
        level = Level.HINT if status.st_mode & stat.S_IWOTH else Level.OK
        advice = "all users may write to it; a udev rule is better than chmod 777" if level is Level.HINT else ""
        return Finding(level, device, f"this user may open it ({mode}, group {group})", advice)
    user = user_name(user_id())
    if status.st_gid == 0 or not status.st_mode & stat.S_IWGRP:
        advice = "no group may use it: a udev rule for group dialout helps (--fix writes one for USB)"
    else:
        advice = f"sudo usermod -aG {group} {user}, then log out and in"
    return Finding(Level.BAD, device, f"this user may not open it ({mode}, group {group})", advice)


def _mentioned_in_rules(usb_id: str, root: Path, *, also: str = "", named: str = "") -> str:
    """The first udev rule file that mentions a device, or empty."""
    vid, pid = usb_id.split(":")
    for folder in _RULE_FOLDERS:
        for path in sorted((root / folder).glob("*.rules")):
            if named not in path.name:
                continue
            try:
                text = path.read_text(encoding="utf-8", errors="replace").lower()
            except OSError:
                continue
            for line in text.splitlines():
                if line.lstrip().startswith("#"):
                    continue
                if vid in line and pid in line and also.lower() in line:
                    return str(path)
    return ""


def _running(root: Path) -> set[str]:
    """Names of the running processes."""
    names = set()
    for path in (root / "proc").glob("[0-9]*/comm"):
        try:
            names.add(path.read_text(encoding="utf-8", errors="replace").strip())
        except OSError:
            continue  # it ended meanwhile
    return names
