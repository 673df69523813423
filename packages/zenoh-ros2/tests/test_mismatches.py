from __future__ import annotations

from dataclasses import replace

import pytest

from zenoh_ros2.keys import Endpoint, Role
from zenoh_ros2.mismatches import describe_mismatch
from zenoh_ros2.qos import DEFAULT, LATCHED, SENSOR_DATA, Qos


def endpoint(role: Role, qos: Qos = DEFAULT, **fields: str) -> Endpoint:
    one = Endpoint(0, "ab", "0", "1", role, "/", "/", "other", "/chatter", "T_", "RIHS01_1", qos)
    return replace(one, **fields)  # type: ignore[arg-type]


INCOMPATIBLE = "New {} discovered on topic '/chatter', {} incompatible QoS. No messages will be {} it. "
LATE = INCOMPATIBLE.format("subscription", "requesting", "sent to")
LOSSY = INCOMPATIBLE.format("publisher", "offering", "received from")
BUT = "This is so over DDS; Zenoh delivers them"
NOTHING = "nothing passes between them"


@pytest.mark.parametrize(
    ("own", "other", "words"),
    [
        (
            endpoint(Role.PUBLISHER),
            endpoint(Role.SUBSCRIPTION, LATCHED),
            f"{LATE}Last incompatible policy: DURABILITY_QOS_POLICY. {BUT}",
        ),
        (
            endpoint(Role.SUBSCRIPTION),
            endpoint(Role.PUBLISHER, SENSOR_DATA),
            f"{LOSSY}Last incompatible policy: RELIABILITY_QOS_POLICY. {BUT}",
        ),
        (
            endpoint(Role.PUBLISHER),
            endpoint(Role.SUBSCRIPTION, type_name="U_"),
            f"The subscription of /other on '/chatter' has another type, U_; {NOTHING}",
        ),
        (
            endpoint(Role.SERVICE),
            endpoint(Role.CLIENT, type_hash="RIHS01_2"),
            (
                "The client of /other on '/chatter' has another definition of T_ (RIHS01_2, here RIHS01_1); "
                f"{NOTHING}. Is the parameter 'distribution' right?"
            ),
        ),
    ],
)
def test_what_does_not_fit_is_told_in_the_words_of_ros(own: Endpoint, other: Endpoint, words: str) -> None:
    assert describe_mismatch(own, other) == words


@pytest.mark.parametrize(
    ("own", "other"),
    [
        (endpoint(Role.PUBLISHER), endpoint(Role.SUBSCRIPTION)),
        (endpoint(Role.PUBLISHER, LATCHED), endpoint(Role.SUBSCRIPTION)),
        (endpoint(Role.PUBLISHER), endpoint(Role.PUBLISHER, type_name="U_")),
        (endpoint(Role.PUBLISHER), endpoint(Role.SUBSCRIPTION, name="/other", type_name="U_")),
        (endpoint(Role.SERVICE), endpoint(Role.CLIENT, SENSOR_DATA)),
        (endpoint(Role.PUBLISHER), endpoint(Role.NODE)),
    ],
)
def test_what_fits_gives_no_text(own: Endpoint, other: Endpoint) -> None:
    assert describe_mismatch(own, other) == ""
