from __future__ import annotations

import pytest

from hexwire.errors import UsageError
from hexwire.studio.servos.search import parse_ids


@pytest.mark.parametrize(
    ("text", "ids"), [("0-3", [0, 1, 2, 3]), (" 7 , 2-3,7", [7, 2, 3]), ("253", [253]), ("0-253", list(range(254)))]
)
def test_ids(text: str, ids: list[int]) -> None:
    assert parse_ids(text) == ids


@pytest.mark.parametrize(
    "text", ["", "a", "1-", "-1", "254", "3-1", "1;2", "٣", "1," * 200, "99999999999", "1-2-3"]
)
def test_what_is_no_list_of_ids(text: str) -> None:
    with pytest.raises(UsageError):
        parse_ids(text)
