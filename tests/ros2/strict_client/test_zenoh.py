"""What Zenoh itself shows of the node: how samples travel, what its caches answer, who else may ask."""

from __future__ import annotations

import time
from typing import Any

import pytest
import zenoh
from tests.ros2.strict_client.action import goal, point
from tests.ros2.strict_client.wire import ROSOUT, Attachment, Participant
from tests.ros2.strict_client.world import CONTROLLER, NODE, Arm
from tests.waits import until

pytestmark = pytest.mark.system

TRIGGER = "std_srvs/srv/Trigger"


def samples(arm: Arm, topic: str) -> list[zenoh.Sample]:
    """The next samples of a topic, for a subscriber without a token."""
    found: list[zenoh.Sample] = []
    subscriber = arm.me.session.declare_subscriber(arm.me.graph.one(kind="MP", topic=topic).key, found.append)
    until(lambda: len(found) > 2, f"samples of {topic}")
    subscriber.undeclare()
    return found


def test_samples_travel_as_those_of_rmw_zenoh(arm: Arm) -> None:
    """rmw_publisher_data.cpp: dropped where there is no room, usual priority, the session's time, no encoding."""
    topics = ("/joint_states", "/diagnostics", f"{CONTROLLER}/controller_state")
    for sample in (sample for topic in topics for sample in samples(arm, topic)):
        assert sample.congestion_control == zenoh.CongestionControl.DROP
        assert sample.priority == zenoh.Priority.DATA
        assert not sample.express
        assert sample.timestamp is not None
        assert sample.encoding == zenoh.Encoding.ZENOH_BYTES
        assert sample.kind == zenoh.SampleKind.PUT
        assert bytes(sample.payload)[:4] == b"\0\1\0\0"


@pytest.mark.parametrize("more", ["", "?_max=1"])
def test_a_cache_answers_whoever_asks_it(arm: Arm, more: str) -> None:
    """As an AdvancedSubscriber asks: `@adv` after the key of the topic; the answer has the key of the topic."""
    token = arm.me.graph.one(kind="MP", topic="/robot_description")

    def asked() -> list[zenoh.Sample] | None:
        replies = arm.me.session.get(
            f"{token.key}/@adv/**{more}",
            consolidation=zenoh.ConsolidationMode.NONE,
            accept_replies=zenoh.ReplyKeyExpr.ANY,
        )
        return [reply.ok for reply in replies if reply.ok is not None] or None

    (sample,) = until(asked, "the cache answers")
    assert str(sample.key_expr) == token.key
    attachment = Attachment.of(sample.attachment)
    assert (attachment.sequence, attachment.gid) == (1, token.gid)
    assert arm.me.cdr.parse("std_msgs/msg/String", bytes(sample.payload)).data.startswith("<?xml")


@pytest.mark.slow
def test_only_latched_topics_can_be_found_as_such(arm: Arm) -> None:
    """With publisher_detection, a late subscriber's query finds the publisher by a token of Zenoh's own."""
    seen: dict[str, None] = {}
    watch = arm.me.session.liveliness().declare_subscriber(
        "0/**/@adv/pub/**", lambda sample: seen.setdefault(str(sample.key_expr)), history=True
    )
    latched = {token.key for token in arm.me.graph.tokens(kind="MP") if token.qos.split(":")[1] == "1"}
    latched = {key for key in latched if any(t.key == key and t.node == NODE[1:] for t in arm.me.graph.tokens())}
    until(lambda: latched <= {key.partition("/@adv/")[0] for key in seen}, "all latched topics are found")
    assert {key.partition("/@adv/")[0] for key in seen} == latched
    watch.undeclare()


@pytest.mark.slow
def test_a_request_has_one_answer_for_every_target(arm: Arm) -> None:
    client = arm.service(f"{NODE}/get_state", "lifecycle_msgs/srv/GetState")
    client.wait()

    def asked(target: str) -> list[Any] | None:
        client.call()
        attachment = Attachment(2**40 + time.time_ns() % 2**32, time.time_ns(), client.token.gid)
        replies = arm.me.session.get(
            client.token.key,
            payload=b"\0\1\0\0\0",
            attachment=attachment.serialize(),
            target=getattr(zenoh.QueryTarget, target),
            consolidation=zenoh.ConsolidationMode.NONE,
        )
        return [reply.ok for reply in replies if reply.ok is not None] or None

    for target in ("BEST_MATCHING", "ALL", "ALL_COMPLETE"):
        (answer,) = until(lambda target=target: asked(target), f"there is an answer for {target}")  # type: ignore[misc]  # bound at once
        assert str(answer.key_expr) == client.token.key, target


@pytest.mark.slow
def test_a_fresh_session_is_answered_if_it_asks_again(arm: Arm) -> None:
    """Zenoh may lose the first request of a session; the node must not mind the second one."""
    with Participant(arm.port, "fresh") as me:
        client = me.client(f"{NODE}/reset", TRIGGER)

        def asked() -> bool:
            replies = client.send().raw()
            return len([reply for reply in replies if reply.ok is not None]) == 1

        until(asked, "there is one answer")


@pytest.mark.slow
def test_a_log_message_says_where_it_was_written(arm: Arm) -> None:
    log = arm.me.subscribe("/rosout", "rcl_interfaces/msg/Log", ROSOUT)
    # Those from before are kept for ten seconds only.
    arm.send(goal(["nobody"], [point([0.0], 1.0)])).reply.message()
    message = log.wait(lambda each: "nobody" in each.msg).message
    assert message.level == 30
    assert message.name == NODE[1:]
    assert message.file.endswith(".py")
    assert message.function
    assert message.line > 0
    assert 0 <= time.time() - message.stamp.sec < 3600
