"""Several shared arms in one program: start, loss of port and router, and the end that makes them safe."""

from __future__ import annotations

import contextlib
import logging
import multiprocessing
import os
import re
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace

import pytest
from tests.emulator.terminals import serving
from tests.fleet.conftest import Serve
from tests.waits import eventually

from hexwire.drivers import registry
from hexwire.emulator.board import EmulatedBoard, make_hex7bot_board
from hexwire.emulator.serve_pty import PtyServer
from hexwire.errors import DeviceError, LinkError, LinkNotFoundError, StoppedError, UsageError
from hexwire.fleet.network import Network, local_socket
from hexwire.fleet.service import Service, _Served
from hexwire.fleet.service_file import ServedArm, read_arms
from hexwire.model.state import JointTarget


@contextlib.contextmanager
def plugged_in(board: EmulatedBoard, link: Path) -> Iterator[None]:
    """A board at a port that is there in this block only."""
    with serving(PtyServer(board, link=link)):
        yield


def patient(port: Path) -> Sequence[ServedArm]:
    """An arm whose board and whose server wait longer than usual for a sign of life, since these machines stall."""
    return read_arms({"a": {"port": str(port), "watchdog": 5.0}}, lease=3.0)


def new_board() -> EmulatedBoard:
    return make_hex7bot_board(start=time.monotonic())


# -- the start --------------------------------------------------------------------------------------------


def test_it_shares_arms_and_says_so_once(runtime: Path) -> None:
    arms = read_arms({"lab/arm1": {"robot": "sim"}, "lab/arm2": {"robot": "sim"}})
    with Service(arms) as service:
        assert service.news() == [
            "lab/arm1: sim://hex7bot as zenoh:lab/arm1",
            "lab/arm2: sim://hex7bot as zenoh:lab/arm2",
        ]
        assert service.news() == []
        with registry.connect("zenoh:lab/arm1") as one, registry.connect("zenoh:lab/arm2") as two:
            one.torque(True)
            assert one.read().torque_on
            assert not two.read().torque_on
    with pytest.raises(LinkNotFoundError, match="no arm lab/arm1 is served"):
        registry.connect("zenoh:lab/arm1")


def test_a_name_is_served_once(serve: Serve) -> None:
    serve("lab/arm1")
    with pytest.raises(DeviceError, match="already served on this machine"):
        serve("lab/arm1")
    serve("lab/arm2")


def test_an_arm_that_waits_for_its_port_delays_no_other(runtime: Path) -> None:
    port = runtime / "port"
    arms = read_arms({"a": {"port": str(port)}, "b": {"robot": "sim"}})
    service = Service(arms, wait=True)
    try:
        service.start()
        told: list[str] = []

        def waits_and_shares() -> bool:
            service.check()
            told.extend(service.news())
            return len(told) >= 2

        eventually(waits_and_shares)
        assert sorted(told)[0].startswith("a: waiting: ")
        assert str(port) in sorted(told)[0]
        assert sorted(told)[1] == "b: sim://hex7bot as zenoh:b"
        with plugged_in(new_board(), port):
            service.wait_until_shared()
            assert [line.startswith("a: serial://") for line in service.news()] == [True]
            with registry.connect("zenoh:a") as robot:
                assert not robot.read().stopped
            service.close()
    finally:
        service.close()


def test_without_wait_a_port_that_is_not_there_is_an_error(serve: Serve, runtime: Path) -> None:
    with pytest.raises(DeviceError, match="does not exist"):
        serve("a", port=str(runtime / "nothing"), connect_timeout=0.0)


def test_a_wait_is_ended_by_close(runtime: Path) -> None:
    service = Service(read_arms({"a": {"port": str(runtime / "nothing")}}), wait=True)
    service.start()
    eventually(service.news)
    service.close()
    service.check()


# -- folders and files ------------------------------------------------------------------------------------


def test_a_folder_too_long_for_a_socket_is_one_clear_line(
    serve: Serve, runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(runtime / ("x" * 90)))
    with pytest.raises(UsageError, match="too long for the address of a socket; set XDG_RUNTIME_DIR"):
        serve()


