"""A servo bus without an arm: an emulated SO-101 in real time."""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Iterator
from typing import Any

import pytest
from tests.studio.running import PATIENCE, until

from hexwire.bus.live_values import LiveValues
from hexwire.bus.setup import scan
from hexwire.emulator.servo import EmulatedServo
from hexwire.errors import DeviceError, HexwireError, LeaseError, ServoError, UsageError
from hexwire.setup.servo_bench import Job
from hexwire.studio.access import Right
from hexwire.studio.bus_source import BusSource, live_row
from hexwire.studio.source import Source
from hexwire.studio.tabs import Tab, Tabs

IDS = range(1, 7)


@pytest.fixture
def source() -> Iterator[Source]:
    made = Source()
    made.silence = 5.0
    try:
        yield made
    finally:
        made.close()


@pytest.fixture
def bus(source: Source) -> BusSource:
    made = source.open_bus("sim://so101?name=bus_source")
    made.search((), range(1, 8))
    return made


@pytest.fixture
def tab(source: Source, bus: BusSource) -> Tab:
    made = Tabs().open("session", Right.OPERATE)
    source.take(made)
    return made


def servos(bus: BusSource) -> dict[int, EmulatedServo]:
    link: Any = bus.bus.link
    return {servo.servo_id: servo for servo in link.device.wire.servos}


def test_a_servo_whose_answer_was_late_is_asked_again(bus: BusSource, monkeypatch: pytest.MonkeyPatch) -> None:
    looks: list[int] = []

    def late(*args: Any, **named: Any) -> Any:
        looks.append(1)
        return scan(*args, **named)[2 if len(looks) == 1 else 0 :]

    monkeypatch.setattr("hexwire.studio.bus_source.scan", late)
    bus.search((), range(1, 8))
    assert [row.found.servo_id for row in bus.servos] == list(IDS)


def test_a_search_finds_the_servos_and_their_values_come(source: Source, bus: BusSource) -> None:
    assert source.mode == "bus"
    assert [row.found.servo_id for row in bus.servos] == list(IDS)
    assert bus.bench.servo_ids == tuple(IDS)
    until(lambda: len(bus.live) == 6 and len(bus.torque) == 6, "live values")
    assert all(row.voltage > 6.0 for row in bus.live.values())
    facts = bus.facts()
    assert (facts["connected"], facts["torque"], facts["faults"], facts["baud"]) == (True, "off", [], 1_000_000)
    json.dumps(facts, allow_nan=False)
    assert bus.find(3) is not None
    assert bus.find(9) is None


def test_a_search_at_all_rates_and_work_at_another_rate(bus: BusSource) -> None:
    servo = servos(bus)[6]
    servo.registers.put_stored("baud_code", 4)
    found = bus.search((1_000_000, 115_200), range(1, 8))
    assert [(row.found.servo_id, row.found.baud) for row in found][-1] == (6, 115_200)
    assert bus.bench.servo_ids == (1, 2, 3, 4, 5)
    bus.use_rate(115_200)
    assert bus.bench.servo_ids == (6,)
    until(lambda: set(bus.live) == {6} and not bus.live[6].error, "values at that rate")


@pytest.mark.parametrize("elsewhere", [(), (1,), (6,)])
def test_a_search_keeps_the_rate_at_which_there_are_servos(bus: BusSource, elsewhere: tuple[int, ...]) -> None:
    for servo_id in elsewhere:
        servos(bus)[servo_id].registers.put_stored("baud_code", 4)
    # Those at the other rate are found first.
    bus.search((115_200, 1_000_000), range(1, 7))
    assert bus.bus.timing.baud == 1_000_000
    assert set(bus.bench.servo_ids) == set(IDS) - set(elsewhere)


def test_a_search_goes_to_the_rate_of_servos_that_are_all_elsewhere(bus: BusSource) -> None:
    for servo in servos(bus).values():
        servo.registers.put_stored("baud_code", 4)
    bus.search((1_000_000, 115_200), range(1, 7))
    assert bus.bus.timing.baud == 115_200
    assert bus.bench.servo_ids == tuple(IDS)


def test_a_search_that_finds_nothing_keeps_the_rate(bus: BusSource) -> None:
    assert bus.search((115_200,), (9,)) == []
    assert bus.bus.timing.baud == 1_000_000


