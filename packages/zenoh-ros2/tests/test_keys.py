from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zenoh_ros2.errors import RemoteProtocolError, UsageError
from zenoh_ros2.keys import Endpoint, Role, data_key, domain_of, gid_of, parse_token
from zenoh_ros2.qos import DEFAULT

# As in the design document of rmw_zenoh, with the form of the quality of service that it has now.
PUBLISHER = (
    "@ros2_lv/2/8b20917502ee955ac4476e0266340d5c/0/10/MP/%/%/talker/%chatter/std_msgs::msg::dds_::String_/"
    "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18/::,7:,:,:,,"
)


def test_a_token_is_read_and_written_as_rmw_zenoh_does() -> None:
    endpoint = parse_token(PUBLISHER)
    assert (endpoint.domain, endpoint.nid, endpoint.eid) == (2, "0", "10")
    assert (endpoint.role, endpoint.enclave, endpoint.namespace) == (Role.PUBLISHER, "/", "/")
    assert (endpoint.node, endpoint.name, endpoint.type_name) == (
        "talker",
        "/chatter",
        "std_msgs::msg::dds_::String_",
    )
    assert endpoint.token == PUBLISHER
    assert endpoint.key == f"2/chatter/std_msgs::msg::dds_::String_/{endpoint.type_hash}"


def test_a_node_has_a_short_token() -> None:
    token = "@ros2_lv/0/aac3178e146ba6f1fc6e6a4085e77f21/3/3/NN/%/%arm%left/driver"
    endpoint = parse_token(token)
    assert (endpoint.namespace, endpoint.node, endpoint.name, endpoint.qos) == ("/arm/left", "driver", "", None)
    assert endpoint.token == token


def test_parts_of_later_versions_are_left_out() -> None:
    assert parse_token(PUBLISHER + "/cpu,cuda").token == PUBLISHER


def test_a_key_has_no_slash_at_the_ends_of_its_name() -> None:
    assert data_key(0, "/arm/state", "T_", "H") == "0/arm/state/T_/H"


def test_an_id_is_the_hash_of_the_token() -> None:
    # xxhash's own example of XXH3-128 with seed 0.
    assert gid_of("") == bytes.fromhex("99aa06d3014798d86001c324468d497f")[::-1]


@pytest.mark.parametrize(
    "token",
    [
        "",
        "@ros2_lv",
        "@ros2_lv/0/ab/0/0/NN/%/%",
        "@ros2_lv/0/ab/0/0/NN/%//driver",
        "@ros2_lv/x/ab/0/0/NN/%/%/driver",
        "@ros2_lv/0/zz/0/0/NN/%/%/driver",
        "@ros2_lv/0/ab/0/0/XX/%/%/driver",
        "@ros2_lv/0/ab/0/1/MP/%/%/driver",
        "@ros2_lv/0/ab/0/1/MP/%/%/driver/%x/T_/H/bad",
        "other/0/ab/0/0/NN/%/%/driver",
        "@ros2_lv/0/ab/0/0/NN/%/%/" + "n" * 5000,
        "@ros2_lv/0/ab/٣/0/NN/%/%/driver",
    ],
)
def test_other_tokens_are_refused(token: str) -> None:
    with pytest.raises(RemoteProtocolError):
        parse_token(token)


@given(st.text(alphabet="@ros2_lv/0aMPNSC%:,~* \n", max_size=120), st.booleans())
def test_any_token_is_read_or_refused(text: str, prefix: bool) -> None:
    try:
        endpoint = parse_token("@ros2_lv/0/ab/0/1/" * prefix + text)
    except RemoteProtocolError:
        return
    assert isinstance(endpoint, Endpoint)


def test_the_quality_of_service_is_written_in_canonical_form() -> None:
    spelled_out = PUBLISHER.replace("::,7:,:,:,,", "1:2:1,7:,:,:1,,")
    assert parse_token(spelled_out).token == PUBLISHER
    assert DEFAULT.key == "::,10:,:,:,,"


@pytest.mark.parametrize(("text", "domain"), [("", 0), ("0", 0), ("42", 42), ("232", 232)])
def test_the_domain_is_read(text: str, domain: int) -> None:
    assert domain_of({"ROS_DOMAIN_ID": text}) == domain
    assert domain_of({}) == 0


@pytest.mark.parametrize("text", ["-1", "x", "1.5", "99999999999", "٣"])
def test_another_domain_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="ROS_DOMAIN_ID is not an integral number"):
        domain_of({"ROS_DOMAIN_ID": text})
