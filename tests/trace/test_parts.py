from __future__ import annotations

import json

from hypothesis import given
from hypothesis import strategies as st

from hexwire.trace.explain import Part, filled

TREE = Part(
    "frame",
    0,
    4,
    "all",
    parts=(Part("a", 0, 1, value=7), Part("b", 1, 4, parts=(Part("c", 1, 3), Part("d", 3, 4)))),
)


def test_a_byte_has_a_path_of_parts_and_one_field() -> None:
    assert [[part.name for part in TREE.path(i)] for i in range(5)] == [
        ["frame", "a"],
        ["frame", "b", "c"],
        ["frame", "b", "c"],
        ["frame", "b", "d"],
        [],
    ]
    assert TREE.path(-1) == ()


def test_rows_and_leaves_come_in_the_order_of_their_bytes() -> None:
    assert [(depth, part.name) for depth, part in TREE.rows()] == [
        (0, "frame"),
        (1, "a"),
        (1, "b"),
        (2, "c"),
        (2, "d"),
    ]
    assert [part.name for part in TREE.leaves()] == ["a", "c", "d"]


def test_as_fields_leaves_out_what_is_empty() -> None:
    fields = TREE.as_fields()
    assert json.loads(json.dumps(fields))["parts"][0] == {"name": "a", "start": 0, "end": 1, "value": 7}
    assert "meaning" not in fields


@given(
    st.lists(st.tuples(st.integers(-5, 30), st.integers(-5, 30)), max_size=8),
    st.integers(0, 10),
    st.integers(0, 20),
)
def test_a_range_is_covered_once_whatever_parts_are_given(
    places: list[tuple[int, int]], start: int, size: int
) -> None:
    parts = filled([Part("x", a, b) for a, b in places], start, start + size)
    edges = [start, *(part.end for part in parts)]
    assert [part.start for part in parts] == edges[:-1]
    assert edges[-1] == start + size
    assert all(part.start < part.end for part in parts)
