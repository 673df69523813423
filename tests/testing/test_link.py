"""The suite for links finds a link that breaks its contract. Each kind of link has its own test with the suite."""

from __future__ import annotations

import threading
from pathlib import Path

import pytest

from hexwire.errors import LinkClosedError
from hexwire.link.memory import memory_pair
from hexwire.testing import LinkConformance
from hexwire.testing.link import Background, descriptors, read_bytes, refused


class Memory(LinkConformance):
    def make_pair(self, tmp_path: Path):
        return memory_pair()


@pytest.fixture
def ends():
    near, far = memory_pair()
    far.open()
    near.open()
    yield near, far
    near.close()
    far.close()


def test_a_link_that_changes_a_byte_is_found(ends, monkeypatch: pytest.MonkeyPatch) -> None:
    near, _ = ends
    Memory().test_every_byte_value_passes_both_ways(ends)
    write = near.write
    monkeypatch.setattr(near, "write", lambda data, deadline=None: write(data.replace(b"\x0d", b"\x0a"), deadline))
    with pytest.raises(AssertionError):
        Memory().test_every_byte_value_passes_both_ways(ends)


def test_a_read_that_ends_early_is_found(ends, monkeypatch: pytest.MonkeyPatch) -> None:
    near, _ = ends
    monkeypatch.setattr(near, "read", lambda deadline: b"")
    with pytest.raises(AssertionError):
        Memory().test_a_read_does_not_end_before_its_deadline(ends)


def test_the_suite_of_a_link_needs_its_pair(tmp_path: Path) -> None:
    with pytest.raises(NotImplementedError):
        LinkConformance().make_pair(tmp_path)


def test_a_call_in_the_background_gives_its_result_or_its_error() -> None:
    assert Background(lambda: 7).outcome() == 7
    with pytest.raises(ZeroDivisionError):
        Background(lambda: 1 // 0).outcome()
    released = threading.Event()
    waiting = Background(released.wait)
    waiting.let_it_block()
    released.set()
    assert waiting.outcome() is True


def test_the_helpers(ends) -> None:
    near, far = ends
    far.write(b"ab")
    far.write(b"c")
    assert read_bytes(near, 3) == b"abc"
    near.close()
    with refused(LinkClosedError, near):
        near.read(0.0)
    before = descriptors()
    with Path(__file__).open():
        assert descriptors() == before + 1
