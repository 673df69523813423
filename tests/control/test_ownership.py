"""One owner for each robot of a program."""

from __future__ import annotations

import gc
from typing import Any, cast

import pytest

from hexwire.control.loop.owner import claim, release
from hexwire.errors import UsageError


class Owner:
    pass


def owner() -> Any:
    return cast("Any", Owner())


def test_a_robot_has_one_owner_until_that_releases_it() -> None:
    robot, first, second = cast("Any", object()), owner(), owner()
    claim(robot, first)
    claim(robot, first)
    with pytest.raises(UsageError, match="already in motion"):
        claim(robot, second)
    release(robot, second)
    with pytest.raises(UsageError, match="already in motion"):
        claim(robot, second)
    claim(cast("Any", object()), second)
    release(robot, first)
    claim(robot, second)


def test_an_owner_that_is_gone_holds_nothing() -> None:
    robot, first = cast("Any", object()), owner()
    claim(robot, first)
    del first
    gc.collect()
    claim(robot, owner())
