"""Names of shared arms, and the keys under which they are offered."""

from __future__ import annotations

import pytest

from hexwire.errors import UsageError
from hexwire.fleet.names import ClientRole, Keys, check_name, check_pattern, is_name, matches, name_of


@pytest.mark.parametrize("name", ["arm", "lab/arm1", "a/b/c/d", "SO-101_2.left"])
def test_a_name_and_its_token_lead_to_each_other(name: str) -> None:
    assert name_of(Keys(check_name(name)).token("17")) == (name, "17")


@pytest.mark.parametrize(
    "name", ["", "/", "lab/", "/arm", "lab//arm", "a/b/c/d/e", "*", "arm one", "-x", "ä", "a" * 33]
)
def test_what_is_not_a_name_is_refused(name: str) -> None:
    with pytest.raises(UsageError, match="name of an arm"):
        check_name(name)


def test_a_pattern_may_have_stars_for_whole_parts_only() -> None:
    assert check_pattern("lab/*") == "lab/*"
    assert check_pattern("**") == "**"
    with pytest.raises(UsageError):
        check_pattern("lab/arm*")


@pytest.mark.parametrize("key", ["hexwire", "hexwire/arm/state", "other/arm/alive/1", "hexwire//alive/1"])
def test_the_key_of_something_else_has_no_name(key: str) -> None:
    with pytest.raises(UsageError):
        name_of(key)


def test_the_key_of_an_order_names_the_role_so_that_rights_can_be_given_by_key() -> None:
    keys = Keys("lab/arm1")
    assert keys.order(ClientRole.OPERATOR) == "hexwire/lab/arm1/as/operator/order"
    assert keys.lease(ClientRole.MAINTAINER) == "hexwire/lab/arm1/as/maintainer/lease"
    assert keys.off(ClientRole.OPERATOR) == "hexwire/lab/arm1/as/operator/off"


@pytest.mark.parametrize(
    ("pattern", "name", "fits"),
    [
        ("lab/arm1", "lab/arm1", True),
        ("lab/*", "lab/arm1", True),
        ("lab/*", "lab/a/b", False),
        ("lab/*", "hall/arm1", False),
        ("*", "lab/arm1", False),
        ("**", "lab/arm1", True),
        ("**", "arm", True),
        ("lab/**", "lab/a/b", True),
        ("lab/**", "lab", True),
        ("**/arm1", "lab/arm1", True),
        ("**/arm1", "arm1", True),
        ("*/**/arm1", "lab/a/arm1", True),
        ("lab/arm1", "lab", False),
        ("lab", "lab/arm1", False),
    ],
)
def test_a_pattern_matches_whole_parts(pattern: str, name: str, fits: bool) -> None:
    assert check_pattern(pattern) == pattern
    assert matches(pattern, name) == fits
    assert is_name(name)
    assert is_name(pattern) == ("*" not in pattern)
