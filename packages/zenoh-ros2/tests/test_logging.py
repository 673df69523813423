from __future__ import annotations

import logging
from collections.abc import Iterator
from typing import Any

import pytest

from zenoh_ros2.logging import LOG, TIME, RosoutHandler
from zenoh_ros2.types import Types


class Published:
    """Loggers whose handler publishes into a list."""

    def __init__(self) -> None:
        types = Types()
        self.messages: list[Any] = []
        self.woken = 0
        pair = types.message(LOG), types.message(TIME)
        self.handler = RosoutHandler("arm.driver", "test_rosout.node", pair, self.messages.append, self.wake)
        self.root = logging.getLogger("test_rosout")
        self.root.addHandler(self.handler)
        self.root.setLevel(logging.DEBUG)

    def wake(self) -> None:
        self.woken += 1


@pytest.fixture
def published() -> Iterator[Published]:
    published = Published()
    yield published
    published.root.removeHandler(published.handler)


def test_a_record_becomes_a_message(published: Published) -> None:
    logging.getLogger("test_rosout.node").warning("joint %s is %.1f", "J1", 0.5)
    assert (published.messages, published.woken) == ([], 1)
    published.handler.flush()
    (message,) = published.messages
    assert (message.level, message.name, message.msg) == (30, "arm.driver", "joint J1 is 0.5")
    assert message.file.endswith("test_logging.py")
    assert (message.function, message.line > 0) == ("test_a_record_becomes_a_message", True)
    assert message.stamp.sec > 1_600_000_000


@pytest.mark.parametrize(
    ("logger", "name"),
    [("node", "arm.driver"), ("node.goals", "arm.driver.goals"), ("other", "arm.driver"), ("nodes", "arm.driver")],
)
def test_the_name_is_that_of_the_nodes_logger(published: Published, logger: str, name: str) -> None:
    logging.getLogger(f"test_rosout.{logger}").info("x")
    published.handler.flush()
    assert [message.name for message in published.messages] == [name]


@pytest.mark.parametrize(("level", "number"), [(10, 10), (20, 20), (50, 50), (5, 5), (1000, 255)])
def test_levels_are_those_of_ros(published: Published, level: int, number: int) -> None:
    published.root.setLevel(1)
    published.root.log(level, "x")
    published.handler.flush()
    assert [message.level for message in published.messages] == [number]


def test_the_text_is_what_it_was_when_it_was_logged(published: Published) -> None:
    values = [1]
    published.root.info("values %s", values)
    values.append(2)
    published.handler.flush()
    assert published.messages[0].msg == "values [1]"


def test_an_exception_has_its_traceback(published: Published) -> None:
    try:
        raise RuntimeError("a fault")
    except RuntimeError:
        published.root.exception("it failed")
    published.handler.flush()
    assert published.messages[0].msg.startswith("it failed\nTraceback")


def test_any_text_can_be_published(published: Published) -> None:
    # Not by a logger: the runner's workers cannot report such a text.
    text = "a\0b\ud800" + "x" * 100_000
    published.handler.handle(logging.LogRecord("test_rosout", logging.INFO, __file__, 1, text, None, None))
    published.handler.flush()
    assert len(Types().message(LOG).serialize(published.messages[0])) < 20_000


def test_the_oldest_of_too_many_records_are_dropped(published: Published) -> None:
    for number in range(1500):
        published.root.info("%d", number)
    published.handler.flush()
    assert [published.messages[0].msg, published.messages[-1].msg] == ["500", "1499"]
