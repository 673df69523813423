from __future__ import annotations

import pytest
from tests.model.states import make_state

from hexwire.cli.demo import PlainView
from hexwire.cli.draw import CycleSample


def test_the_plain_view_prints_a_line_a_second(capsys: pytest.CaptureFixture[str]) -> None:
    state = make_state(0.1)
    view = PlainView()
    for tenths in range(25):
        view.show(CycleSample(tenths / 10, 3.0, state, (0.0,), 10.0, 0.01, 0))
    assert capsys.readouterr().out.splitlines() == [
        "  0.0 s: J1 5.7 deg, off by at most 5.7",
        "  1.0 s: J1 5.7 deg, off by at most 5.7",
        "  2.0 s: J1 5.7 deg, off by at most 5.7",
    ]
