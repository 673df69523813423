from __future__ import annotations

import contextlib
import math
import sys
import threading
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest
from tests.emulator.loopback import Loopback

from hexwire.emulator import serve_view
from hexwire.emulator.board import make_hex7bot_board
from hexwire.emulator.bus_arms import make_bus_arm
from hexwire.emulator.physics import PhysicsTwin
from hexwire.emulator.serve import DeviceServer
from hexwire.emulator.serve_view import TwinView, open_window
from hexwire.errors import UsageError
from hexwire.model.arms.hex7bot.kinematics import Hex7BotModel


class Window:
    """A window that shows nothing: what the twin gave it, at each picture."""

    def __init__(self) -> None:
        self.cam = mujoco.MjvCamera()
        self.open = True
        self.locked = 0
        self.pictures: list[np.ndarray] = []

    def __call__(self, model: Any, data: Any) -> Window:
        self.model, self.data = model, data
        return self

    def is_running(self) -> bool:
        return self.open

    @contextlib.contextmanager
    def lock(self) -> Any:
        self.locked += 1
        yield
        self.locked -= 1

    def sync(self) -> None:
        assert not self.locked
        self.pictures.append(self.data.qpos.copy())

    def close(self) -> None:
        self.open = False


def so_view() -> tuple[PhysicsTwin, Any, Window, TwinView]:
    arm = make_bus_arm("so101")
    twin = PhysicsTwin(arm.servos, arm.model)
    window = Window()
    return twin, arm, window, TwinView(twin, arm.servos, window)


def test_thirty_pictures_a_second_however_often_it_is_asked() -> None:
    _, _, window, view = so_view()
    for i in range(1000):
        assert view.step(10.0 + 0.001 * i)
    assert 28 <= len(window.pictures) <= 31


def test_time_passes_for_servos_that_nobody_asks() -> None:
    twin, arm, window, view = so_view()
    for servo in arm.servos:
        servo._write(servo.series.registers["torque_enable"].address, b"\x01")
    pan = arm.servos[0]
    goal = round(pan.motion.position + 400)
    pan._write(pan.series.registers["goal_position"].address, goal.to_bytes(2, "little"))
    for i in range(60):
        view.step(i / 30)
    places = [picture[0] for picture in window.pictures]
    assert places[-1] > places[0] + 0.3
    assert twin.ticks > 1900


def test_the_picture_has_jaws_and_rods_where_the_joints_put_them() -> None:
    board = make_hex7bot_board(baud=0)
    twin = PhysicsTwin(board.wire.servos, Hex7BotModel())
    window = Window()
    view = TwinView(twin, board.wire.servos, window)
    view.step(1.0)
    poses = twin.shapes.poses(twin.positions())
    assert {"jaw_left", "rod"} <= set(poses)
    for name in ("jaw_left", "jaw_right", "crank", "rod", "flange", "forearm"):
        body = window.data.body(name)
        assert list(body.xpos) == pytest.approx(poses[name].position, abs=2e-3)
        assert body.xmat.tolist() == pytest.approx([n for row in poses[name].rotation for n in row], abs=0.02)


def test_what_is_drawn_is_not_what_is_simulated() -> None:
    twin, _, window, view = so_view()
    assert window.data is not twin._data
    window.data.qpos[:] = 1.0
    before = twin.positions()
    view.step(0.0)
    assert twin.positions() == before
    assert window.pictures[0][0] == pytest.approx(before["shoulder_pan"])


def test_the_camera_starts_at_the_arms_right_and_near_it() -> None:
    _, _, window, _ = so_view()
    assert 100 < window.cam.azimuth < 160
    assert -40 < window.cam.elevation < -10
    assert 0.5 < window.cam.distance < 1.2
    assert 0.1 < window.cam.lookat[2] < 0.2


def test_a_closed_window_ends_it() -> None:
    _, _, window, view = so_view()
    view.close()
    assert not window.open
    assert view.step(1.0) is False
    assert window.pictures == []


@pytest.mark.parametrize("shows", [False, True])
def test_a_server_looks_for_every_picture(shows: bool) -> None:
    waits: list[float] = []

    class Server(DeviceServer):
        def open(self) -> str:
            return "here"

        def close(self) -> None:
            waits.append(math.inf)

        def run_once(self, timeout: float = 1.0) -> None:
            waits.append(timeout)

    Server(Loopback(), baud=0, reset_on_open=False, hands=None).serve(
        lambda: len(waits) == 3, lambda address: None, shows=shows
    )
    assert waits == [pytest.approx(1 / 30 if shows else 0.25)] * 3 + [math.inf]


def test_without_a_display_it_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(UsageError, match="no display for --view: run it in a desktop session"):
        open_window(None, None)


def test_without_its_package_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "glfw", None)
    with pytest.raises(UsageError, match=r"--view needs GLFW: pip install 'hexwire\[sim\]'"):
        open_window(None, None)


def test_a_window_that_never_appears_is_no_endless_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    never = threading.Event()
    viewer = SimpleNamespace(launch_passive=lambda *_, **__: never.wait(60.0))
    monkeypatch.setattr(serve_view, "_check_display", lambda: None)
    monkeypatch.setattr(serve_view, "_OPENS", 0.05)
    monkeypatch.setitem(sys.modules, "mujoco.viewer", viewer)
    monkeypatch.setattr(mujoco, "viewer", viewer, raising=False)
    with pytest.raises(UsageError, match="this display has no OpenGL"):
        open_window(None, None)
    never.set()


def test_closing_waits_for_the_threads_that_draw(monkeypatch: pytest.MonkeyPatch) -> None:
    ended, drawn = threading.Event(), threading.Event()

    def draw() -> None:
        ended.wait(60.0)
        drawn.set()

    def launch(*_: Any, **__: Any) -> Any:
        threading.Thread(target=draw, daemon=True).start()
        return SimpleNamespace(close=ended.set, is_running=lambda: True)

    viewer = SimpleNamespace(launch_passive=launch)
    monkeypatch.setattr(serve_view, "_check_display", lambda: None)
    monkeypatch.setitem(sys.modules, "mujoco.viewer", viewer)
    monkeypatch.setattr(mujoco, "viewer", viewer, raising=False)
    window = open_window(None, None)
    assert window.is_running()
    window.close()
    assert drawn.is_set()
