"""The interfaces that the strict client speaks, from the public definitions: fields in their order, and type hashes as literals.

It shares nothing with `hexwire.ros2`: an error in the one is seen by the other. Fields with their type as ROS writes it;
`@` marks the version of control_msgs from 6.3 on, `%` that of Humble.
"""

# ruff: noqa: E501 (a table)
from __future__ import annotations

_TEXT = """
builtin_interfaces/msg/Time: int32 sec, uint32 nanosec
builtin_interfaces/msg/Duration: int32 sec, uint32 nanosec
std_msgs/msg/Header: builtin_interfaces/msg/Time stamp, string frame_id
std_msgs/msg/String: string data
std_msgs/msg/Bool: bool data
std_msgs/msg/MultiArrayDimension: string label, uint32 size, uint32 stride
std_msgs/msg/MultiArrayLayout: std_msgs/msg/MultiArrayDimension[] dim, uint32 data_offset
std_msgs/msg/Float64MultiArray: std_msgs/msg/MultiArrayLayout layout, float64[] data
unique_identifier_msgs/msg/UUID: uint8[16] uuid
sensor_msgs/msg/JointState: std_msgs/msg/Header header, string[] name, float64[] position, float64[] velocity, float64[] effort
trajectory_msgs/msg/JointTrajectoryPoint: float64[] positions, float64[] velocities, float64[] accelerations, float64[] effort, builtin_interfaces/msg/Duration time_from_start
trajectory_msgs/msg/JointTrajectory: std_msgs/msg/Header header, string[] joint_names, trajectory_msgs/msg/JointTrajectoryPoint[] points
geometry_msgs/msg/Vector3: float64 x, float64 y, float64 z
geometry_msgs/msg/Quaternion: float64 x, float64 y, float64 z, float64 w
geometry_msgs/msg/Transform: geometry_msgs/msg/Vector3 translation, geometry_msgs/msg/Quaternion rotation
geometry_msgs/msg/TransformStamped: std_msgs/msg/Header header, string child_frame_id, geometry_msgs/msg/Transform transform
geometry_msgs/msg/Twist: geometry_msgs/msg/Vector3 linear, geometry_msgs/msg/Vector3 angular
tf2_msgs/msg/TFMessage: geometry_msgs/msg/TransformStamped[] transforms
trajectory_msgs/msg/MultiDOFJointTrajectoryPoint: geometry_msgs/msg/Transform[] transforms, geometry_msgs/msg/Twist[] velocities, geometry_msgs/msg/Twist[] accelerations, builtin_interfaces/msg/Duration time_from_start
trajectory_msgs/msg/MultiDOFJointTrajectory: std_msgs/msg/Header header, string[] joint_names, trajectory_msgs/msg/MultiDOFJointTrajectoryPoint[] points
diagnostic_msgs/msg/KeyValue: string key, string value
diagnostic_msgs/msg/DiagnosticStatus: byte level, string name, string message, string hardware_id, diagnostic_msgs/msg/KeyValue[] values
diagnostic_msgs/msg/DiagnosticArray: std_msgs/msg/Header header, diagnostic_msgs/msg/DiagnosticStatus[] status
control_msgs/msg/JointTolerance: string name, float64 position, float64 velocity, float64 acceleration
control_msgs/msg/JointComponentTolerance: string joint_name, uint16 component, float64 position, float64 velocity, float64 acceleration
control_msgs/msg/JointTrajectoryControllerState: std_msgs/msg/Header header, string[] joint_names, trajectory_msgs/msg/JointTrajectoryPoint reference, trajectory_msgs/msg/JointTrajectoryPoint feedback, trajectory_msgs/msg/JointTrajectoryPoint error, trajectory_msgs/msg/JointTrajectoryPoint output, string[] multi_dof_joint_names, trajectory_msgs/msg/MultiDOFJointTrajectoryPoint multi_dof_reference, trajectory_msgs/msg/MultiDOFJointTrajectoryPoint multi_dof_feedback, trajectory_msgs/msg/MultiDOFJointTrajectoryPoint multi_dof_error, trajectory_msgs/msg/MultiDOFJointTrajectoryPoint multi_dof_output, float64 speed_scaling_factor
%control_msgs/msg/JointTrajectoryControllerState: std_msgs/msg/Header header, string[] joint_names, trajectory_msgs/msg/JointTrajectoryPoint reference, trajectory_msgs/msg/JointTrajectoryPoint feedback, trajectory_msgs/msg/JointTrajectoryPoint error, trajectory_msgs/msg/JointTrajectoryPoint output, trajectory_msgs/msg/JointTrajectoryPoint desired, trajectory_msgs/msg/JointTrajectoryPoint actual, string[] multi_dof_joint_names, trajectory_msgs/msg/MultiDOFJointTrajectoryPoint multi_dof_reference, trajectory_msgs/msg/MultiDOFJointTrajectoryPoint multi_dof_feedback, trajectory_msgs/msg/MultiDOFJointTrajectoryPoint multi_dof_error, trajectory_msgs/msg/MultiDOFJointTrajectoryPoint multi_dof_output, trajectory_msgs/msg/MultiDOFJointTrajectoryPoint multi_dof_desired, trajectory_msgs/msg/MultiDOFJointTrajectoryPoint multi_dof_actual
control_msgs/srv/QueryTrajectoryState: builtin_interfaces/msg/Time time > bool success, string message, string[] name, float64[] position, float64[] velocity, float64[] acceleration
std_srvs/srv/Trigger: > bool success, string message
std_srvs/srv/SetBool: bool data > bool success, string message
action_msgs/msg/GoalInfo: unique_identifier_msgs/msg/UUID goal_id, builtin_interfaces/msg/Time stamp
action_msgs/msg/GoalStatus: action_msgs/msg/GoalInfo goal_info, int8 status
action_msgs/msg/GoalStatusArray: action_msgs/msg/GoalStatus[] status_list
action_msgs/srv/CancelGoal: action_msgs/msg/GoalInfo goal_info > int8 return_code, action_msgs/msg/GoalInfo[] goals_canceling
control_msgs/action/FollowJointTrajectory_Goal: trajectory_msgs/msg/JointTrajectory trajectory, trajectory_msgs/msg/MultiDOFJointTrajectory multi_dof_trajectory, control_msgs/msg/JointTolerance[] path_tolerance, control_msgs/msg/JointComponentTolerance[] component_path_tolerance, control_msgs/msg/JointTolerance[] goal_tolerance, control_msgs/msg/JointComponentTolerance[] component_goal_tolerance, builtin_interfaces/msg/Duration goal_time_tolerance
control_msgs/action/FollowJointTrajectory_Result: int32 error_code, string error_string
control_msgs/action/FollowJointTrajectory_Feedback: std_msgs/msg/Header header, string[] joint_names, trajectory_msgs/msg/JointTrajectoryPoint desired, trajectory_msgs/msg/JointTrajectoryPoint actual, trajectory_msgs/msg/JointTrajectoryPoint error, string[] multi_dof_joint_names, trajectory_msgs/msg/MultiDOFJointTrajectoryPoint multi_dof_desired, trajectory_msgs/msg/MultiDOFJointTrajectoryPoint multi_dof_actual, trajectory_msgs/msg/MultiDOFJointTrajectoryPoint multi_dof_error
@control_msgs/action/FollowJointTrajectory_Feedback: std_msgs/msg/Header header, string[] joint_names, trajectory_msgs/msg/JointTrajectoryPoint desired, trajectory_msgs/msg/JointTrajectoryPoint actual, trajectory_msgs/msg/JointTrajectoryPoint error, int32 index, string[] multi_dof_joint_names, trajectory_msgs/msg/MultiDOFJointTrajectoryPoint multi_dof_desired, trajectory_msgs/msg/MultiDOFJointTrajectoryPoint multi_dof_actual, trajectory_msgs/msg/MultiDOFJointTrajectoryPoint multi_dof_error, int32 multi_dof_index
control_msgs/action/FollowJointTrajectory_FeedbackMessage: unique_identifier_msgs/msg/UUID goal_id, control_msgs/action/FollowJointTrajectory_Feedback feedback
control_msgs/action/FollowJointTrajectory_SendGoal: unique_identifier_msgs/msg/UUID goal_id, control_msgs/action/FollowJointTrajectory_Goal goal > bool accepted, builtin_interfaces/msg/Time stamp
control_msgs/action/FollowJointTrajectory_GetResult: unique_identifier_msgs/msg/UUID goal_id > int8 status, control_msgs/action/FollowJointTrajectory_Result result
rcl_interfaces/msg/Log: builtin_interfaces/msg/Time stamp, uint8 level, string name, string msg, string file, string function, uint32 line
rcl_interfaces/msg/ParameterValue: uint8 type, bool bool_value, int64 integer_value, float64 double_value, string string_value, byte[] byte_array_value, bool[] bool_array_value, int64[] integer_array_value, float64[] double_array_value, string[] string_array_value
rcl_interfaces/msg/Parameter: string name, rcl_interfaces/msg/ParameterValue value
rcl_interfaces/msg/FloatingPointRange: float64 from_value, float64 to_value, float64 step
rcl_interfaces/msg/IntegerRange: int64 from_value, int64 to_value, uint64 step
rcl_interfaces/msg/ParameterDescriptor: string name, uint8 type, string description, string additional_constraints, bool read_only, bool dynamic_typing, rcl_interfaces/msg/FloatingPointRange[<=1] floating_point_range, rcl_interfaces/msg/IntegerRange[<=1] integer_range
rcl_interfaces/msg/ParameterEvent: builtin_interfaces/msg/Time stamp, string node, rcl_interfaces/msg/Parameter[] new_parameters, rcl_interfaces/msg/Parameter[] changed_parameters, rcl_interfaces/msg/Parameter[] deleted_parameters
rcl_interfaces/msg/SetParametersResult: bool successful, string reason
rcl_interfaces/msg/ListParametersResult: string[] names, string[] prefixes
rcl_interfaces/srv/DescribeParameters: string[] names > rcl_interfaces/msg/ParameterDescriptor[] descriptors
rcl_interfaces/srv/GetParameterTypes: string[] names > uint8[] types
rcl_interfaces/srv/GetParameters: string[] names > rcl_interfaces/msg/ParameterValue[] values
rcl_interfaces/srv/ListParameters: string[] prefixes, uint64 depth > rcl_interfaces/msg/ListParametersResult result
rcl_interfaces/srv/SetParameters: rcl_interfaces/msg/Parameter[] parameters > rcl_interfaces/msg/SetParametersResult[] results
rcl_interfaces/srv/SetParametersAtomically: rcl_interfaces/msg/Parameter[] parameters > rcl_interfaces/msg/SetParametersResult result
lifecycle_msgs/msg/State: uint8 id, string label
lifecycle_msgs/msg/Transition: uint8 id, string label
lifecycle_msgs/msg/TransitionDescription: lifecycle_msgs/msg/Transition transition, lifecycle_msgs/msg/State start_state, lifecycle_msgs/msg/State goal_state
lifecycle_msgs/msg/TransitionEvent: uint64 timestamp, lifecycle_msgs/msg/Transition transition, lifecycle_msgs/msg/State start_state, lifecycle_msgs/msg/State goal_state
@lifecycle_msgs/msg/TransitionEvent: builtin_interfaces/msg/Time stamp, lifecycle_msgs/msg/Transition transition, lifecycle_msgs/msg/State start_state, lifecycle_msgs/msg/State goal_state
lifecycle_msgs/srv/ChangeState: lifecycle_msgs/msg/Transition transition > bool success
lifecycle_msgs/srv/GetState: > lifecycle_msgs/msg/State current_state
lifecycle_msgs/srv/GetAvailableStates: > lifecycle_msgs/msg/State[] available_states
lifecycle_msgs/srv/GetAvailableTransitions: > lifecycle_msgs/msg/TransitionDescription[] available_transitions
type_description_interfaces/msg/FieldType: uint8 type_id, uint64 capacity, uint64 string_capacity, string<=255 nested_type_name
type_description_interfaces/msg/Field: string name, type_description_interfaces/msg/FieldType type, string default_value
type_description_interfaces/msg/IndividualTypeDescription: string<=255 type_name, type_description_interfaces/msg/Field[] fields
type_description_interfaces/msg/KeyValue: string key, string value
type_description_interfaces/msg/TypeDescription: type_description_interfaces/msg/IndividualTypeDescription type_description, type_description_interfaces/msg/IndividualTypeDescription[] referenced_type_descriptions
type_description_interfaces/msg/TypeSource: string type_name, string encoding, string raw_file_contents
type_description_interfaces/srv/GetTypeDescription: string type_name, string type_hash, bool include_type_sources > bool successful, string failure_reason, type_description_interfaces/msg/TypeDescription type_description, type_description_interfaces/msg/TypeSource[] type_sources, type_description_interfaces/msg/KeyValue[] extra_information
service_msgs/msg/ServiceEventInfo: uint8 event_type, builtin_interfaces/msg/Time stamp, char[16] client_gid, int64 sequence_number
"""

