from __future__ import annotations

import math
from typing import Any

import yaml
from hypothesis import given
from hypothesis import strategies as st

from hexwire.ros2.package.yaml_text import yaml_text

texts = st.text(st.characters(codec="utf-8", exclude_categories=["Cs"]), max_size=12)
plain = (
    texts
    | st.integers(-(10**12), 10**12)
    | st.floats(allow_nan=False)
    | st.booleans()
    | st.sampled_from(["yes", "No", "null", "~", "1e3", ".5", "0x1", "12:30:00", "-", "a: b", "# x", "", "=", "<<"])
)
values = st.recursive(
    plain | st.lists(plain, max_size=3), lambda inner: st.dictionaries(texts, inner, max_size=3), max_leaves=8
)


@given(st.dictionaries(texts, values, min_size=1, max_size=4))
def test_a_reader_of_yaml_gets_the_same_table(table: dict[str, Any]) -> None:
    assert yaml.safe_load(yaml_text(table)) == table


def test_numbers_that_are_none() -> None:
    read = yaml.safe_load(yaml_text({"a": math.nan, "b": math.inf, "c": -math.inf, "d": -0.0, "e": 1e-7}))
    assert math.isnan(read["a"])
    assert (read["b"], read["c"], read["e"]) == (math.inf, -math.inf, 1e-7)
    assert math.copysign(1.0, read["d"]) == 1.0


def test_form() -> None:
    table = {"/**": {"a_b": [1, 2.5, "x y"], "empty": {}, "on": True}}
    expected = '# one\n# two\n"/**":\n  a_b: [1, 2.5, "x y"]\n  empty: {}\n  "on": true\n'
    assert yaml_text(table, head=("one", "two")) == expected
