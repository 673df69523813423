"""Shared arms for viewers: each with its topics and frames, and only on this machine."""

from __future__ import annotations

import json
import math
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.waits import PATIENCE
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from hexwire.drivers import registry
from hexwire.errors import UsageError
from hexwire.fleet.service import Service
from hexwire.fleet.service_file import read_arms
from hexwire.model.state import JointTarget
from hexwire.studio.foxglove import SUBPROTOCOL
from hexwire.studio.viewers import Viewers


@pytest.fixture
def runtime(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with tempfile.TemporaryDirectory(prefix="hw") as folder:
        monkeypatch.setenv("XDG_RUNTIME_DIR", folder)
        monkeypatch.setenv("XDG_STATE_HOME", str(Path(folder) / "state"))
        yield


@pytest.mark.usefixtures("runtime")
def test_two_shared_arms_are_told_apart_and_what_is_sent_to_one_is_its_target() -> None:
    viewers = Viewers("127.0.0.1:0", frozenset())
    given = {"robot": "sim", "watchdog": 30.0}
    arms = read_arms({"lab/a": given, "lab/b": given}, lease=30.0)
    with Service(arms, watch=viewers.watch):
        try:
            with connect(viewers.start(), subprotocols=[Subprotocol(SUBPROTOCOL)]) as viewer:
                viewer.recv(PATIENCE)
                rows = json.loads(viewer.recv(PATIENCE))["channels"]
                ids = {row["topic"]: row["id"] for row in rows}
                names = ("joint_states", "joint_targets", "tf", "scene")
                assert set(ids) == {"/log", *(f"/lab/{arm}/{name}" for arm in "ab" for name in names)}
                wanted = [{"id": i, "channelId": i} for topic, i in ids.items() if topic != "/log"]
                viewer.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
                with registry.connect("zenoh:lab/b") as robot:
                    robot.torque(True)
                    robot.write(JointTarget.of({"J1": 0.1}, 1.0))
                    targets = _until_all(viewer, ids)
                assert math.isclose(targets["J1"], 0.1, abs_tol=0.01)
        finally:
            viewers.end()


def _until_all(viewer: Any, ids: dict[str, int]) -> dict[str, float]:
    """Read until each topic of both arms has come, and a target of the second arm; that target."""
    left, targets = {topic for topic in ids if topic != "/log"}, {}
    topics = {number: topic for topic, number in ids.items()}
    while left or not targets:
        data = viewer.recv(PATIENCE)
        topic, body = topics[int.from_bytes(data[1:5], "little")], json.loads(data[13:])
        left.discard(topic)
        arm = topic.rpartition("/")[0].lstrip("/")
        if topic.endswith("/tf"):
            assert {row["parent_frame_id"] for row in body["transforms"]} == {f"{arm}/base_link"}
        elif topic.endswith("/scene"):
            assert all(entity["frame_id"].startswith(f"{arm}/") for entity in body["entities"])
        elif topic.endswith("/joint_targets") and body["joints"]:
            # Nobody has sent anything to the other arm.
            assert topic == "/lab/b/joint_targets"
            targets = {joint["name"]: joint["position"] for joint in body["joints"]}
    return targets


def test_other_machines_cannot_reach_it() -> None:
    for listen in ("0.0.0.0:0", "192.0.2.1:8765", "[::]:0"):
        with pytest.raises(UsageError, match="other machines can reach"):
            Viewers(listen, frozenset())
