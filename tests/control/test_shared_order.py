"""An order to a shared arm: what proves that it may be done."""

from __future__ import annotations

import pytest

from hexwire.control.shared_order import Order
from hexwire.epochs import Epochs


def test_an_order_carries_what_its_checks_need_and_nothing_else() -> None:
    token = Epochs().mark()
    order = Order(17, 3, token, 12.5, 0.001)
    assert (order.key, order.sequence, order.arrived, order.made, order.doubt) == (17, 3, token, 12.5, 0.001)
    # One that may wait has no time.
    assert Order(17, 4, token).made is None
    with pytest.raises(AttributeError):
        order.note = "x"  # type: ignore[attr-defined]  # that is what the test is about