def test_without_a_runtime_folder_the_state_folder_is_used(
    serve: Serve, runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    serve()
    assert local_socket("lab/arm1").parent == runtime / "hexwire" / "arms"
    assert local_socket("lab/arm1").parent.stat().st_mode & 0o077 == 0
    with registry.connect("zenoh:lab/arm1") as robot:
        robot.read()


def test_a_folder_that_cannot_be_made_is_one_clear_line(serve: Serve, monkeypatch: pytest.MonkeyPatch) -> None:
    # Not by permissions, which mean nothing to root.
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/proc/1")
    with pytest.raises(UsageError, match=r"/proc/1.*set XDG_RUNTIME_DIR"):
        serve()


def _serve_for_ever(ready: object) -> None:
    with Service(read_arms({"lab/arm1": {"robot": "sim"}})):
        ready.set()  # type: ignore[attr-defined]  # an Event of multiprocessing, whose class has no public name
        time.sleep(600)


@pytest.mark.slow
def test_what_a_killed_server_leaves_does_not_disturb_the_next(serve: Serve, runtime: Path) -> None:
    context = multiprocessing.get_context("spawn")
    ready = context.Event()
    process = context.Process(target=_serve_for_ever, args=(ready,), daemon=True)
    process.start()
    assert ready.wait(60.0)
    assert process.pid is not None
    with registry.connect("zenoh:lab/arm1") as robot:
        robot.read()
        os.kill(process.pid, signal.SIGKILL)
        process.join()
        with pytest.raises(LinkError) as caught:
            robot.read()
        assert "\n" not in str(caught.value)
    assert local_socket("lab/arm1").exists()
    with pytest.raises(LinkNotFoundError, match="no arm lab/arm1 is served"):
        registry.connect("zenoh:lab/arm1")
    serve("lab/arm1")
    with registry.connect("zenoh:lab/arm1") as robot:
        robot.read()


def test_files_of_other_names_are_left_alone(serve: Serve, runtime: Path) -> None:
    folder = local_socket("x").parent
    folder.mkdir(mode=0o700, parents=True)
    (folder / "other.sock").write_text("not a socket")
    (folder / "other.name").symlink_to(runtime / "nowhere")
    serve("lab/arm1")
    assert (folder / "other.sock").read_text() == "not a socket"
    with pytest.raises(UsageError, match=r"other\.name cannot be opened"):
        serve("other")
    assert not (runtime / "nowhere").exists()


# -- loss and return --------------------------------------------------------------------------------------


def test_an_unplugged_arm_stays_shared_and_returns_stopped(
    serve: Serve, runtime: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING, logger="hexwire")
    board, port = new_board(), runtime / "port"
    with plugged_in(board, port):
        serve("a", port=str(port))
        robot = registry.connect("zenoh:a")
        robot.torque(True)
        robot.write(JointTarget.of({"J1": 1.0}, 20.0))
        caplog.clear()
    with robot:
        with pytest.raises(LinkError, match="zenoh:a: "):
            list(robot.stream(0.05))
        with pytest.raises(LinkError, match="cannot be sent"):
            robot.stop()
        # It is the same board, which was not restarted: its servos are where they were.
        with plugged_in(board, port):
            eventually(lambda: "reconnected to the robot" in caplog.text)
            # Depending on which call meets it, the port "went away" or "was lost".
            losses = re.findall("went away|was lost", caplog.text)
            assert len(losses) == caplog.text.count("reconnected") == 1, "each is said once"
            before = robot.read()
            assert before.stopped
            with pytest.raises(StoppedError):
                robot.write(JointTarget.of({"J1": 0.0}, 1.0))
            assert robot.read().positions["J1"] == pytest.approx(before.positions["J1"], abs=0.01)
            robot.resume()
            assert robot.read().positions["J1"] == pytest.approx(before.positions["J1"], abs=0.01)
            robot.write(JointTarget.of({"J1": before.positions["J1"]}, 1.0))


# -- the end ----------------------------------------------------------------------------------------------


def test_the_end_stops_a_motion_and_keeps_torque(serve: Serve, runtime: Path) -> None:
    board, port = new_board(), runtime / "port"
    with plugged_in(board, port):
        with Service(patient(port)), registry.connect("zenoh:a") as robot:
            robot.torque(True)
            # Begun by a program that has left: nobody else would stop it.
            robot.write(JointTarget.of({"J1": 1.0}, 20.0))
        with registry.connect(str(port)) as robot:
            state = robot.read()
            assert (state.stopped, state.watchdog_tripped) == (True, False)
            assert state.torque_on == robot.model.names
            assert abs(state.positions["J1"]) < 0.5
            with pytest.raises(StoppedError):
                robot.write(JointTarget.of({"J1": 0.0}, 1.0))


def test_the_end_does_not_stop_an_arm_that_does_not_move(runtime: Path) -> None:
    board, port = new_board(), runtime / "port"
    with plugged_in(board, port):
        with Service(patient(port)), registry.connect("zenoh:a") as robot:
            robot.torque(True)
        with registry.connect(str(port)) as robot:
            state = robot.read()
            assert (state.stopped, state.torque_on) == (False, robot.model.names)


def test_an_arm_that_does_not_end_takes_no_time_beyond_that_of_all() -> None:
    waited: list[float] = []
    (given,) = read_arms({"a": {"robot": "sim"}})
    served = _Served(given, Network(), False, "", None)
    assert served.join(time.monotonic())
    served._thread = SimpleNamespace(join=waited.append, is_alive=lambda: True)  # type: ignore[assignment]
    assert not served.join(time.monotonic() - 1.0)
    assert waited == [0.0]


# -- the router -------------------------------------------------------------------------------------------


def test_loss_and_return_of_the_router_are_logged_once(runtime: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.WARNING, logger="hexwire")
    endpoint = f"unixsock-stream/{runtime}/router.sock"
    arms = read_arms({"a": {"robot": "sim"}})

    def said(words: str) -> Callable[[], bool]:
        def look() -> bool:
            service.check()
            return words in caplog.text

        return look

    with Service(arms, Network(connect=(endpoint,))) as service:
        eventually(said("no connection to the router"))
        router = Network(listen=(endpoint,), router=True).open()
        try:
            eventually(said("connected to the router"))
            with registry.connect(f"zenoh:a?router={endpoint}") as robot:
                robot.read()
        finally:
            router.close()
        caplog.clear()
        eventually(said("no connection to the router"))
        for _ in range(3):
            service.check()
        assert ["router" in line for line in caplog.messages].count(True) == 1
        with registry.connect("zenoh:a") as robot:
            assert not robot.read().stopped
