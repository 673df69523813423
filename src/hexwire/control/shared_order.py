"""An order to a shared arm: what proves that it may be done.

Owns the value. Must not know what is ordered, nor the rules.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hexwire.epochs import Token

__all__ = ["Order"]


class Order:
    """Proof that an order may be done: who sends it, and when it was made and arrived.

    Args:
        key: Key of the sender's lease.
        sequence: Number of the order; each is greater than the last.
        arrived: Token of the robot's epochs at its arrival; a later stop cancels the order.
        made: When it was made, seconds of the owner's clock as the sender estimates it; None for an order that does
            not become wrong by waiting.
        doubt: Uncertainty of that, seconds.
    """

    __slots__ = ("arrived", "doubt", "key", "made", "sequence")

    def __init__(
        self, key: int, sequence: int, arrived: Token, made: float | None = None, doubt: float = 0.0
    ) -> None:
        self.key, self.sequence, self.arrived, self.made, self.doubt = key, sequence, arrived, made, doubt
