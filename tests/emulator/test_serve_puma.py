"""The emulated PUMA 260 behind sockets, with hosts that behave badly."""

from __future__ import annotations

import contextlib
import os
import socket
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace

import pytest
from tests.defaults import default
from tests.drivers.puma_server import Served, served_puma
from tests.frames import frame_bytes

from hexwire.drivers.puma260 import Puma260Driver
from hexwire.emulator import serve_puma
from hexwire.emulator.puma import EmulatedPuma
from hexwire.errors import HexwireError
from hexwire.link.listener import Listener
from hexwire.link.tap import Direction, Passed, TapLink, wrap_new_links
from hexwire.session.policy import RetryPolicy
from hexwire.wire.command_frame import Command
from hexwire.wire.robot_bodies import JointCommands

pytestmark = pytest.mark.system


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    # Its thread may wait for a busy machine.
    default(monkeypatch, RetryPolicy, attempts=150)
    with served_puma() as server:
        yield server


def request(cmd: int, seq: int, body: bytes = b"") -> bytes:
    return frame_bytes(cmd, body, seq=seq, src=2, dst=3, type=1)


def call(served: Served) -> socket.socket:
    return socket.create_connection(("127.0.0.1", served.listener.port), timeout=30)


def keep_asking(driver: Puma260Driver, seconds: float) -> None:
    """Ask for a while: an answer that does not come is an error."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        driver.read()


def test_it_announces_where_it_is(served: Served) -> None:
    assert [url.partition(":")[0] for url in served.urls] == ["tcp-listen", "udp-listen"]
    assert str(served.listener.port) in served.urls[0]


def test_tcp_and_udp_hosts_share_the_robot(served: Served) -> None:
    with Puma260Driver.from_url(served.tcp) as one, Puma260Driver.from_url(served.udp) as other:
        one.torque(True)
        assert other.read().torque_on == one.model.names


def test_a_host_that_reads_nothing_is_hung_up_on_and_holds_nobody(served: Served) -> None:
    # Otherwise the kernel takes megabytes of answers before anybody notices. Accepted sockets inherit it.
    listening = served.listener._socket
    assert listening is not None
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
    with socket.socket() as deaf, Puma260Driver.from_url(served.tcp) as driver:
        deaf.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        deaf.connect(("127.0.0.1", served.listener.port))
        deaf.setblocking(False)
        ask, sent, seq = b"", 0, 0
        end = time.monotonic() + 30
        gone = False
        while time.monotonic() < end and not gone:
            if not ask:
                ask = b"".join(request(Command.JOINT_STATES, seq + i) for i in range(200))
                seq += 200
            try:
                sent = deaf.send(ask)
                ask = ask[sent:]
            except BlockingIOError:
                driver.read()
            except ConnectionError:
                gone = True
        assert gone, "it still listens to somebody who takes no answers"
        keep_asking(driver, 0.3)
        assert driver.session.connection.counters.timeouts == 0


def test_hosts_that_say_nonsense_or_half_a_frame_hold_nobody(served: Served) -> None:
    rude = [call(served) for _ in range(5)]
    try:
        rude[0].sendall(bytes(range(256)) * 200)
        rude[1].sendall(request(Command.ROBOT_PROBE, 1)[:-3])
        rude[2].sendall(b"GET / HTTP/1.1\r\n\r\n")
        rude[3].sendall(bytes.fromhex("5AFAFA5A") + bytes(24) + b"\xff\xff\xff\xff")
        with Puma260Driver.from_url(served.tcp) as driver:
            keep_asking(driver, 0.5)
            assert driver.session.connection.counters.timeouts == 0
        # And who was rude may still become polite.
        rude[1].sendall(request(Command.ROBOT_PROBE, 2))
        rude[1].settimeout(30)
        assert rude[1].recv(4096).startswith(bytes.fromhex("5AFAFA5A"))
    finally:
        for link in rude:
            link.close()


def test_hosts_that_come_and_go_leave_nothing_behind(served: Served) -> None:
    for i in range(200):
        with call(served) as link:
            if i % 2:
                link.sendall(request(Command.REPORT, i, b"\x05\0\0"))
    with Puma260Driver.from_url(served.tcp) as driver:
        assert driver.probe().robot == "puma260"


def test_the_most_silent_host_makes_room(served: Served) -> None:
    silent = [call(served) for _ in range(70)]
    try:
        with Puma260Driver.from_url(served.tcp) as driver:
            assert driver.read().names == driver.model.names
            silent[0].settimeout(30)
            assert silent[0].recv(1) == b""
    finally:
        for link in silent:
            link.close()


def test_idle_connections_do_not_displace_the_commander(served: Served) -> None:
    with Puma260Driver.from_url(served.tcp) as driver:
        driver.torque(True)
        half = request(Command.ROBOT_PROBE, 1)[:20]
        rude = []
        try:
            for number in range(300):
                rude.append(call(served))
                if number % 3:
                    rude[-1].sendall(half)
                if number % 10 == 0:
                    driver.read()
            # None of his four channels was hung up on, nor does any answer stay away.
            driver.torque(False)
            driver.stop()
            assert all(session.reconnects == 0 for session in driver.sessions)
            assert all(session.connection.counters.timeouts == 0 for session in driver.sessions)
            # And there is room for another who means it.
            with Puma260Driver.from_url(served.tcp) as other:
                assert other.read().stopped
        finally:
            for link in rude:
                link.close()


class Wire(socket.socket):
    """A UDP socket toward the server, for one who has heard what others sent."""

    def __init__(self, served: Served) -> None:
        super().__init__(socket.AF_INET, socket.SOCK_DGRAM)
        self.connect(("127.0.0.1", served.udp_link.port))
        self.settimeout(0.3)

    def heard(self) -> list[bytes]:
        found = []
        with contextlib.suppress(TimeoutError):
            while True:
                found.append(self.recv(9000))
        return found


def test_another_port_gets_no_answers_and_no_reports_of_the_first(served: Served) -> None:
    with Puma260Driver.from_url(served.udp) as driver, Wire(served) as thief:
        states = driver.stream(0.02)
        next(states)
        for seq in range(20):
            thief.send(request(Command.JOINT_STATES, seq))
            thief.send(request(Command.REPORT, seq, b"\x05\0\0"))
            thief.send(bytes(seq))
            next(states)
        assert thief.heard() == []
        driver.torque(True)
        assert served.robot.power
        states.close()


def test_many_ports_do_not_displace_the_commander(served: Served) -> None:
    with Puma260Driver.from_url(served.udp) as driver:
        driver.torque(True)
        for seq in range(300):
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
                stranger.connect(("127.0.0.1", served.udp_link.port))
                stranger.send(request(Command.IDENTIFY, seq) if seq % 2 else bytes(seq + 1))
            if seq % 20 == 0:
                driver.read()
        driver.torque(False)
        assert driver.session.connection.counters.timeouts == 0
        assert not served.robot.power


def test_recorded_datagrams_switch_nothing_on(served: Served) -> None:
    sent: list[bytes] = []

    def record(passed: Passed) -> None:
        if passed.direction is Direction.SENT:
            sent.append(passed.data)

    with wrap_new_links(lambda link: TapLink(link, record)):
        driver = Puma260Driver.from_url(served.udp)
    with driver:
        driver.torque(True)
        driver.torque(False)
        assert not served.robot.power
        own = driver.session.ipc.link.fileno()  # type: ignore[attr-defined]  # a UDP link's
        with socket.socket(fileno=os.dup(own)) as same_port:
            for data in sent:
                same_port.send(data)
        driver.read()
        assert not served.robot.power
    with Wire(served) as other_port:
        for data in sent * 3:
            other_port.send(data)
        # Only IDENTIFY has an answer: it asks for nothing but that.
        assert len(other_port.heard()) <= 1
    assert not served.robot.power


def test_a_udp_host_is_not_confused_with_the_one_before(served: Served) -> None:
    # Each starts counting at one and asks the same: only asking who is there tells them apart.
    for _ in range(4):
        for on in (True, False):
            with Puma260Driver.from_url(served.udp) as driver:
                driver.torque(on)
            assert served.robot.power is on


def test_noise_on_udp_ends_nothing(served: Served) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.connect(("127.0.0.1", served.udp_link.port))
        for size in (0, 1, 43, 44, 500, 8192, 9000):
            link.send(bytes(size))
        link.send(request(Command.JOINT_STATES, 1)[:-1])
    with Puma260Driver.from_url(served.udp) as driver:
        try:
            driver.read()
        except HexwireError as error:  # pragma: no cover
            pytest.fail(str(error))


@pytest.mark.parametrize("watch", [Command.IDENTIFY, Command.JOINT_STATES, Command.ROBOT_PROBE])
def test_what_came_while_the_server_stalled_is_read_before_silence_is_judged(
    watch: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A velocity runs on for half a second. A server that is late and hears another host first does not end it."""
    stalled = [0.0]
    clock = SimpleNamespace(monotonic=lambda: time.monotonic() + stalled[0], sleep=time.sleep)
    monkeypatch.setattr(serve_puma, "time", clock)
    robot, hosts = EmulatedPuma(start=time.monotonic()), serve_puma._Hosts()
    robot.signal(4)
    spin = JointCommands(("J1",), velocity=(0.02,)).serialize()
    with contextlib.ExitStack() as stack:
        listener = stack.enter_context(Listener())

        def until(true: Callable[[], bool]) -> None:
            end = time.monotonic() + 30.0
            while not true():
                assert time.monotonic() < end
                serve_puma._turn(robot, listener, None, hosts)

        ends = []
        for count in (1, 2):
            ends.append(stack.enter_context(socket.create_connection(("127.0.0.1", listener.port), timeout=30)))
            until(lambda count=count: len(hosts.callers) == count)
        for caller in hosts.callers.values():
            stack.callback(caller.link.close)
        watcher, commander = ends
        for number in range(5):
            before = robot.position[0]
            watcher.sendall(request(watch, number))
            commander.sendall(request(Command.JOINT_COMMANDS, number, spin))
            if number:
                stalled[0] += 2.0
            until(lambda number=number: len(robot.executed) > number)
            if number:
                assert robot.position[0] - before > 1.9 * 0.02, "it ran on all the time"
        # Silence ends it as always.
        stalled[0] += 2.0
        until(lambda: not robot.moving)
