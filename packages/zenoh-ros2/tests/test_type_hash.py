"""Type hashes, compared with those that ROS publishes."""

from __future__ import annotations

import pytest
from rosbags.typesys import Stores, get_typestore

from zenoh_ros2.definitions import Definition, ServiceDefinition, parse_action, parse_service
from zenoh_ros2.distributions import Distribution
from zenoh_ros2.type_hash import IndividualDescription, describe, individual_of, type_hash
from zenoh_ros2.types import Types

# From what ROS 2 itself prints (`ros2 topic info --verbose`), from the design document of rmw_zenoh, and from the
# tests of other implementations.
PUBLISHED = {
    "action_msgs/msg/GoalStatusArray": "6c1684b00f177d37438febe6e709fc4e2b0d4248dca4854946f9ed8b30cda83e",
    "action_msgs/srv/CancelGoal": "573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a",
    "control_msgs/msg/JointTrajectoryControllerState": (
        "51d8dd89cc624cbe9daaeeb4d80d6de9b86168ffdc3be41fefc0953e3c26e480"
    ),
    "diagnostic_msgs/msg/DiagnosticArray": "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
    "lifecycle_msgs/msg/TransitionEvent": "d5f8873a2f0146498f812d7885c7327ce27e463d36811d8792f35ee38c0d6c38",
    "rcl_interfaces/msg/Log": "e28ce254ca8abc06abf92773b74602cdbf116ed34fbaf294fb9f81da9f318eac",
    "rcl_interfaces/msg/ParameterEvent": "043e627780fcad87a22d225bc2a037361dba713fca6a6b9f4b869a5aa0393204",
    "rcl_interfaces/srv/GetParameters": "bf9803d5c74cf989a5de3e0c2e99444599a627c7ff75f97b8c05b01003675cbc",
    "rcl_interfaces/srv/ListParameters": "3e6062bfbb27bfb8730d4cef2558221f51a11646d78e7bb30a1e83afac3aad9d",
    "rcl_interfaces/srv/SetParameters": "56eed9a67e169f9cb6c1f987bc88f868c14a8fc9f743a263bc734c154015d7e0",
    "rosgraph_msgs/msg/Clock": "692f7a66e93a3c83e71765d033b60349ba68023a8c689a79e48078bcb5c58564",
    "sensor_msgs/msg/JointState": "a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    "std_msgs/msg/String": "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    "std_srvs/srv/Empty": "5888399dedec5ccc85ea6451949fd2c9f97bfdf963f9a588821639fcd31b5d19",
    "std_srvs/srv/SetBool": "abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a",
    "std_srvs/srv/Trigger": "eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
    "std_srvs/srv/Trigger_Event": "ec4a1d26b0575e61906890342aba9523a2360e9845857c5590fa6e23bc39e1c2",
    "std_srvs/srv/Trigger_Request": "d010825374ce8918e72bfd826c82603e60f45419e932ea976f807b74a863a199",
    "tf2_msgs/msg/TFMessage": "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    "trajectory_msgs/msg/JointTrajectory": "179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e",
    "type_description_interfaces/srv/GetTypeDescription": (
        "69b9c19c1021405984cc60dbbb1edceb147a6538b411d812ba6afabeed962cd5"
    ),
}
# The same for interfaces that the package does not have.
EXAMPLES = {
    "example_interfaces/srv/AddTwoInts": "e118de6bf5eeb66a2491b5bda11202e7b68f198d6f67922cf30364858239c81a",
    "example_interfaces/action/Fibonacci_SendGoal": (
        "d1a57fb2a4afe8c21e34fb10db206f16ce6729b28531141472df92277c55b557"
    ),
    "example_interfaces/action/Fibonacci_GetResult": (
        "1b0de0d5d29dc955d92f546706568428632771db13ec84c15ec1c1a59f424a57"
    ),
    "example_interfaces/action/Fibonacci_FeedbackMessage": (
        "c1de71afd52e49a89c53d8262366884185bc0a02f78ce051c4e46b0a7fe59bb2"
    ),
}


@pytest.mark.parametrize("name", PUBLISHED)
def test_a_hash_is_the_published_one(name: str) -> None:
    types = Types()
    is_service = "/srv/" in name and "_" not in name.rpartition("/")[2]
    found = types.service(name) if is_service else types.message(name)
    assert found.hash == f"RIHS01_{PUBLISHED[name]}"


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_hash_of_an_example_of_ros_is_the_published_one(name: str) -> None:
    add = parse_service("example_interfaces/srv/AddTwoInts", "int64 a\nint64 b\n---\nint64 sum\n")
    text = "int32 order\n---\nint32[] sequence\n---\nint32[] sequence\n"
    fibonacci = parse_action("example_interfaces/action/Fibonacci", text)
    own: dict[str, Definition | ServiceDefinition] = {}
    for service in (add, fibonacci.send_goal, fibonacci.get_result):
        own |= {each.name: each for each in (service, service.request, service.response, service.event)}
    for each in (fibonacci.goal, fibonacci.result, fibonacci.feedback, fibonacci.feedback_message):
        own[each.name] = each
    types = Types()

    def individual(part: str) -> IndividualDescription:
        return individual_of(own[part]) if part in own else types.individual(part)

    assert type_hash(describe(name, individual)) == f"RIHS01_{EXAMPLES[name]}"


def test_the_action_of_a_trajectory_has_two_hashes_of_its_feedback() -> None:
    # No published value was found for these: they are what this code computes.
    name = "control_msgs/action/FollowJointTrajectory"
    before, after = (Types(each).action(name) for each in (Distribution.JAZZY, Distribution.KILTED))
    assert before.feedback.hash == "RIHS01_80398fcb9674a79081a9906e2ccf0c804dd7cb15e22e362e606ee87186beab71"
    assert after.feedback.hash == "RIHS01_95618cc73912d99b9acaa17d2da5e832cb0bfdeede7534fa8ec600feca2a6c4b"
    assert before.send_goal.hash == after.send_goal.hash
    assert before.get_result.hash == after.get_result.hash


@pytest.mark.parametrize(
    ("distribution", "store"),
    [
        (Distribution.JAZZY, Stores.ROS2_JAZZY),
        (Distribution.KILTED, Stores.ROS2_KILTED),
        (Distribution.LYRICAL, Stores.ROS2_LYRICAL),
        # Rolling goes on from the newest.
        (Distribution.ROLLING, Stores.ROS2_LYRICAL),
    ],
)
def test_hashes_are_those_of_rosbags_for_each_distribution(distribution: Distribution, store: Stores) -> None:
    types, theirs = Types(distribution), get_typestore(store)
    names = [name for name in PUBLISHED if name in theirs.fielddefs]
    assert len(names) > 8
    for name in names:
        assert types.message(name).hash == theirs.hash_rihs01(name), name
