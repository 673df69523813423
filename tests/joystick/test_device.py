"""Joysticks made of synthetic events: a pipe that speaks the kernel's format, and a stand-in for evdev."""

from __future__ import annotations

import errno
import os
import struct
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.errors import (
    LinkBusyError,
    LinkError,
    LinkLostError,
    LinkNotFoundError,
    LinkPermissionError,
    UsageError,
)
from hexwire.joystick import device as joystick_device
from hexwire.joystick.device import EvdevJoystick, JsJoystick, find_joysticks, open_joystick

EV_KEY, EV_ABS = 1, 3
SOUTH, EAST, TL = 0x130, 0x131, 0x136
ABS_X, ABS_Z, HAT = 0, 2, 16


def js(kind: int, number: int, value: int) -> bytes:
    return struct.pack("<IhBB", 1, value, kind, number)


class Pipe:
    """A named pipe in the place of /dev/input/js0."""

    def __init__(self, folder: Path) -> None:
        self.path = str(folder / "js0")
        os.mkfifo(self.path)
        self.stick = JsJoystick(self.path)
        self.stick.open()
        self.fd = os.open(self.path, os.O_WRONLY)

    def tell(self, *events: bytes) -> None:
        os.write(self.fd, b"".join(events))

    def close(self) -> None:
        if self.fd >= 0:
            os.close(self.fd)
            self.fd = -1
        self.stick.close()


@pytest.fixture
def pipe(tmp_path: Path) -> Iterator[Pipe]:
    made = Pipe(tmp_path)
    yield made
    made.close()


def test_axes_and_buttons_of_the_plain_interface(pipe: Pipe) -> None:
    # What the kernel tells at the beginning is marked, and means the same.
    pipe.tell(js(0x82, 0, 0), js(0x82, 1, -32767), js(0x81, 0, 0), js(0x81, 4, 1))
    state = pipe.stick.read(1.0)
    assert (state.axes, state.buttons) == ((0.0, -1.0), 1 << 4)
    pipe.tell(js(0x02, 0, 16384), js(0x02, 1, -32768), js(0x01, 4, 0), js(0x01, 2, 1))
    state = pipe.stick.read(1.0)
    assert state.axes == pytest.approx((0.5, -1.0), abs=1e-4)
    assert [i for i in range(32) if state.pressed(i)] == [2]


def test_before_the_kernel_tells_of_any_there_are_no_axes(pipe: Pipe) -> None:
    assert pipe.stick.state.axes == ()


def test_half_an_event_waits_for_the_rest(pipe: Pipe) -> None:
    event = js(0x01, 3, 1)
    pipe.tell(event[:5])
    assert pipe.stick.read(1.0).buttons == 0
    pipe.tell(event[5:])
    assert pipe.stick.read(1.0).pressed(3)
    # A device that is opened again begins with a whole one.
    pipe.tell(event[:5])
    pipe.stick.read(1.0)
    pipe.stick.close()
    pipe.stick.open()
    pipe.tell(event)
    assert pipe.stick.read(1.0).pressed(3)


def test_no_news_is_the_state_as_it_was(pipe: Pipe) -> None:
    pipe.tell(js(0x01, 3, 1))
    pipe.stick.read(1.0)
    assert pipe.stick.read(0.0).pressed(3)


def test_numbers_beyond_what_a_frame_carries_are_left_out(pipe: Pipe) -> None:
    pipe.tell(js(0x02, 255, 5), js(0x01, 255, 1), js(0x7F, 0, 1), js(0x02, 31, 32767))
    state = pipe.stick.read(1.0)
    assert (len(state.axes), state.axes[31], state.buttons) == (32, 1.0, 0)
    assert len(state.serialize()) == 5 + 64


def test_unplugged(pipe: Pipe) -> None:
    os.close(pipe.fd)
    pipe.fd = -1
    with pytest.raises(LinkLostError, match="js0 was unplugged"):
        pipe.stick.read(1.0)
    pipe.stick.close()
    assert pipe.stick.fileno() == -1


