"""What is open: an emulated arm, its facts, and that a jog needs control."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from hexwire.errors import HexwireError, LeaseError, LinkLostError
from hexwire.studio.access import Right
from hexwire.studio.source import Source
from hexwire.studio.tabs import Tabs


@pytest.fixture
def source() -> Iterator[Source]:
    made = Source()
    try:
        yield made
    finally:
        made.close()


def test_nothing_is_open_at_first(source: Source) -> None:
    assert source.mode == "none"
    with pytest.raises(LinkLostError, match="start page"):
        source.need_arm()


def test_an_arm_is_opened_with_its_facts(source: Source) -> None:
    arm = source.open("sim://hex7bot?name=facts")
    facts = arm.facts()
    assert (source.mode, facts["robot"], facts["connected"], facts["dialect"]) == ("arm", "hex7bot", True, 2)
    assert facts["torque"] == "off"


def test_what_cannot_be_opened_says_why(source: Source) -> None:
    with pytest.raises(HexwireError):
        source.open("/dev/not-there")
    assert source.mode == "none"
    assert "/dev/not-there" in source.error


def test_one_tab_has_control_at_a_time(source: Source) -> None:
    source.open("sim://hex7bot?name=control")
    tabs = Tabs()
    first, second = tabs.open("s", Right.OPERATE), tabs.open("s", Right.OPERATE)
    source.take(first)
    with pytest.raises(LeaseError):
        source.take(second)
    source.take(second, force=True)
    assert source.has_control(second)
    with pytest.raises(LeaseError):
        source.need_control(first)
    source.leave(second)
    assert not source.has_control(second)
