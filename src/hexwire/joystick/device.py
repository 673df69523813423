"""Joysticks and game pads of this machine, through both interfaces of Linux.

Owns the two device formats (`/dev/input/jsN` and, with the `evdev` package, `/dev/input/eventN`) and the scaling of
their values to axes of -1..1. Must not know channels or arms.
"""

from __future__ import annotations

import errno
import os
import struct
import sys
from abc import abstractmethod
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from hexwire.errors import (
    LinkBusyError,
    LinkError,
    LinkLostError,
    LinkNotFoundError,
    LinkPermissionError,
    UsageError,
)
from hexwire.link.base import Openable
from hexwire.system import READABLE, make_poll
from hexwire.wire.robot_bodies import JoystickState

__all__ = ["EvdevJoystick", "JoystickDevice", "JsJoystick", "find_joysticks", "open_joystick"]

_INPUT = Path("/dev/input")
_MOST = 32
# linux/joystick.h
_EVENT = struct.Struct("<IhBB")
_BUTTON, _AXIS, _INIT = 0x01, 0x02, 0x80
_GET_AXES = 0x80016A11
_FULL = 32767
# linux/input-event-codes.h
_EV_SYN, _EV_KEY, _EV_ABS, _SYN_DROPPED = 0x00, 0x01, 0x03, 3
_FIRST_BUTTON, _FIRST_JOYSTICK, _LAST_PAD = 0x100, 0x120, 0x13F


class JoystickDevice(Openable):
    """A joystick of this machine. Constructing one does no I/O.

    Args:
        path: The device.
    """

    def __init__(self, path: str) -> None:
        self.path = path
        self._axes: list[float] = []
        self._buttons = 0

    @property
    def state(self) -> JoystickState:
        """The state, as far as it has been read."""
        return JoystickState(tuple(self._axes), self._buttons)

    @abstractmethod
    def open(self) -> None:
        """Open the device.

        Raises:
            LinkNotFoundError: The device does not exist.
            LinkPermissionError: This user may not read it.
        """

    @abstractmethod
    def close(self) -> None:
        """Close the device. Harmless if it is closed."""

    @abstractmethod
    def fileno(self) -> int:
        """Descriptor that becomes readable when something changes."""

    @abstractmethod
    def _read(self) -> None:
        """Process all available events."""

    def read(self, timeout: float = 0.0) -> JoystickState:
        """Wait for a change, at most `timeout` seconds; returns the state after it.

        Raises:
            LinkLostError: It was unplugged.
        """
        poll = make_poll()
        poll.register(self.fileno(), READABLE)
        try:
            if poll.poll(max(timeout, 0.0) * 1000):
                self._read()
        except BlockingIOError:
            pass
        except LinkError:
            raise
        except OSError as error:
            raise LinkLostError(f"{self.path} was unplugged: {error.strerror or error}", url=self.path) from error
        return self.state

    def _set_axis(self, number: int, value: float) -> None:
        if number < _MOST:
            self._axes += [0.0] * (number + 1 - len(self._axes))
            self._axes[number] = max(-1.0, min(1.0, value))

    def _set_button(self, number: int, down: bool) -> None:
        if number < _MOST:
            self._buttons = self._buttons & ~(1 << number) | down << number


