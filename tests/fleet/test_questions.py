"""Questions to the server of an arm: why there is no answer."""

from __future__ import annotations

import pytest

from hexwire.errors import (
    HexwireError,
    LeaseError,
    LinkLostError,
    LinkNotFoundError,
    LinkPermissionError,
    RemoteProtocolError,
    ReplyTimeoutError,
)
from hexwire.fleet import messages as m
from hexwire.fleet.address import Address
from hexwire.fleet.names import Keys, Role
from hexwire.fleet.network import NoAnswerError
from hexwire.fleet.questions import ask, decoded

ADDRESS, KEYS = Address("lab/arm1"), Keys("lab/arm1")
ORDER = KEYS.order(Role.OPERATOR)


class Node:
    """A session in which some keys are answered, and others are not."""

    def __init__(self, **answers: bytes) -> None:
        self.answers = {
            ORDER if name == "order" else getattr(KEYS, name): payload for name, payload in answers.items()
        }
        self.connections, self.absent, self.tokens = 1, True, ["hexwire/lab/arm1/alive/1"]

    def visible(self, key: str, timeout: float) -> list[str]:
        return self.tokens

    def ask(self, key: str, payload: bytes, timeout: float, *, urgent: bool = False) -> bytes:
        if key in self.answers:
            return self.answers[key]
        raise NoAnswerError(absent=self.absent)


def asked(node: Node, key: str = ORDER) -> m.Answer:
    return ask(node, ADDRESS, key, m.Ask("clock"), 1.0)  # type: ignore[arg-type]


def test_an_answer_is_returned_and_a_refusal_raised() -> None:
    assert asked(Node(order=m.encode(m.Answer("", value=5)))).value == 5
    with pytest.raises(LeaseError, match="Ann holds the lease"):
        asked(Node(order=m.encode(m.Answer("LeaseError", "Ann holds the lease", {"holder": "Ann"}))))


CLOCK = m.encode(m.Answer(""))


@pytest.mark.parametrize(
    ("answers", "change", "key", "error", "words"),
    [
        ({}, {"connections": 0}, ORDER, LinkLostError, "connection to the server or router is lost"),
        ({}, {"tokens": []}, ORDER, LinkNotFoundError, "no arm lab/arm1"),
        ({"ask": CLOCK}, {}, ORDER, LinkPermissionError, r"not this \(as/operator/order\)"),
        ({"ask": CLOCK}, {"absent": False}, KEYS.stop, LinkPermissionError, r"not this \(stop\)"),
        ({}, {}, KEYS.ask, LinkPermissionError, "does not allow this"),
        ({}, {"absent": False}, KEYS.ask, ReplyTimeoutError, "lab/arm1"),
    ],
)
def test_no_such_arm_no_right_and_no_answer_are_told_apart(
    answers: dict[str, bytes], change: dict[str, object], key: str, error: type[HexwireError], words: str
) -> None:
    node = Node(**answers)
    vars(node).update(change)
    with pytest.raises(error, match=words):
        asked(node, key)


@pytest.mark.parametrize("payload", [b"", b"\x02\x91", b"\x01\xff", b"\x01" + b"\x91" * 5000])
def test_an_answer_that_is_none_is_one_error(payload: bytes) -> None:
    with pytest.raises(RemoteProtocolError):
        asked(Node(order=payload))


@pytest.mark.parametrize("value", [None, 5, "x", [1], {"robot": 3}, ["hex7bot"] * 11])
def test_a_value_of_another_kind_is_one_error(value: object) -> None:
    with pytest.raises(RemoteProtocolError, match="not a valid answer"):
        decoded(m.Answer("", value=value), m.Facts)
