"""`hexwire loopback` on a pseudo-terminal whose far end returns everything, or nothing."""

from __future__ import annotations

import json
import os
import select
import threading
import tty
from collections.abc import Iterator

import pytest
from click.testing import CliRunner

from hexwire.cli.doctor import loopback
from hexwire.errors import LinkError, UsageError


@pytest.fixture
def plug(request: pytest.FixtureRequest) -> Iterator[str]:
    master, slave = os.openpty()
    tty.setraw(slave)
    stop_read, stop_write = os.pipe()

    def echo() -> None:
        while True:
            ready, _, _ = select.select([master, stop_read], [], [])
            if stop_read in ready:
                return
            data = os.read(master, 4096)
            if request.param:
                os.write(master, data)

    thread = threading.Thread(target=echo)
    thread.start()
    yield os.ttyname(slave)
    os.write(stop_write, b"x")
    thread.join()
    for fd in (master, slave, stop_read, stop_write):
        os.close(fd)


@pytest.mark.parametrize("plug", [True], indirect=True)
def test_a_good_cable_at_every_rate(plug: str) -> None:
    result = CliRunner().invoke(loopback, ["--port", plug, "--bytes", "128", "--json"])
    assert result.exit_code == 0, result.output
    rows = json.loads(result.output)
    assert [row["baud"] for row in rows] == [38400, 57600, 76800, 115200, 128000, 250000, 500000, 1000000]
    assert all(row["good"] and row["returned"] == 128 for row in rows)


@pytest.mark.parametrize("plug", [False], indirect=True)
def test_without_a_plug_it_fails_in_words(plug: str) -> None:
    result = CliRunner().invoke(loopback, ["--port", plug, "--baud", "115200"])
    assert isinstance(result.exception, LinkError)
    assert "115200" in str(result.exception)
    assert "TX wired to RX" in result.output


@pytest.mark.parametrize(("port", "text"), [("tcp://127.0.0.1:9", "serial"), ("/dev/null?baud=9600", "--baud")])
def test_invalid_ports_are_refused(port: str, text: str) -> None:
    result = CliRunner().invoke(loopback, ["--port", port])
    assert isinstance(result.exception, UsageError)
    assert text in str(result.exception)
