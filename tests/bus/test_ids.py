from __future__ import annotations

import pytest

from hexwire.bus.ids import parse_ids
from hexwire.errors import UsageError


@pytest.mark.parametrize(
    ("text", "ids"),
    [
        ("1-3,9, 12", [1, 2, 3, 9, 12]),
        (" 7 , 2-3,7", [7, 2, 3, 7]),
        ("253", [253]),
        ("0-253", list(range(254))),
    ],
)
def test_ids(text: str, ids: list[int]) -> None:
    assert parse_ids(text) == ids


@pytest.mark.parametrize(
    "text",
    ["", "x", "1-", "-3", "5-2", "254", "1,,2", "1;2", "1-2-3", "٣", "99999999999", "9" * 5000, "1," * 600 + "1"],
)
def test_what_is_not_a_list_of_ids_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="servo ids"):
        parse_ids(text)


def test_what_is_wrong_with_an_id_or_their_order_is_said() -> None:
    with pytest.raises(UsageError, match="'6-1' is not a list of servo ids: write the lower id first"):
        parse_ids("6-1")
    with pytest.raises(UsageError, match="'250-254' is not a list of servo ids: they are from 0 to 253"):
        parse_ids("1,250-254")
