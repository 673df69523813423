from __future__ import annotations

import pytest
from tests.ros2.world import Router

from hexwire.errors import LinkClosedError, LinkPermissionError
from hexwire.ros2.zenoh_session import ZenohSettings


def test_the_settings_are_those_of_rmw_zenoh() -> None:
    rows = ZenohSettings().rows()
    assert rows["mode"] == "peer"
    assert rows["connect/endpoints"] == ["tcp/localhost:7447"]
    assert rows["listen/endpoints"] == ["tcp/localhost:0"]
    assert rows["scouting/multicast/enabled"] is False
    assert rows["scouting/gossip/enabled"] is True
    assert rows["timestamping/enabled"] == {"router": True, "peer": True, "client": True}


@pytest.mark.system
def test_a_session_opens_without_a_router() -> None:
    session = ZenohSettings(connect=("tcp/127.0.0.1:1",)).open()
    assert session.routers == 0
    session.close()
    assert session.is_closed
    with pytest.raises(LinkClosedError, match="is closed"):
        session.declare_token("a/b")


@pytest.mark.system
def test_an_endpoint_that_is_taken_cannot_be_listened_on(router: Router) -> None:
    with pytest.raises(LinkPermissionError, match="cannot open a Zenoh session"):
        ZenohSettings(connect=(router.endpoint,), listen=(router.endpoint,)).open()