# REP 2016 hashes. Those in `PUBLIC` stand in public files of others; the rest was computed by two independent programs.
HASHES = {
    "std_msgs/msg/Float64MultiArray": "RIHS01_1025ddc6b9552d191f89ef1a8d2f60f3d373e28b283d8891ddcc974e8c55397f",
    "sensor_msgs/msg/JointState": "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
    "std_msgs/msg/String": "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
    "trajectory_msgs/msg/JointTrajectory": "RIHS01_179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e",
    "tf2_msgs/msg/TFMessage": "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    "diagnostic_msgs/msg/DiagnosticArray": "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
    "control_msgs/msg/JointTrajectoryControllerState": "RIHS01_51d8dd89cc624cbe9daaeeb4d80d6de9b86168ffdc3be41fefc0953e3c26e480",
    "control_msgs/srv/QueryTrajectoryState": "RIHS01_4a0935dffef18bc5b9e101c9d03d84e681ecd4cebd724b8f11fde008751a325a",
    "std_srvs/srv/Trigger": "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
    "std_srvs/srv/SetBool": "RIHS01_abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a",
    "action_msgs/msg/GoalStatusArray": "RIHS01_6c1684b00f177d37438febe6e709fc4e2b0d4248dca4854946f9ed8b30cda83e",
    "action_msgs/srv/CancelGoal": "RIHS01_573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a",
    "control_msgs/action/FollowJointTrajectory_SendGoal": "RIHS01_b13789dddc325a7a962825c45e28c77d37237ec129dd0c34dc5994562938c57f",
    "control_msgs/action/FollowJointTrajectory_GetResult": "RIHS01_e3ceb38e3e1867c8dc0f46014df26e90eb93422f27e9e97f936e07f94be4bc8b",
    "control_msgs/action/FollowJointTrajectory_FeedbackMessage": "RIHS01_80398fcb9674a79081a9906e2ccf0c804dd7cb15e22e362e606ee87186beab71",
    "rcl_interfaces/msg/Log": "RIHS01_e28ce254ca8abc06abf92773b74602cdbf116ed34fbaf294fb9f81da9f318eac",
    "rcl_interfaces/msg/ParameterEvent": "RIHS01_043e627780fcad87a22d225bc2a037361dba713fca6a6b9f4b869a5aa0393204",
    "rcl_interfaces/srv/DescribeParameters": "RIHS01_845b484d71eb0673dae682f2e3ba3c4851a65a3dcfb97bddd82c5b57e91e4cff",
    "rcl_interfaces/srv/GetParameterTypes": "RIHS01_da199c878688b3e530bdfe3ca8f74cb9fa0c303101e980a9e8f260e25e1c80ca",
    "rcl_interfaces/srv/GetParameters": "RIHS01_bf9803d5c74cf989a5de3e0c2e99444599a627c7ff75f97b8c05b01003675cbc",
    "rcl_interfaces/srv/ListParameters": "RIHS01_3e6062bfbb27bfb8730d4cef2558221f51a11646d78e7bb30a1e83afac3aad9d",
    "rcl_interfaces/srv/SetParameters": "RIHS01_56eed9a67e169f9cb6c1f987bc88f868c14a8fc9f743a263bc734c154015d7e0",
    "rcl_interfaces/srv/SetParametersAtomically": "RIHS01_0e192ef259c07fc3c07a13191d27002222e65e00ccec653ca05e856f79285fcd",
    "lifecycle_msgs/msg/TransitionEvent": "RIHS01_d5f8873a2f0146498f812d7885c7327ce27e463d36811d8792f35ee38c0d6c38",
    "lifecycle_msgs/srv/ChangeState": "RIHS01_356fe34f0475a43acf54542013af4167b0e729f77ea22ffb045c6ad8e20668e5",
    "lifecycle_msgs/srv/GetState": "RIHS01_800a0a5aae599782b02932de0caf563f6dc4e7e94b794eadde075ba2cbef9795",
    "lifecycle_msgs/srv/GetAvailableStates": "RIHS01_00a07d79d2207d71e81a8cbc1880e5d924cc16d4688ea8e8e06e443dc8f8aa1d",
    "lifecycle_msgs/srv/GetAvailableTransitions": "RIHS01_59b7ecefce0982a8a844b9f2c4f14764c1c4543cc55e72924e2aa4adad83e9bc",
    "type_description_interfaces/srv/GetTypeDescription": "RIHS01_69b9c19c1021405984cc60dbbb1edceb147a6538b411d812ba6afabeed962cd5",
}
# Where a version of control_msgs differs.
NEW_HASHES = {
    "control_msgs/action/FollowJointTrajectory_FeedbackMessage": "RIHS01_95618cc73912d99b9acaa17d2da5e832cb0bfdeede7534fa8ec600feca2a6c4b",
    "lifecycle_msgs/msg/TransitionEvent": "RIHS01_78b19e2be41a797fc009c96bda68944182edabec7852cccd928a40bc06f6f9d7",
}

