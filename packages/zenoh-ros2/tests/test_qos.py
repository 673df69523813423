from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zenoh_ros2.errors import RemoteProtocolError
from zenoh_ros2.qos import (
    ACTION_STATUS,
    DEFAULT,
    PARAMETERS,
    ROSOUT,
    SENSOR_DATA,
    Durability,
    History,
    Liveliness,
    Qos,
    Reliability,
    incompatible_policies,
    parse_qos,
)

NUMBER = st.integers(0, 2**63)
QOS = st.builds(
    Qos,
    st.sampled_from([Reliability.RELIABLE, Reliability.BEST_EFFORT]),
    st.sampled_from([Durability.TRANSIENT_LOCAL, Durability.VOLATILE]),
    st.sampled_from([History.KEEP_LAST, History.KEEP_ALL]),
    NUMBER,
    st.tuples(NUMBER, NUMBER),
    st.tuples(NUMBER, NUMBER),
    st.sampled_from([Liveliness.AUTOMATIC, Liveliness.MANUAL_BY_TOPIC]),
    st.tuples(NUMBER, NUMBER),
)


@pytest.mark.parametrize(
    ("qos", "key"),
    [
        (DEFAULT, "::,10:,:,:,,"),
        (SENSOR_DATA, "2::,5:,:,:,,"),
        (PARAMETERS, "::,1000:,:,:,,"),
        (ACTION_STATUS, ":1:,1:,:,:,,"),
        (ROSOUT, ":1:,1000:,:10,0:,,"),
        (Qos(depth=42), "::,:,:,:,,"),
        (Qos(history=History.KEEP_ALL, depth=0), "::2,0:,:,:,,"),
        (Qos(liveliness=Liveliness.MANUAL_BY_TOPIC, lease=(1, 5)), "::,10:,:,:3,1,5"),
        (Qos(deadline=(0, 100)), "::,10:0,100:,:,,"),
    ],
)
def test_its_form_in_a_token_is_that_of_rmw_zenoh(qos: Qos, key: str) -> None:
    assert qos.key == key
    assert parse_qos(key) == qos


def test_what_a_later_version_adds_to_the_form_is_ignored() -> None:
    for longer in ("::,10,9:,:,:3,1,5", "::,10:,,9:,,9:3,1,5", "::,10:,:,:3,1,5,9", "::,10:,:,:3,1,5:9"):
        assert parse_qos(longer) == parse_qos("::,10:,:,:3,1,5"), longer


@given(QOS)
def test_the_form_is_read_back(qos: Qos) -> None:
    assert parse_qos(qos.key) == qos


@pytest.mark.parametrize(
    "text",
    [
        "",
        ":::::",
        "9::,10:,:,:,,",
        "::,-1:,:,:,,",
        "::,x:,:,:,,",
        "::,99999999999999999999999:,:,:,,",
        "٣::,:,:,:,,",
    ],
)
def test_other_forms_are_refused(text: str) -> None:
    with pytest.raises(RemoteProtocolError):
        parse_qos(text)


@given(st.text(alphabet="0123456789:,x", max_size=40))
def test_any_text_is_read_or_refused(text: str) -> None:
    try:
        parse_qos(text)
    except RemoteProtocolError:
        return


def test_incompatible_policies_are_named() -> None:
    assert incompatible_policies(DEFAULT, DEFAULT) == ()
    assert incompatible_policies(DEFAULT, SENSOR_DATA) == ()
    assert incompatible_policies(SENSOR_DATA, DEFAULT) == ("RELIABILITY",)
    assert incompatible_policies(DEFAULT, ACTION_STATUS) == ("DURABILITY",)
    assert incompatible_policies(ACTION_STATUS, DEFAULT) == ()
    assert incompatible_policies(DEFAULT, replace(DEFAULT, deadline=(1, 0))) == ("DEADLINE",)
    assert incompatible_policies(DEFAULT, replace(DEFAULT, lease=(1, 0))) == ("LIVELINESS",)
    assert incompatible_policies(DEFAULT, replace(DEFAULT, liveliness=Liveliness.MANUAL_BY_TOPIC)) == (
        "LIVELINESS",
    )