def test_a_search_counts_all_that_it_has_found(bus: BusSource, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []
    monkeypatch.setattr(Job, "tell", lambda _self, text, _share=None: told.append(text))
    bus.search((), range(1, 9))
    counts = [int(text.split(", ")[2].split()[0]) for text in told if text.endswith("found")]
    # Silent ids are asked once more: what was found before that counts on.
    assert counts == sorted(counts)
    assert counts[-1] == len(IDS)


def test_a_search_that_is_cancelled_keeps_what_was_known(bus: BusSource) -> None:
    ended: list[str] = []

    def search() -> None:
        try:
            bus.search((), range(254))
        except DeviceError as error:
            ended.append(str(error))

    searching = threading.Thread(target=search)
    searching.start()
    until(lambda: bus.job is not None and bus.job.told, "the search")
    bus.bench.cancel()
    searching.join(30)
    assert ended == ["a search has ended: cancelled"]
    assert bus.bench.servo_ids == tuple(IDS)
    assert bus.job is None


def test_control_is_one_tabs(source: Source, bus: BusSource, tab: Tab) -> None:
    other = Tabs().open("session", Right.OPERATE)
    assert source.has_control(tab)
    with pytest.raises(LeaseError):
        source.take(other)
    source.take(other, force=True)
    with pytest.raises(LeaseError):
        source.need_control(tab)
    source.leave(other)
    assert bus.holder is None
    assert other.grant == 0


def test_torque_and_a_stop_reach_the_servos(bus: BusSource) -> None:
    bus.switch_torque(True)
    assert all(servo.torque_on for servo in servos(bus).values())
    before = bus.stops
    until(lambda: bus.torques().holding == tuple(map(str, IDS)), "torque as it was read")
    assert bus.stop("tab 1 stopped it").torques.holding == tuple(map(str, IDS))
    assert (bus.bench.stopped, bus.facts()["stopped"]) == (True, "tab 1 stopped it")
    assert bus.stops > before
    with pytest.raises(HexwireError):
        bus.switch_torque(True)
    bus.switch_torque(False, (3,))
    assert not servos(bus)[3].torque_on
    bus.resume()
    assert bus.facts()["stopped"] == ""
    link: Any = bus.bus.link
    link.device.wire.servos = [servo for servo in link.device.wire.servos if servo.servo_id != 2]
    done = bus.stop("again")
    assert (done.confirmed, done.error) == (False, "not confirmed by servo 2")
    assert "2" in done.torques.unknown


def test_a_stop_that_comes_after_a_resume_was_asked_for_stays(bus: BusSource) -> None:
    bus.stop("tab 1 stopped it")
    asked = bus.mark()
    bus.stop("tab 2 stopped it")
    with pytest.raises(HexwireError, match="stopped again"):
        bus.resume(asked)
    assert bus.facts()["stopped"] == "tab 2 stopped it"
    bus.resume(bus.mark())
    assert bus.facts()["stopped"] == ""


def test_a_line_that_is_lost_is_opened_again(bus: BusSource, monkeypatch: pytest.MonkeyPatch) -> None:
    until(lambda: bus.live, "live values")
    plugged, reopen = threading.Event(), bus.bus.open
    monkeypatch.setattr(bus.bus, "open", lambda: plugged.wait(PATIENCE) and reopen())
    bus.bus.link.close()
    until(lambda: bus.error, "the loss is seen")
    assert bus.facts()["connected"] is False
    bus.live = {}
    plugged.set()
    until(lambda: bus.live and not bus.error, "values after the return")
    assert bus.bus.link.is_open


def test_a_servo_with_another_id_is_followed(bus: BusSource) -> None:
    servos(bus)[6].registers.put_stored("id", 20)
    row = bus.look_again(20, former=6)
    assert row.found.servo_id == 20
    assert bus.bench.servo_ids == (1, 2, 3, 4, 5, 20)
    with pytest.raises(ServoError, match="servo 6 does not answer"):
        bus.look_again(6)


def test_the_bus_of_an_arm_is_the_same_bus(source: Source) -> None:
    arm = source.open("sim://so101?name=same_bus")
    driver: Any = arm.driver
    device = driver.bus.link.device
    bus = source.open_bus()
    link: Any = bus.bus.link
    assert link.device is device
    assert source.arm is None
    board = source.open("sim://hex7bot?name=has_board")
    with pytest.raises(UsageError, match="has a board"):
        source.open_bus()
    assert source.arm is board, "refused before it is closed"


def test_values_for_a_page_are_json() -> None:
    nan = math.nan
    row = live_row(LiveValues(3, None, nan, nan, nan, nan, nan, nan, 4, "no answer"))
    assert (row["deg"], row["volts"], row["faults"], row["error"]) == (None, None, ["temperature"], "no answer")
    row = live_row(LiveValues(3, 2048, math.pi, 0.0, 0.5, 7.4, 30.0, 0.1))
    assert (row["deg"], row["load"], row["volts"]) == (180.0, 50.0, 7.4)
    json.dumps(row, allow_nan=False)