# Humble knows no hashes, and writes this in their place (rosidl_runtime_c, rmw_zenoh for Humble).
NO_HASH = "TypeHashNotSupported"

PUBLIC = {
    "sensor_msgs/msg/JointState",
    "trajectory_msgs/msg/JointTrajectory",
    "std_srvs/srv/Trigger",
    "std_srvs/srv/SetBool",
    "action_msgs/srv/CancelGoal",
    "action_msgs/msg/GoalStatusArray",
    "std_msgs/msg/String",
}

Fields = list[tuple[str, str]]
DISTRIBUTIONS = {"humble": "%", "jazzy": "", "kilted": "", "rolling": "@"}


class Definitions:
    """The fields of every message of one distribution, requests and responses included."""

    def __init__(self, distribution: str) -> None:
        self.distribution = distribution
        variant = DISTRIBUTIONS[distribution]
        self.fields: dict[str, Fields] = {}
        for line in _TEXT.strip().splitlines():
            mark = line[0] if line[0] in "@%" else ""
            if mark not in ("", variant):
                continue
            name, _, rest = line.lstrip("@%").partition(":")
            sides = rest.split(" > ")
            if len(sides) == 1:
                self.fields[name] = _fields(sides[0])
            else:
                self.fields[f"{name}_Request"], self.fields[f"{name}_Response"] = map(_fields, sides)

    def hash(self, name: str) -> str:
        if self.distribution == "humble":
            return NO_HASH
        if self.distribution == "rolling" and name in NEW_HASHES:
            return NEW_HASHES[name]
        return HASHES[name]


def _fields(text: str) -> Fields:
    return [(kind, name) for kind, _, name in (field.strip().rpartition(" ") for field in text.split(",")) if name]


def dds_name(name: str) -> str:
    """`sensor_msgs/msg/JointState` is `sensor_msgs::msg::dds_::JointState_` in keys and tokens."""
    package, kind, leaf = name.split("/")
    return f"{package}::{kind}::dds_::{leaf}_"
