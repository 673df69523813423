"""Programs around a shared arm are killed, stopped, flooded and doubled: the three promises of `fleet_watch` hold.

Real processes of one machine at a Unix socket. Each test ends with the check of everything since the start.
"""

from __future__ import annotations

import struct
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.system.fleet_programs import NAME, STOPPED, Lab
from tests.system.fleet_watch import TIMEOUT
from tests.system.programs import PATIENCE
from tests.waits import eventually

pytestmark = pytest.mark.system

WALL_CLOCK = Path(__file__).with_name("wall_clock.c")


@pytest.fixture(scope="module")
def home() -> Iterator[Lab]:
    with tempfile.TemporaryDirectory(prefix="hw-", dir="/tmp") as folder, Lab(Path(folder)) as lab:
        yield lab


@pytest.fixture
def lab(home: Lab) -> Iterator[Lab]:
    home.begin_all()
    yield home
    home.check()


@pytest.mark.slow
def test_an_operator_that_is_killed_leaves_an_arm_that_holds_and_says_why(lab: Lab) -> None:
    lab.setting_out()
    lab.operator.kill()
    eventually(lambda: f"lost the lease after {TIMEOUT:g} s of silence" in str(lab.last().get("held")))
    there = lab.resting(0)
    # Nobody needs to be asked for it now, and nothing moves by taking it.
    lab.operator = lab.client()
    lab.operator.do("take")
    eventually(lambda: lab.last()["held"] == "")
    assert lab.position(0) == there


@pytest.mark.slow
def test_a_server_that_is_killed_leaves_an_arm_that_its_board_stops(lab: Lab) -> None:
    lab.setting_out()
    killed = lab.server.kill()
    # Who reads learns of it, and who commands does.
    eventually(lambda: lab.last("lost").get("t", 0) > killed)
    assert lab.operator.ask("move", 1.0, J1=0.0)["error"] in ("LinkLostError", "LinkNotFoundError")
    there = lab.resting(0)
    lab.server = lab.serve()
    # The arm was stopped while nobody served it, and stays so.
    eventually(lambda: bool(lab.last()["stopped"]) and lab.last()["t"] > killed + 1)
    # The operator finds the server again at a time of its own.
    refused: list[str] = []

    def asked() -> bool:
        refused.append(lab.operator.ask("move", 1.0, J1=0.0)["error"])
        return refused[-1] not in ("LinkLostError", "LinkNotFoundError")

    eventually(asked)
    assert refused[-1] in ("LeaseError", "StoppedError"), refused
    assert lab.position(0) == there
    # The same programs go on, by hand.
    lab.operator.do("take", force=True)
    lab.operator.do("resume")
    before = lab.setting_out()
    assert before == there


@pytest.mark.slow
def test_an_operator_that_is_stopped_loses_the_lease_and_gets_an_error(lab: Lab) -> None:
    lab.swinging()
    with lab.operator.stopped() as begin:
        eventually(lambda: "lost the lease" in str(lab.last()["held"]))
        end = time.monotonic()
    lab.cuts.append((begin, end))
    # It goes on with its stream, which is refused until it takes the lease again. The order that was under way may
    # have been left without an answer.

    def rows_refused() -> list[dict[str, Any]]:
        return [row for row in lab.rows() if row["e"] == "refused" and row["t"] > end]

    eventually(lambda: len(rows_refused()) > 5)
    refused = rows_refused()
    assert {row["error"] for row in refused[1:]} == {"LeaseError"}
    lab.operator.do("rest")


def test_a_server_that_is_stopped_moves_nothing_when_it_goes_on(lab: Lab) -> None:
    lab.swinging()
    with lab.server.stopped() as begin:
        there = lab.resting(0)
        time.sleep(STOPPED)
        end = time.monotonic()
    lab.cuts.append((begin, end))
    eventually(lambda: bool(lab.last()["stopped"]) and lab.last()["t"] > end)
    lab.operator.do("rest")
    assert lab.operator.ask("move", 1.0, J1=0.0)["error"] in ("LeaseError", "StoppedError")
    # Neither what waited in its sockets nor what came later.
    assert lab.resting(0) == there


@pytest.mark.slow
def test_a_stop_reaches_a_server_that_was_stopped_and_is_confirmed_only_then(lab: Lab) -> None:
    lab.setting_out()
    with lab.server.stopped() as begin:
        lab.reader.send("stop")
        time.sleep(STOPPED)
        end = time.monotonic()
    lab.cuts.append((begin, end))
    answer = lab.reader.answer()
    assert "error" not in answer, answer
    assert answer["ended"] > end
    # What moves afterwards, `check` sees.
    lab.resting(0)