@given(st.lists(st.binary(max_size=40), max_size=10))
def test_any_bytes_are_some_state(tmp_path_factory: pytest.TempPathFactory, pieces: list[bytes]) -> None:
    pipe = Pipe(tmp_path_factory.mktemp("js"))
    try:
        for piece in pieces:
            pipe.tell(piece)
            state = pipe.stick.read(0.0)
            assert len(state.serialize()) <= 5 + 64
    finally:
        pipe.close()


class FakeDevice:
    """What of evdev.InputDevice is used, over a pipe."""

    def __init__(self) -> None:
        self.fd, self._end = os.pipe()
        os.set_blocking(self.fd, False)
        self.values = {ABS_X: 128, ABS_Z: 0, HAT: 0}
        self.info = {
            ABS_X: SimpleNamespace(min=0, max=255, flat=15),
            ABS_Z: SimpleNamespace(min=0, max=1023, flat=0),
            HAT: SimpleNamespace(min=-1, max=1, flat=0),
        }
        self.keys: list[int] = []
        self.events: list[Any] = []
        self.gone = False

    def capabilities(self, absinfo: bool = True) -> dict[int, list[Any]]:
        return {EV_ABS: [(HAT, self.info[HAT]), (ABS_X, self.info[ABS_X]), (ABS_Z, self.info[ABS_Z])],
                EV_KEY: [TL, SOUTH, EAST, 0x100, 30]}  # fmt: skip

    def absinfo(self, code: int) -> Any:
        return SimpleNamespace(value=self.values[code])

    def active_keys(self) -> list[int]:
        return self.keys

    def read(self) -> Iterator[Any]:
        os.read(self.fd, 4096)
        if self.gone:
            raise OSError(19, "No such device")
        events, self.events = self.events, []
        yield from events

    def tell(self, kind: int, code: int, value: int) -> None:
        self.events.append(SimpleNamespace(type=kind, code=code, value=value))
        os.write(self._end, b"x")

    def close(self) -> None:
        os.close(self.fd)
        os.close(self._end)


@pytest.fixture
def fake() -> Iterator[tuple[FakeDevice, EvdevJoystick]]:
    device = FakeDevice()
    stick = EvdevJoystick("/dev/input/event9", device)
    with stick:
        yield device, stick


def test_evdev_ranges_and_order(fake: tuple[FakeDevice, EvdevJoystick]) -> None:
    device, stick = fake
    # X at rest within its flat, a trigger at its end, the hat: in the order of their codes.
    assert stick.state.axes == pytest.approx((0.0, -1.0, 0.0))
    device.tell(EV_ABS, ABS_X, 255)
    device.tell(EV_ABS, ABS_Z, 1023)
    device.tell(EV_ABS, HAT, -1)
    device.tell(EV_KEY, TL, 1)
    device.tell(EV_KEY, SOUTH, 1)
    device.tell(EV_KEY, 30, 1)  # a key of a keyboard is no button
    state = stick.read(1.0)
    assert state.axes == (1.0, 1.0, -1.0)
    assert state.buttons == 0b101  # SOUTH, EAST, TL; the button that is no joystick's comes behind them
    device.tell(EV_KEY, TL, 0)
    device.tell(EV_KEY, 0x100, 1)
    assert stick.read(1.0).buttons == 0b1001


def test_evdev_lost_events_are_asked_for(fake: tuple[FakeDevice, EvdevJoystick]) -> None:
    device, stick = fake
    device.values[ABS_X] = 0
    device.keys = [EAST]
    device.tell(0, 3, 0)
    state = stick.read(1.0)
    assert (state.axes[0], state.buttons) == (-1.0, 0b010)


def test_evdev_unplugged(fake: tuple[FakeDevice, EvdevJoystick]) -> None:
    device, stick = fake
    device.gone = True
    device.tell(0, 0, 0)
    with pytest.raises(LinkLostError, match="event9 was unplugged: No such device"):
        stick.read(1.0)


