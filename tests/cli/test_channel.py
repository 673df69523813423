"""`--all` on `probe`, `stop` and `resume`: every board behind a gateway."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import suppress

import pytest
from click.testing import CliRunner, Result
from tests.defaults import patient_line
from tests.drivers.puma_server import served_puma
from tests.gateway.tcp_boards import Running, tcp_boards, wait
from tests.waits import until

from hexwire.cli import channel
from hexwire.cli.main import cli
from hexwire.drivers import registry
from hexwire.errors import ReplyTimeoutError
from hexwire.ipc.session import Session
from hexwire.link.listener import Listener
from hexwire.session.events import Answers


def run(*words: str) -> Result:
    return CliRunner().invoke(cli, list(words))


def let_all_answer(patch: pytest.MonkeyPatch, count: int) -> None:
    """Wait for so many boards: a busy machine lets them be silent for longer than a command waits."""
    find = channel._find

    def look(session: Session) -> Answers | None:
        with suppress(ReplyTimeoutError):
            found = find(session)
            if len(found.replies) == count:
                return found
        return None

    patch.setattr(channel, "_find", lambda session: until(lambda: look(session), f"{count} boards are found"))
    patch.setattr(channel, "_STOP_WINDOW", 5.0)
    patient_line(patch, window=5.0)


@pytest.fixture(scope="module")
def two_boards() -> Iterator[Running]:
    with tcp_boards(2) as boards:
        running = Running(boards)
        yield running
        running.end()


@pytest.fixture
def gateway(two_boards: Running, monkeypatch: pytest.MonkeyPatch) -> Running:
    """A gateway to two boards, neither of which is ever silent."""
    let_all_answer(monkeypatch, 2)
    return two_boards


@pytest.mark.system
def test_probe_shows_every_board(gateway: Running) -> None:
    result = run("probe", "--all", "--port", gateway.url)
    assert result.exit_code == 0, result.output
    lines = result.stdout.splitlines()
    assert [line.partition(":")[0] for line in lines] == ["ARM_7BOT_ARDUINO_TRX (8)", "module 9 (9)"]
    assert all("7 of 7 servos answer" in line for line in lines)
    rows = json.loads(run("probe", "--all", "--json", "--port", gateway.url).stdout)
    assert [(row["module"], row["present"], row["stopped"]) for row in rows] == [(8, 7, False), (9, 7, False)]


@pytest.mark.system
def test_stop_and_resume_all(gateway: Running) -> None:
    assert run("torque", "on", "J2", "--port", f"{gateway.url}?to=8").exit_code == 0
    result = run("stop", "--all", "--port", gateway.url)
    assert result.exit_code == 0, result.output
    assert result.stdout.splitlines() == [
        "module 8: stopped, holding: J2; limp: J1 J3 J4 J5 J6 J7",
        "module 9: stopped, limp: J1 J2 J3 J4 J5 J6 J7",
    ]
    assert gateway.boards.stopped() == [True, True]
    names = [f"J{i}" for i in range(1, 8)]
    assert json.loads(run("stop", "--all", "--json", "--port", gateway.url).stdout) == {
        "did": "stopped",
        "confirmed": {"8": names, "9": names},
        "does": {
            "8": {"holding": ["J2"], "limp": [name for name in names if name != "J2"], "unknown": []},
            "9": {"holding": [], "limp": names, "unknown": []},
        },
        "silent": [],
    }
    assert "stopped" in run("probe", "--all", "--port", gateway.url).stdout
    result = run("resume", "--all", "--json", "--port", gateway.url)
    assert json.loads(result.stdout) == {"resumed": [8, 9], "silent": []}
    assert gateway.boards.stopped() == [False, False]


@pytest.mark.system
def test_a_watchdog_that_has_tripped_does_not_trip_again_after_resume(gateway: Running) -> None:
    state = gateway.boards.boards[1].state
    state.watchdog_timeout = 60.0
    state.watchdog_tripped = state.stopped = True
    assert run("resume", "--all", "--port", gateway.url).exit_code == 0
    assert (state.watchdog_timeout, state.watchdog_due, state.stopped) == (0.0, None, False)


@pytest.mark.system
def test_a_joint_that_does_not_confirm_is_an_error(gateway: Running) -> None:
    servo = gateway.boards.boards[1].wire[3]
    plain = servo.receive
    servo.receive = lambda packet, now: None  # type: ignore[method-assign]  # it has lost its supply
    try:
        result = run("stop", "--all", "--torque-off", "--port", gateway.url)
        assert result.exit_code == 1
        assert "of module 9" in result.stderr
        assert "module 9: stopped, limp: J1 J2 J3 J5 J6 J7; unknown: J4" in result.stdout
    finally:
        servo.receive = plain  # type: ignore[method-assign]
        run("resume", "--all", "--port", gateway.url)


@pytest.mark.slow
@pytest.mark.system
def test_boards_that_cannot_be_reached_are_named_by_each_command(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lost by the gateway before the command begins, connected but silent, and all of them."""
    patient_line(monkeypatch)
    with tcp_boards(3) as boards:
        running = Running(boards)
        try:
            boards.unplug(1)
            lines = running.service.machine.lines
            wait(lambda: not lines[9].up)
            plain = boards.boards[2].receive
            boards.boards[2].receive = lambda data, now: None  # type: ignore[method-assign]  # it hangs
            for command in ("stop", "probe", "resume"):
                result = run(command, "--all", "--json", "--port", running.url)
                assert result.exit_code == 1, result.output
                assert "no answer to modules 9, 10 after" in result.stderr
                data = json.loads(result.stdout)
                if command == "probe":
                    assert [(row["module"], row["silent"]) for row in data] == [(8, False), (9, True), (10, True)]
                else:
                    assert data["silent"] == [9, 10]
                assert ("stopped when it is back" in result.stderr) == (command == "stop")
            boards.boards[2].receive = plain  # type: ignore[method-assign]
            boards.plug_in(1)
            boards.wait_until_stopped(1)
            for index in range(3):
                boards.unplug(index)
            wait(lambda: not any(line.up for line in lines.values()))
            for command in ("stop", "probe", "resume"):
                result = run(command, "--all", "--port", running.url)
                assert result.exit_code == 1
                assert result.stdout.splitlines() == [f"module {m}: no answer" for m in (8, 9, 10)]
                assert "no answer to modules 8, 9, 10 after" in result.stderr
        finally:
            running.end()


