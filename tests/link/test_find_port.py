from __future__ import annotations

from hexwire.link.ports import PortFinder, PortInfo

A, B, C = (PortInfo(f"/dev/ttyACM{i}") for i in range(3))


def test_a_port_that_goes_and_comes_back() -> None:
    finder = PortFinder([A, B])
    assert finder.asks.startswith("unplug the USB cable")
    finder.receive([A, B], 0.0)
    finder.receive([A], 1.0)
    assert finder.gone == (B,)
    assert finder.asks == "/dev/ttyACM1 is gone: plug it in again"
    finder.receive([A], 5.0)
    assert not finder.over
    finder.receive([A, B], 6.0)
    assert not finder.over
    finder.receive([A, B], 6.5)
    assert finder.over
    assert finder.found == (B,)
    assert finder.asks == ""


def test_it_may_come_back_under_another_name() -> None:
    finder = PortFinder([A, B])
    finder.receive([B], 1.0)
    finder.receive([B, C], 2.0)
    finder.receive([B, C], 2.6)
    assert finder.found == (C,)
    assert finder.gone == (A,)


def test_a_port_that_is_plugged_in_for_the_first_time() -> None:
    finder = PortFinder([])
    finder.receive([A], 3.0)
    finder.receive([A], 3.6)
    assert finder.found == (A,)


def test_a_device_with_two_ports_is_waited_for() -> None:
    finder = PortFinder([A])
    finder.receive([A, B], 1.0)
    finder.receive([A, B, C], 1.4)
    finder.receive([A, B, C], 1.6)
    assert not finder.over
    finder.receive([A, B, C], 1.9)
    assert finder.found == (B, C)


def test_a_loose_contact_is_no_port() -> None:
    finder = PortFinder([A])
    for i in range(10):
        finder.receive([A, B] if i % 2 else [A], 0.2 * i)
    assert not finder.over
