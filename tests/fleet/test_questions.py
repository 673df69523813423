"""Why there is no answer: no way, no such arm, no right, no answer. Zenoh tells none of it."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from tests.few import few
from tests.link.far_ends import free_port
from tests.waits import PATIENCE, eventually

from hexwire.drivers import registry
from hexwire.drivers.base import RobotDriver
from hexwire.drivers.values import StopMode
from hexwire.errors import (
    LinkLostError,
    LinkNotFoundError,
    LinkPermissionError,
    RemoteProtocolError,
    ReplyTimeoutError,
    UsageError,
)
from hexwire.fleet import messages as m
from hexwire.fleet import network, questions
from hexwire.fleet.address import Address
from hexwire.fleet.names import ClientRole, Keys
from hexwire.fleet.network import Network
from hexwire.fleet.node import NoAnswerError, Node
from hexwire.fleet.overview import stop_all
from hexwire.fleet.questions import ask
from hexwire.fleet.rights import Kind
from hexwire.fleet.roster import Roster
from hexwire.fleet.service import Service
from hexwire.fleet.service_file import read_arms
from hexwire.link.certs import issue_certificate
from hexwire.model.state import JointTarget

from .lab import Lab


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    lab = Lab(tmp_path_factory.mktemp("lab"))
    for name, kind, arms in (
        ("arm1", Kind.ARM, ("lab/arm1",)),
        ("mute", Kind.ARM, ("lab/mute",)),
        ("watcher", Kind.OBSERVER, ("lab/*",)),
        ("anna", Kind.OPERATOR, ("lab/*",)),
        ("ben", Kind.OPERATOR, ("hall/*",)),
        ("cora", Kind.MAINTAINER, ("**",)),
    ):
        lab.issue(name, kind, *arms)
    lab.issue("stranger", Kind.OPERATOR, "lab/*", known=False)
    issue_certificate(lab.folder, "plain", "client")
    with lab.routing():
        yield lab


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(questions, "_TIMEOUT", 1.0)


@contextmanager
def elsewhere(folder: Path) -> Iterator[None]:
    """As from another computer: this user serves nothing there."""
    here = os.environ["XDG_RUNTIME_DIR"]
    os.environ["XDG_RUNTIME_DIR"] = os.fspath(folder)
    try:
        yield
    finally:
        os.environ["XDG_RUNTIME_DIR"] = here


@pytest.fixture
def served(lab: Lab, runtime: Path, tmp_path: Path) -> Iterator[Service]:
    """An arm behind the router; this test is another computer."""
    service = Service(read_arms({"lab/arm1": {"robot": "sim"}}), lab.network("arm1"))
    with service, elsewhere(tmp_path):
        yield service


@contextmanager
def connected(lab: Lab, arm: str, name: str, more: str = "") -> Iterator[RobotDriver]:
    robot = registry.connect(lab.url(arm, name, more))
    with robot:
        yield robot


def why(error: BaseException) -> str:
    text = str(error)
    assert "\n" not in text
    return text


def command(robot: RobotDriver) -> None:
    state = robot.read()
    robot.torque(True)
    robot.write(JointTarget(((state.names[0], state.position[0]),), 1.0))


# -- each right, and the error for a missing one ---------------------------------------------------------


@few("name", ["anna", "cora"], "anna")
def test_who_may_command_does(lab: Lab, served: Service, name: str) -> None:
    with connected(lab, "lab/arm1", name) as robot:
        command(robot)
        holder = served._arms[0].shared.holder
        assert holder is not None
        assert holder.client.endswith({"anna": "operator", "cora": "maintainer"}[name])


def test_an_observer_reads_and_stops_but_may_not_command(lab: Lab, served: Service) -> None:
    with connected(lab, "lab/arm1", "watcher") as robot:
        assert robot.read().names
        with pytest.raises(LinkPermissionError, match=r"an observer may read and stop.*watcher\.pem") as raised:
            command(robot)
        why(raised.value)
        robot.stop()
        assert robot.read().stopped


@few("name", ["anna", "cora"], "cora")
def test_who_may_command_stops_with_torque_off(lab: Lab, served: Service, name: str) -> None:
    with connected(lab, "lab/arm1", name) as robot:
        robot.torque(True)
        assert robot.stop(StopMode.TORQUE_OFF) == robot.model.names
        state = robot.read()
        assert (state.stopped, state.torque_on) == (True, ())


def test_torque_off_by_an_observer_stops_the_arm_which_holds(lab: Lab, served: Service) -> None:
    with connected(lab, "lab/arm1", "cora") as cora, connected(lab, "lab/arm1", "watcher") as watcher:
        cora.torque(True)
        words = r"is stopped and holds, with torque: an observer may stop it, but .*watcher\.pem"
        with pytest.raises(LinkPermissionError, match=words) as raised:
            watcher.stop(StopMode.TORQUE_OFF)
        why(raised.value)
        state = watcher.read()
        assert (state.stopped, state.torque_on) == (True, watcher.model.names)
        assert not watcher.epochs.failed, "that stop is confirmed"
        # As a program that does not know its own certificate.
        watcher._commands_as = ClientRole.OPERATOR  # type: ignore[attr-defined]
        with pytest.raises(
            LinkPermissionError, match=r"holds.*\(observer for lab/\*\) does not allow a program to switch its"
        ):
            watcher.stop(StopMode.TORQUE_OFF)
        cora.resume()


@pytest.mark.slow
def test_with_an_older_access_file_torque_off_stops_the_arm_and_says_what_to_do(
    runtime: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab = Lab(tmp_path)
    lab.issue("arm1", Kind.ARM, "lab/arm1")
    lab.issue("anna", Kind.OPERATOR, "lab/*")
    access = lab.access()
    for rule in access["rules"]:
        rule["key_exprs"] = [key for key in rule["key_exprs"] if not key.endswith("/off")]
    monkeypatch.setattr(lab, "access", lambda: access)
    with lab.routing(), Service(read_arms({"lab/arm1": {"robot": "sim"}}), lab.network("arm1")):
        with elsewhere(tmp_path), connected(lab, "lab/arm1", "anna") as robot:
            robot.torque(True)
            words = r"is stopped and holds, with torque: .*may not switch its torque off; .*'hexwire fleet config'"
            with pytest.raises(LinkPermissionError, match=words) as raised:
                robot.stop(StopMode.TORQUE_OFF)
            why(raised.value)
            state = robot.read()
            assert (state.stopped, state.torque_on) == (True, robot.model.names)
        with elsewhere(tmp_path), Roster("lab/*", lab.network("anna")) as roster:
            assert roster.settle(PATIENCE)
            (row,) = stop_all(roster, "Anna", StopMode.TORQUE_OFF)
        assert (row.confirmed, row.joints) == (True, robot.model.names)
        assert "'hexwire fleet config'" in row.kept


def test_a_role_above_that_of_the_certificate_is_denied_by_the_router_and_explained(
    lab: Lab, served: Service
) -> None:
    for name, role in (("watcher", "operator"), ("anna", "maintainer")):
        with connected(lab, "lab/arm1", name, f"&role={role}") as robot:
            words = (
                rf"{name}\.pem \((observer|operator) for lab/\*\) does not allow a program to command it as {role}"
            )
            with pytest.raises(LinkPermissionError, match=words) as raised:
                command(robot)
            why(raised.value)
    assert served._arms[0].shared.holder is None
    assert not served._arms[0].arm.owner.newest().torque_on


BEN = ("ben", r"ben\.pem \(operator for hall/\*\) is not for this arm")
STRANGER = ("stranger", r"the router does not know the certificate .*stranger\.pem \(operator for lab/\*\)")


@few(
    "name, words",
    [
        BEN,
        ("arm1", r"arm1\.pem \(arm for lab/arm1\) is for a server, which may not read"),
        ("mute", r"mute\.pem \(arm for lab/mute\) is not for this arm"),
        ("plain", r"plain\.pem \(without a role\) does not allow a program to read; 'hexwire cert issue'"),
        STRANGER,
    ],
    BEN,
    STRANGER,
)
def test_a_certificate_that_gives_no_right_here_says_so(lab: Lab, served: Service, name: str, words: str) -> None:
    with pytest.raises(LinkPermissionError, match=words) as raised:
        registry.connect(lab.url("lab/arm1", name))
    why(raised.value)


# -- no such arm, no way, no answer -----------------------------------------------------------------------


@few("name", ["anna", "watcher", "cora"], "watcher")
def test_there_is_no_such_arm(lab: Lab, served: Service, name: str) -> None:
    with pytest.raises(LinkNotFoundError, match="there is no arm lab/none") as raised:
        registry.connect(lab.url("lab/none", name))
    why(raised.value)


def test_nobody_is_at_the_address_of_the_router(lab: Lab, runtime: Path) -> None:
    url = lab.url("lab/arm1", "anna").replace(lab.endpoint, f"tls/localhost:{free_port()}")
    with pytest.raises(LinkNotFoundError, match="nobody answers at tls/localhost") as raised:
        registry.connect(url)
    why(raised.value)


def _ask_patiently(node: Node, address: Address, key: str) -> None:
    """Ask again where a stall of the machine has interrupted the connection."""
    for _ in range(5):
        with contextlib.suppress(LinkLostError):
            ask(node, address, key, m.Ask("clock"), 1.0)


@pytest.mark.slow
def test_an_arm_that_is_there_but_does_not_answer(lab: Lab, runtime: Path) -> None:
    keys = Keys("lab/mute")
    with lab.session("mute") as mute, lab.session("anna") as node:
        kept = []
        for key in keys.answered():
            mute.answer(key, kept.append)
        mute.announce(keys.token("1"))
        eventually(lambda: node.visible(keys.alive, 5.0))
        address = Address.parse(lab.url("lab/mute", "anna"))
        for key in (keys.ask, keys.order(ClientRole.OPERATOR)):
            with pytest.raises(ReplyTimeoutError, match="zenoh:lab/mute, whose server is there") as raised:
                _ask_patiently(node, address, key)
            why(raised.value)


@pytest.mark.slow
def test_an_arm_whose_rights_the_router_does_not_know_does_not_exist_for_others_and_says_so(
    lab: Lab, runtime: Path, caplog: pytest.LogCaptureFixture
) -> None:
    lab.issue("late", Kind.ARM, "lab/late", known=False)
    arms = read_arms({"lab/late": {"robot": "sim"}})
    with Service(arms, lab.network("late")) as service, lab.session("cora") as node:
        deadline = time.monotonic() + PATIENCE
        while "router does not know the certificate" not in caplog.text:
            assert time.monotonic() < deadline
            service.check()
            time.sleep(0.02)
        address = Address.parse(lab.url("lab/late", "cora"))
        with pytest.raises(LinkNotFoundError, match="there is no arm lab/late"):
            ask(node, address, Keys("lab/late").ask, m.Ask("facts"), 5.0)


def test_the_connection_is_lost(tmp_path: Path, runtime: Path) -> None:
    lab = Lab(tmp_path / "lab")
    lab.issue("anna", Kind.OPERATOR, "lab/*")
    address = Address.parse(lab.url("lab/arm1", "anna"))
    with lab.routing():
        node = lab.network("anna").open()
        node.ask_neighbours(5.0)
    eventually(lambda: not node.connections)
    try:
        with pytest.raises(LinkLostError, match="connection to the server or router is lost") as raised:
            ask(node, address, Keys("lab/arm1").ask, m.Ask("clock"), 1.0)
        why(raised.value)
    finally:
        node.close()


def test_a_connection_that_ends_while_the_reason_is_looked_for_is_lost(lab: Lab) -> None:
    """What the questions find then says nothing: nobody has heard them."""

    class Ending(Node):
        def __init__(self) -> None:
            self.cert = lab.files("anna")["cert"]
            self._left = [1, 0]

        @property
        def connections(self) -> int:
            return self._left.pop(0)

        def ask(self, key: str, payload: bytes, timeout: float, *, urgent: bool = False) -> bytes:
            raise NoAnswerError(absent=True)

        def ask_neighbours(self, timeout: float) -> None:
            raise NoAnswerError(absent=True)

        def visible(self, key: str, timeout: float) -> list[str]:
            return []

    address = Address.parse(lab.url("lab/arm1", "anna"))
    with pytest.raises(LinkLostError, match="connection to the server or router is lost"):
        ask(Ending(), address, Keys("lab/arm1").ask, m.Ask("clock"), 1.0)


@pytest.mark.slow
@pytest.mark.system
def test_a_router_that_is_stopped_is_not_taken_for_an_arm_that_is_not_there(
    runtime: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    router = subprocess.Popen(
        [sys.executable, "-m", "hexwire.cli", "fleet", "router", "--listen", endpoint], stdout=subprocess.PIPE
    )
    try:
        assert router.stdout is not None
        router.stdout.readline()
        node = Network(connect=(endpoint,)).open()
        address = Address.parse(f"zenoh:lab/arm1?router={endpoint}")
        with pytest.raises(LinkNotFoundError, match="there is no arm lab/arm1"):
            ask(node, address, Keys("lab/arm1").ask, m.Ask("clock"), 5.0)
        router.send_signal(signal.SIGSTOP)
        monkeypatch.setattr(network, "_OPEN", 1.0)
        with pytest.raises(ReplyTimeoutError, match="a question to the server or router of zenoh:lab/arm1"):
            ask(node, address, Keys("lab/arm1").ask, m.Ask("clock"), 1.0)
        with pytest.raises(LinkNotFoundError, match="answers, but not as a server or router: is it stopped"):
            Network(connect=(endpoint,)).open()
        node.close()
    finally:
        router.kill()
        router.communicate()


# -- what comes instead of an answer ----------------------------------------------------------------------


def test_an_answer_of_another_kind_is_an_error() -> None:
    with pytest.raises(RemoteProtocolError, match="not a valid answer"):
        m.convert(["not", "facts"], m.Facts)


def test_what_the_server_refuses_arrives_as_its_error(lab: Lab, served: Service) -> None:
    with lab.session("anna") as node:
        address = Address.parse(lab.url("lab/arm1", "anna"))
        with pytest.raises(UsageError, match="there is no question 'nonsense'"):
            ask(node, address, Keys("lab/arm1").ask, m.Ask("nonsense"), 5.0)


# -- without a router -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_server_that_is_reached_directly_enforces_the_same_rights(tmp_path: Path, runtime: Path) -> None:
    lab = Lab(tmp_path / "lab")
    lab.issue("arm1", Kind.ARM, "lab/arm1")
    lab.issue("anna", Kind.OPERATOR, "lab/*")
    lab.issue("watcher", Kind.OBSERVER, "lab/*")
    lab.issue("ben", Kind.OPERATOR, "hall/*")
    lab.issue("stranger", Kind.OPERATOR, "lab/*", known=False)
    arms = read_arms({"lab/arm1": {"robot": "sim"}})
    network = Network(listen=(lab.endpoint,), **lab.files("arm1"), access=lab.access())
    (tmp_path / "away").mkdir()
    with Service(arms, network):
        with registry.connect("zenoh:lab/arm1") as here:
            command(here)
        with elsewhere(tmp_path / "away"):
            with connected(lab, "lab/arm1", "anna") as robot:
                command(robot)
            with connected(lab, "lab/arm1", "watcher") as robot:
                assert robot.read().names
                robot.stop()
            with (
                connected(lab, "lab/arm1", "watcher", "&role=operator") as robot,
                pytest.raises(LinkPermissionError, match="does not allow a program to command it as operator"),
            ):
                command(robot)
            for name, words in (("ben", "is not for this arm"), ("stranger", "the router does not know")):
                with pytest.raises(LinkPermissionError, match=words):
                    registry.connect(lab.url("lab/arm1", name))
            with pytest.raises(LinkNotFoundError, match="there is no arm lab/arm2"):
                registry.connect(lab.url("lab/arm2", "anna"))


def test_a_short_absence_of_the_server_is_not_reported_as_a_missing_right(
    lab: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its token returns with its connection, and its answers a moment later."""
    address, keys = Address.parse(lab.url("lab/arm1", "anna"), {}), Keys("lab/arm1")
    order = keys.order(ClientRole.OPERATOR)
    visible = Node.visible
    with lab.session("arm1") as server, lab.session("anna") as client:
        server.announce(keys.token("1"))
        eventually(lambda: visible(client, keys.alive, 5.0))

        def returned(node: Node, key: str, timeout: float) -> list[str]:
            server.answer(order, lambda question: question.reply(b""))
            return visible(node, key, timeout)

        monkeypatch.setattr(Node, "visible", returned)
        with pytest.raises(LinkLostError, match="was interrupted and is back"):
            ask(client, address, order, m.Ask("clock"), 1.0)
        # Where the access file of the router is older, nothing is offered to this program.
        with pytest.raises(LinkPermissionError, match="may not"):
            ask(client, address, keys.lease(ClientRole.OPERATOR), m.Ask("clock"), 1.0)
