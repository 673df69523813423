"""Messages that no ROS node sends: the node drops them, says so at most, and goes on."""

from __future__ import annotations

import random
import struct

import pytest
from tests.ros2.strict_client.cdr import HEADER
from tests.ros2.strict_client.definitions import HASHES
from tests.ros2.strict_client.wire import Attachment
from tests.ros2.strict_client.world import ACTION, CONTROLLER, NODE, Arm

pytestmark = pytest.mark.system

FOLLOW = "control_msgs/action/FollowJointTrajectory"
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


@pytest.mark.parametrize("payload", WRONG.values(), ids=WRONG)
def test_a_topic(arm: Arm, payload: bytes) -> None:
    publisher = arm.me.publisher(f"{CONTROLLER}/joint_trajectory", TRAJECTORY)
    publisher.wait_for_subscriber()
    before = arm.positions()
    publisher.put(payload)
    works(arm)
    assert arm.positions() == pytest.approx(before, abs=0.03)


@pytest.mark.parametrize("payload", WRONG.values(), ids=WRONG)
def test_a_service(arm: Arm, payload: bytes) -> None:
    client = arm.me.client(f"{NODE}/set_parameters", "rcl_interfaces/srv/SetParameters")
    client.wait()
    for reply in client.put(payload).raw(15.0):
        # No answer, as from rmw_zenoh_cpp, or an error; never a result.
        assert reply.ok is None
    works(arm)


@pytest.mark.slow
@pytest.mark.parametrize("payload", WRONG.values(), ids=WRONG)
def test_a_goal(arm: Arm, payload: bytes) -> None:
    client = arm.me.client(f"{ACTION}/_action/send_goal", f"{FOLLOW}_SendGoal")
    client.wait()
    for reply in client.put(payload).raw(15.0):
        assert reply.ok is None
    works(arm)


def test_a_service_without_a_payload(arm: Arm) -> None:
    client = arm.me.client(f"{NODE}/set_parameters", "rcl_interfaces/srv/SetParameters")
    client.wait()
    assert all(reply.ok is None for reply in client.put(None).raw(15.0))
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


@pytest.mark.parametrize("attachment", [b"", b"x", bytes(33), bytes(32), b"\xff" * 33, bytes(500)])
def test_a_service_with_a_wrong_attachment_is_not_answered(arm: Arm, attachment: bytes) -> None:
    client = arm.me.client(f"{NODE}/stop", "std_srvs/srv/Trigger")
    client.wait()
    arm.trigger("reset")
    assert all(reply.ok is None for reply in client.put(HEADER + b"\0", attachment=attachment).raw(15.0))
    works(arm)


def test_a_service_without_attachment_is_not_answered(arm: Arm) -> None:
    client = arm.me.client(f"{NODE}/get_state", "lifecycle_msgs/srv/GetState")
    client.wait()
    assert all(reply.ok is None for reply in client.put(HEADER + b"\0", attach=False).raw(15.0))
    works(arm)


def test_a_negative_sequence_number(arm: Arm) -> None:
    client = arm.me.client(f"{NODE}/get_state", "lifecycle_msgs/srv/GetState")
    client.wait()
    attachment = Attachment(-5, 1, client.token.gid).serialize()
    client.put(HEADER + b"\0", attachment=attachment).raw(15.0)
    works(arm)


def test_a_service_of_another_hash_is_not_there(arm: Arm) -> None:
    wrong = HASHES["std_srvs/srv/SetBool"]
    client = arm.me.client(f"{NODE}/stop", "std_srvs/srv/Trigger", hash=wrong)
    assert not client.there
    assert client.put(HEADER + b"\0").raw(15.0) == []
    works(arm)


def test_a_big_endian_trajectory_is_understood_or_dropped(arm: Arm) -> None:
    publisher = arm.me.publisher(f"{CONTROLLER}/joint_trajectory", TRAJECTORY)
    publisher.wait_for_subscriber()
    publisher.put(b"\0\0\0\0" + struct.pack(">iIIxxxx", 0, 0, 1))
    works(arm)


@pytest.mark.slow
def test_random_bytes(arm: Arm) -> None:
    dice = random.Random(17)
    publisher = arm.me.publisher(f"{CONTROLLER}/joint_trajectory", TRAJECTORY)
    publisher.wait_for_subscriber()
    for _ in range(100):
        publisher.put(HEADER + dice.randbytes(dice.randrange(200)))
    works(arm)


@pytest.mark.slow
def test_cut_and_bent_goals(arm: Arm) -> None:
    """A valid goal, cut off anywhere or with one byte changed, never moves the arm further than it says."""
    dice = random.Random(18)
    publisher = arm.me.publisher(f"{CONTROLLER}/joint_trajectory", TRAJECTORY)
    publisher.wait_for_subscriber()
    whole = arm.me.cdr.serialize(TRAJECTORY, {"joint_names": ["nobody"], "points": [{"positions": [0.1]}]})
    for at in range(len(whole)):
        publisher.put(whole[:at])
        bent = bytearray(whole)
        bent[at] ^= 1 << dice.randrange(8)
        publisher.put(bytes(bent))
    works(arm)


@pytest.mark.slow
def test_a_long_message(arm: Arm) -> None:
    publisher = arm.me.publisher(f"{CONTROLLER}/joint_trajectory", TRAJECTORY)
    publisher.wait_for_subscriber()
    points = [{"positions": [0.0] * 7, "time_from_start": {"sec": i}} for i in range(20_000)]
    publisher.publish(joint_names=arm.names, points=points)
    # Trajectories of the test before may still be refused.
    arm.rosout.wait(lambda message: message.level >= 30 and "point" in message.msg)
    works(arm)


@pytest.mark.slow
def test_many_at_once(arm: Arm) -> None:
    client = arm.me.client(f"{NODE}/get_state", "lifecycle_msgs/srv/GetState")
    client.wait()
    for _ in range(25):
        # A service keeps 10 requests.
        for reply in [client.send() for _ in range(8)]:
            reply.received()
    works(arm)
