from __future__ import annotations

from pathlib import Path

import pytest
from tests.packages import install

from hexwire.errors import LinkNotFoundError, UsageError
from hexwire.link.open import ENTRY_POINT_GROUP, known_schemes, make_link, open_link

RADIO = """
from hexwire.link.memory import memory_pair


def make_memory(url):
    url.check_keys(("capacity",))
    return memory_pair(capacity=url.integer("capacity", 4096, 1, 1 << 20))[0]
"""


@pytest.fixture
def other_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package with a scheme of its own."""
    monkeypatch.syspath_prepend(tmp_path)
    install(
        tmp_path, "radio", {ENTRY_POINT_GROUP: {"radio": "hexwire_radio:make_memory"}}, {"hexwire_radio.py": RADIO}
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