class JsJoystick(JoystickDevice):
    """A joystick through ``/dev/input/jsN``: needs no package, and has only the kernel's calibration."""

    def __init__(self, path: str) -> None:
        super().__init__(path)
        self._fd = -1
        self._rest = b""

    def open(self) -> None:
        if sys.platform != "linux":
            raise UsageError("joysticks are read on Linux only; there, 'hexwire joystick send' sends one")
        import fcntl

        try:
            self._fd = os.open(self.path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        except OSError as error:
            raise _explain(error, self.path) from error
        self._buttons = 0
        # The kernel sends the complete state first; before that, only the number of axes is known.
        count = bytearray(1)
        # Something that only has the format, such as a pipe, has no number.
        with suppress(OSError):
            fcntl.ioctl(self._fd, _GET_AXES, count)
        self._axes = [0.0] * min(count[0], _MOST)

    def close(self) -> None:
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1
            self._rest = b""

    def fileno(self) -> int:
        return self._fd

    def _read(self) -> None:
        data = os.read(self._fd, _EVENT.size * 64)
        if not data:
            raise LinkLostError(f"{self.path} was unplugged", url=self.path)
        data = self._rest + data
        whole = len(data) - len(data) % _EVENT.size
        self._rest = data[whole:]
        for _, value, kind, number in _EVENT.iter_unpack(data[:whole]):
            if kind & ~_INIT == _AXIS:
                self._set_axis(number, value / _FULL)
            elif kind & ~_INIT == _BUTTON:
                self._set_button(number, bool(value))


class EvdevJoystick(JoystickDevice):
    """A joystick through ``/dev/input/eventN``, with the ranges that the device reports.

    Args:
        path: The device.
        device: Replaces `evdev.InputDevice(path)`; for tests.
    """

    def __init__(self, path: str, device: Any = None) -> None:
        super().__init__(path)
        self._given = device
        self._device: Any = None
        self._axis_of: dict[int, tuple[int, Any]] = {}
        self._button_of: dict[int, int] = {}

    def open(self) -> None:
        device = self._given
        if device is None:
            evdev = _import_evdev()
            try:
                device = evdev.InputDevice(self.path)
            except OSError as error:
                raise _explain(error, self.path) from error
        abilities = device.capabilities(absinfo=True)
        axes = sorted(abilities.get(_EV_ABS, ()), key=lambda pair: int(pair[0]))[:_MOST]
        self._axis_of = {code: (number, info) for number, (code, info) in enumerate(axes)}
        codes = [code for code in abilities.get(_EV_KEY, ()) if code >= _FIRST_BUTTON]
        # The order of the other interface, so that button numbers agree: joystick buttons first.
        codes.sort(key=lambda code: (code < _FIRST_JOYSTICK, code))
        self._button_of = {code: number for number, code in enumerate(codes[:_MOST])}
        self._device = device
        self._axes = [0.0] * len(self._axis_of)
        self._read_all()

    def close(self) -> None:
        device, self._device = self._device, None
        if device is not None:
            device.close()

    def fileno(self) -> int:
        return -1 if self._device is None else int(self._device.fd)

    def _read(self) -> None:
        missed = False
        for event in self._device.read():
            if event.type == _EV_SYN and event.code == _SYN_DROPPED:
                missed = True
            elif event.type == _EV_ABS and event.code in self._axis_of:
                number, info = self._axis_of[event.code]
                self._set_axis(number, _normal(event.value, info))
            elif event.type == _EV_KEY and event.code in self._button_of:
                self._set_button(self._button_of[event.code], bool(event.value))
        if missed:
            self._read_all()

    def _read_all(self) -> None:
        """Read the complete state: at the start, and when the kernel reports lost events."""
        for code, (number, info) in self._axis_of.items():
            self._set_axis(number, _normal(self._device.absinfo(code).value, info))
        down = set(self._device.active_keys())
        for code, number in self._button_of.items():
            self._set_button(number, code in down)


def _normal(value: int, info: Any) -> float:
    middle, half = (info.max + info.min) / 2, (info.max - info.min) / 2
    if half <= 0 or abs(value - middle) <= info.flat:
        return 0.0
    return max(-1.0, min(1.0, float((value - middle) / half)))


def find_joysticks(folder: Path = _INPUT) -> list[str]:
    """Paths of the joysticks of this machine: each once, through evdev if that package is installed."""
    try:
        evdev = _import_evdev()
    except UsageError:
        return sorted(map(str, folder.glob("js*")))
    found = []
    for path in sorted(evdev.list_devices(str(folder))):
        try:
            device = evdev.InputDevice(path)
        except OSError:
            continue  # gone, or not readable
        try:
            if _is_joystick(device.capabilities(absinfo=False)):
                found.append(path)
        finally:
            device.close()
    return found or sorted(map(str, folder.glob("js*")))


def _is_joystick(abilities: dict[int, Iterable[int]]) -> bool:
    buttons = any(_FIRST_JOYSTICK <= code <= _LAST_PAD for code in abilities.get(_EV_KEY, ()))
    return buttons and bool(list(abilities.get(_EV_ABS, ())))


def open_joystick(path: str | None = None) -> JoystickDevice:
    """Open a joystick; the caller closes it.

    Args:
        path: The device; the only one plugged in if None.

    Raises:
        LinkNotFoundError: There is no joystick.
        UsageError: There are several, or `evdev` is needed and not installed.
    """
    if path is None:
        found = find_joysticks()
        if not found:
            raise LinkNotFoundError("no joystick is plugged in, or this user may not read /dev/input")
        if len(found) > 1:
            raise UsageError(f"several joysticks: {', '.join(found)}; name one")
        path = found[0]
    device = EvdevJoystick(path) if Path(path).name.startswith("event") else JsJoystick(path)
    device.open()
    return device


def _import_evdev() -> Any:
    try:
        import evdev
    except ImportError as error:
        raise UsageError(
            "this device needs the package evdev: pip install 'hexwire[joystick]' on x86-64; "
            "elsewhere pip install evdev, which needs a compiler"
        ) from error
    return evdev


def _explain(error: OSError, path: str) -> LinkError:
    if error.errno in (errno.EACCES, errno.EPERM):
        return LinkPermissionError(f"{path}: this user may not read it; join the group 'input'", url=path)
    if error.errno in (errno.ENOENT, errno.ENODEV, errno.ENXIO):
        return LinkNotFoundError(f"{path}: there is no such device; 'hexwire joystick list' lists them", url=path)
    if error.errno == errno.EBUSY:
        return LinkBusyError(f"{path}: another program has it open", url=path)
    return LinkError(f"{path} cannot be opened: {error.strerror or error}", url=path)