def test_devices_are_found_and_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert find_joysticks(tmp_path) == []
    monkeypatch.setattr(joystick_device, "find_joysticks", list)
    with pytest.raises(LinkNotFoundError, match="no joystick is plugged in"):
        open_joystick()
    monkeypatch.setattr(joystick_device, "find_joysticks", lambda: ["/dev/input/js0", "/dev/input/js1"])
    with pytest.raises(UsageError, match="several joysticks"):
        open_joystick()
    for name in ("js7", "event7"):
        with pytest.raises(LinkNotFoundError, match="there is no such device"):
            open_joystick(str(tmp_path / name))
    os.mkfifo(tmp_path / "js0")
    stick = open_joystick(str(tmp_path / "js0"))
    assert isinstance(stick, JsJoystick)
    stick.close()
    assert find_joysticks(tmp_path) == [str(tmp_path / "js0")]


class Machine:
    """What of the package evdev is used to find a joystick: of each device, what it can do."""

    def __init__(self, **devices: dict[int, list[int]] | None) -> None:
        self.devices = devices

    def list_devices(self, folder: str) -> list[str]:
        return [f"{folder}/{name}" for name in self.devices]

    def InputDevice(self, path: str) -> Any:  # noqa: N802  (the name is evdev's)
        abilities = self.devices[Path(path).name]
        if abilities is None:
            raise OSError(errno.EACCES, "Permission denied")
        return SimpleNamespace(capabilities=lambda absinfo: abilities, close=lambda: None)


def test_a_joystick_has_axes_and_the_buttons_of_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    machine = Machine(
        event0=None,  # this user may not read it
        event7={EV_ABS: [ABS_X], EV_KEY: [SOUTH]},
        event1={EV_ABS: [ABS_X], EV_KEY: [0x120]},
        event2={EV_ABS: [ABS_X], EV_KEY: [0x13F]},
        mouse={EV_ABS: [ABS_X], EV_KEY: [0x11F]},
        pen={EV_ABS: [ABS_X], EV_KEY: [0x140]},
        remote={EV_KEY: [SOUTH]},
    )
    monkeypatch.setattr(joystick_device, "_import_evdev", lambda: machine)
    assert find_joysticks(tmp_path) == [str(tmp_path / f"event{number}") for number in (1, 2, 7)]


def test_the_only_joystick_is_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    os.mkfifo(tmp_path / "js0")
    monkeypatch.setattr(joystick_device, "find_joysticks", lambda: [str(tmp_path / "js0")])
    stick = open_joystick()
    assert stick.path == str(tmp_path / "js0")
    stick.close()


@pytest.mark.parametrize(
    ("number", "kind"),
    [
        (errno.EACCES, LinkPermissionError),
        (errno.EPERM, LinkPermissionError),
        (errno.ENODEV, LinkNotFoundError),
        (errno.EBUSY, LinkBusyError),
        (errno.EIO, LinkError),
    ],
)
def test_why_a_joystick_does_not_open_is_told_with_its_path(number: int, kind: type[LinkError]) -> None:
    error = joystick_device._explain(OSError(number, os.strerror(number)), "/dev/input/js0")
    assert type(error) is kind
    assert error.url == "/dev/input/js0"
    assert str(error).startswith("/dev/input/js0")


def test_an_axis_without_a_range_stays_in_the_middle() -> None:
    assert joystick_device._normal(7, SimpleNamespace(min=5, max=5, flat=0)) == 0.0
    assert joystick_device._normal(9, SimpleNamespace(min=5, max=9, flat=0)) == 1.0


def test_an_axis_is_as_far_from_the_middle_as_its_value_is_from_that_of_its_range() -> None:
    # Some devices report more than they announce.
    for value, axis in ((-5, -1.0), (5, -1.0), (6, -0.5), (7, 0.0), (8, 0.5), (9, 1.0), (19, 1.0)):
        assert joystick_device._normal(value, SimpleNamespace(min=5, max=9, flat=0)) == axis, value


def test_a_device_without_buttons_has_none() -> None:
    class Wheel:
        def capabilities(self, absinfo: bool) -> dict[int, Any]:
            return {}

        def active_keys(self) -> list[int]:
            return []

        def close(self) -> None: ...

    stick = EvdevJoystick("wheel", Wheel())
    assert stick.fileno() == -1
    stick.open()
    assert (stick._axes, stick._button_of) == ([], {})
    stick.close()
    assert stick.fileno() == -1
