"""Policies are values with the protocol's own numbers."""

from __future__ import annotations

import dataclasses

import pytest

from hexwire.session.policy import ReconnectPolicy, RetryPolicy
from hexwire.wire import tables


def test_windows_are_the_protocols() -> None:
    policy = RetryPolicy()
    assert policy.window == tables.DIALECT2_REPLY_WINDOW
    # The slowest answer of the chapter's sketch took 126.6 ms.
    assert policy.dialect1_window == tables.DIALECT1_REPLY_WINDOW > 0.127
    # And 15.4 ms pass until the last servo of a sync write has its target.
    assert policy.dialect1_holdoff > 0.0154
    assert policy.attempts == 3


def test_a_repeat_always_comes_while_the_board_remembers() -> None:
    policy = RetryPolicy()
    assert policy.attempts * policy.window < tables.REPEAT_WINDOW


@pytest.mark.parametrize("policy", [RetryPolicy(), ReconnectPolicy()])
def test_frozen(policy: RetryPolicy | ReconnectPolicy) -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(policy, dataclasses.fields(policy)[0].name, 1)
