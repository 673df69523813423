"""Messages that no ROS node sends: the node drops them, says so at most, and goes on."""

from __future__ import annotations

import struct

import pytest
from tests.ros2.strict_client.cdr import HEADER
from tests.ros2.strict_client.definitions import HASHES
from tests.ros2.strict_client.wire import Attachment
from tests.ros2.strict_client.world import ACTION, CONTROLLER, NODE, Arm

pytestmark = pytest.mark.system

TRAJECTORY = "trajectory_msgs/msg/JointTrajectory"
HUGE = b"\xff\xff\xff\x7f"
WRONG = {
    "nothing": b"",
    "header only": HEADER,
    "half a header": b"\0\1",
    "unknown representation": b"\x7f\x7f\0\0" + bytes(40),
    "huge string": HEADER + bytes(8) + HUGE + b"abc",
    "huge sequence": HEADER + bytes(8) + struct.pack("<I", 1) + b"\0\0\0\0" + HUGE,
    "all ones": HEADER + b"\xff" * 64,
    "not a text": HEADER + bytes(8) + struct.pack("<I", 3) + b"\xff\xfe\0" + bytes(16),
}


def works(arm: Arm) -> None:
    arm.node.check()
    assert arm.trigger("reset").success
    arm.joint_states.take_all()
    arm.joint_states.take()


def test_a_topic(arm: Arm) -> None:
    publisher = arm.me.publisher(f"{CONTROLLER}/joint_trajectory", TRAJECTORY)
    publisher.wait_for_subscriber()
    before = arm.positions()
    for payload in (*WRONG.values(), b"\0\0\0\0" + struct.pack(">iIIxxxx", 0, 0, 1)):
        publisher.put(payload)
    works(arm)
    assert arm.positions() == pytest.approx(before, abs=0.03)


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        (f"{NODE}/set_parameters", "rcl_interfaces/srv/SetParameters"),
        (f"{ACTION}/_action/send_goal", "control_msgs/action/FollowJointTrajectory_SendGoal"),
    ],
    ids=["service", "goal"],
)
def test_a_service(arm: Arm, name: str, kind: str) -> None:
    client = arm.me.client(name, kind)
    client.wait()
    for case, payload in {**WRONG, "no payload": None}.items():
        for reply in client.put(payload).raw():
            # No answer, as from rmw_zenoh_cpp, or an error; never a result.
            assert reply.ok is None, case
    works(arm)


def test_a_topic_without_attachment_is_dropped(arm: Arm) -> None:
    """rmw_zenoh_cpp drops a sample whose attachment it cannot read."""
    publisher = arm.me.publisher(f"{CONTROLLER}/joint_trajectory", TRAJECTORY)
    publisher.wait_for_subscriber()
    before = arm.positions()
    sent = arm.short_goal(0.4, 0.5)["trajectory"]
    publisher.put(arm.me.cdr.serialize(TRAJECTORY, sent), attach=False)
    works(arm)
    assert arm.positions() == pytest.approx(before, abs=0.03)


def test_a_service_with_a_wrong_attachment_is_not_answered(arm: Arm) -> None:
    client = arm.me.client(f"{NODE}/stop", "std_srvs/srv/Trigger")
    client.wait()
    for attachment in (b"", b"x", bytes(33), bytes(32), b"\xff" * 33, bytes(500)):
        asked = client.put(HEADER + b"\0", attachment=attachment)
        assert all(reply.ok is None for reply in asked.raw()), attachment
    assert all(reply.ok is None for reply in client.put(HEADER + b"\0", attach=False).raw())
    works(arm)


def test_a_negative_sequence_number(arm: Arm) -> None:
    client = arm.me.client(f"{NODE}/get_state", "lifecycle_msgs/srv/GetState")
    client.wait()
    attachment = Attachment(-5, 1, client.token.gid).serialize()
    client.put(HEADER + b"\0", attachment=attachment).raw()
    works(arm)


def test_a_service_of_another_hash_is_not_there(arm: Arm) -> None:
    wrong = HASHES["std_srvs/srv/SetBool"]
    client = arm.me.client(f"{NODE}/stop", "std_srvs/srv/Trigger", hash=wrong)
    assert not client.there
    assert client.put(HEADER + b"\0").raw() == []
    works(arm)