@pytest.mark.slow
def test_a_reader_that_is_stopped_delays_nobody(lab: Lab) -> None:
    slow = lab.client()
    slow.do("watch", 0.01)
    lab.swinging()
    before = lab.server.memory()
    with slow.stopped() as begin:
        time.sleep(STOPPED)
        # Far more than a server would send that waits for the slow one, which has taken nothing for long.
        eventually(lambda: len(lab.states(begin)) > 100)
        last = time.monotonic()
        eventually(lambda: len(lab.states(last)) > 20)
        eventually(lambda: len([r for r in lab.rows() if r["e"] == "answered" and r["t"] > last]) > 10)
        end = time.monotonic()
    assert lab.server.memory() - before < 20e6
    lab.operator.do("rest")
    assert not lab.lost(begin)
    assert not lab.refused(begin, end)
    # What waited for the slow one is older than it thinks only if a stamp is wrong: `check` looks. It catches up.
    time.sleep(0.5)
    assert slow.do("rest")["states"] > 0
    slow.do("close")
    slow.end()


@pytest.mark.slow
def test_ten_thousand_orders_a_second_without_a_lease_do_not_disturb_its_holder(lab: Lab) -> None:
    intruder = lab.client()
    before = lab.reader.do("counters")
    lab.operator.do("stream", 20.0, J1=0.3)
    begin = time.monotonic()
    counts = intruder.do("flood", 10_000, 0.8)
    end = time.monotonic()
    lab.operator.do("rest")
    assert counts["done"] == 0
    # An intruder that stalls loses answers with its connection: it takes none, and must not hold up others.
    assert counts["sent"] >= counts["refused"] > 0.5 * counts["sent"] > 100
    after = lab.reader.do("counters")
    assert after["lease_without_lease"] - before["lease_without_lease"] >= counts["refused"]
    assert after["lease_lost"] == before["lease_lost"]
    # Where the processor is busy with other things too, a set-point may come too late; most are done.
    rows = [row for row in lab.rows() if begin < row["t"] < end]
    sent = {row["n"] for row in rows if row["e"] == "sent" and row["what"] == "Write"}
    done = {row["n"] for row in rows if row["e"] == "answered" and not row["refused"]}
    assert len(sent & done) > 0.5 * len(sent) > 2
    # How many states a reader gets meanwhile is the machine's doing.
    assert len([row for row in rows if row["e"] == "state" and row["client"] == 0]) > 2
    intruder.do("close")
    intruder.end()


@pytest.mark.slow
def test_a_second_server_of_a_name_is_refused_and_the_first_goes_on(lab: Lab) -> None:
    lab.setting_out()
    second = lab.begin("serve", "--port", "sim", "--name", NAME)
    assert second.process.wait(PATIENCE) != 0
    assert f"the name {NAME} is already served" in lab.folder.joinpath("errors.log").read_text()
    lab.operator.do("move", 0.5, J1=0.0)


@pytest.mark.slow
def test_programs_whose_clock_runs_elsewhere_read_and_command(lab: Lab) -> None:
    """As on another computer, whose monotonic clock has another start."""
    away = ["unshare", "--time", "--monotonic", "100000", "--boottime", "100000"]
    other = lab.client(where=away, extra={"FLEET_SHIFT": "100000"})
    assert other.do("facts")["offset"] == pytest.approx(-100_000, abs=0.1)
    other.do("watch")
    lab.operator.do("release")
    begin = time.monotonic()
    other.do("stream", 20.0, J1=0.3)
    eventually(
        lambda: [r for r in lab.rows() if r["e"] == "answered" and not r["refused"] and r["t"] > begin + 0.5]
    )
    other.do("rest")
    assert not lab.refused(begin)
    other.do("close")
    other.end()


@pytest.mark.slow
def test_a_wall_clock_that_jumps_moves_nothing_and_loses_no_lease(lab: Lab) -> None:
    library, offset = lab.folder / "wall_clock.so", lab.folder / "offset"
    subprocess.run(["gcc", "-shared", "-fPIC", "-O", "-o", library, WALL_CLOCK], check=True, timeout=PATIENCE)
    offset.write_bytes(struct.pack("=q", 0))
    lab.server.end()
    lab.server = lab.serve(extra={"LD_PRELOAD": str(library), "WALL_CLOCK": str(offset)})
    lab.begin_all()
    lab.operator.do("stream", 20.0, J1=0.3)
    begin = time.monotonic()
    for by in (-86400, 86400, 0):
        with offset.open("r+b") as file:
            file.write(struct.pack("=q", by))
        eventually(lambda by=by: abs(lab.reader.do("wall") - time.time() - by) < 100)
        jumped = time.monotonic()
        eventually(lambda jumped=jumped: len(lab.states(jumped)) > 20)
    lab.operator.do("rest")
    assert not lab.refused(begin)
    assert not lab.lost(begin)
    lab.server.end()


@pytest.mark.slow
def test_an_owner_whose_computer_was_restarted_is_read_again(lab: Lab) -> None:
    """Its monotonic clock begins anew, so its stamps are lower than those before."""
    lab.server.kill()
    # No clock may begin before 0, so not by more than this computer has been running.
    back = f"-{max(1, min(1000, int(time.monotonic()) // 2))}"
    lab.server = lab.serve(where=["unshare", "--time", "--monotonic", back, "--boottime", back])
    started = time.monotonic()
    eventually(lambda: lab.last()["t"] > started)
    lab.begin_all()
    lab.setting_out()
    lab.operator.do("stop")
    lab.server.end()
