from __future__ import annotations

import importlib.metadata
from importlib.metadata import EntryPoint

import pytest

from hexwire.errors import LinkNotFoundError, UsageError
from hexwire.link.base import Link
from hexwire.link.memory import memory_pair
from hexwire.link.open import ENTRY_POINT_GROUP, known_schemes, make_link, open_link
from hexwire.link.url import LinkUrl


def make_memory(url: LinkUrl) -> Link:
    """What another package registers for its scheme."""
    url.check_keys(("capacity",))
    return memory_pair(capacity=url.integer("capacity", 4096, 1, 1 << 20))[0]


@pytest.fixture
def other_package(monkeypatch: pytest.MonkeyPatch) -> None:
    point = EntryPoint("radio", f"{__name__}:make_memory", ENTRY_POINT_GROUP)
    monkeypatch.setattr(EntryPoint, "load", lambda self: make_memory)

    monkeypatch.setattr(
        importlib.metadata, "entry_points", lambda group: [point] if group == "hexwire.links" else []
    )


def test_building_opens_nothing() -> None:
    assert not make_link("serial:///dev/does-not-exist").is_open


def test_opening_opens_or_raises() -> None:
    with pytest.raises(LinkNotFoundError):
        open_link("serial:///dev/does-not-exist")


def test_unknown_scheme_names_the_known_ones() -> None:
    with pytest.raises(UsageError, match=r"unknown scheme 'can'; known: .*serial"):
        make_link("can://can0")


@pytest.mark.usefixtures("other_package")
def test_schemes_of_other_packages() -> None:
    assert "radio" in known_schemes()
    link = open_link("radio://1?capacity=8192")
    assert link.is_open
    link.close()
    with pytest.raises(UsageError, match="unknown option 'x'; options of radio://: capacity"):
        make_link("radio://1?x=1")
    with pytest.raises(UsageError, match=r"known: .*radio"):
        make_link("can://can0")