@pytest.mark.system
def test_nobody_answers() -> None:
    with Listener() as listener:
        result = run("probe", "--all", "--port", listener.url.replace("-listen", ""))
    assert result.exit_code == 1
    assert "IDENTIFY to all modules" in result.stderr
    assert "gateway" in result.stderr


@pytest.mark.system
def test_a_board_without_a_gateway_is_a_channel_too(monkeypatch: pytest.MonkeyPatch) -> None:
    let_all_answer(monkeypatch, 1)
    with tcp_boards(1) as boards:
        boards.boards[0].connection.local = 12
        result = run("probe", "--all", "--port", boards.urls[0])
    assert result.stdout.startswith("module 12 (12): ")


@pytest.mark.slow
@pytest.mark.system
def test_a_board_of_another_host_is_not_called_resumed(gateway: Running) -> None:
    with registry.connect(f"{gateway.url}?to=9") as other:
        assert run("stop", "--all", "--port", gateway.url).exit_code == 0
        assert other.read().stopped
        for words in ((), ("--json",)):
            result = run("resume", "--all", *words, "--port", gateway.url)
            assert result.exit_code == 1
            assert "module 9 is not resumed: module 9 has another host" in result.stderr
        assert json.loads(result.stdout) == {"resumed": [8], "silent": []}
        result = run("resume", "--all", "--port", gateway.url)
        assert result.stdout.splitlines()[0] == "module 8: resumed"
        assert result.stdout.splitlines()[1].startswith("module 9: not resumed: module 9 has another host")
        assert other.read().stopped
        other.resume()


@pytest.mark.system
def test_over_datagrams_it_is_said_where_to_ask_all() -> None:
    with served_puma() as server:
        for command in ("stop", "probe", "resume"):
            result = run(command, "--all", "--port", server.udp)
            assert result.exit_code == 2, (command, result.output)
            assert "give the TCP port of the gateway" in result.stderr


def test_what_does_not_fit_a_channel() -> None:
    result = run("stop", "--all", "--baud", "9600", "--port", "tcp://127.0.0.1:1")
    assert result.exit_code == 2
    assert "--baud" in result.stderr
