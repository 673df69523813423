from __future__ import annotations

import pytest
from tests.property.servo_pty import read_for


@pytest.mark.slow
@pytest.mark.system
def test_no_value_is_wrong_behind_an_echo_on_a_real_terminal() -> None:
    count = read_for(1.5, 1, ["--echo"])
    assert count["wrong"] == 0
    assert count["right"] > 0.5 * count["asked"] > 0
    assert count["echoes"]
