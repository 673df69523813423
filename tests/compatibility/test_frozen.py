"""Bytes of earlier versions with the present code, as docs/versions.md promises.

The folders here hold the vectors as they were with each version of the firmware. They are never changed.
"""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path
from typing import Any

import pytest
from tests.drivers.arms import Arm
from tests.session import test_conversation
from tests.wire import test_commands, test_servo_vectors, test_session_vectors

from hexwire.drivers.abilities import OnboardPaths
from hexwire.emulator import board_dialect2
from hexwire.errors import NotSupportedError, StoppedError
from hexwire.model.state import JointTarget
from hexwire.wire import tables
from hexwire.wire.command_frame import Command, Status

HERE = Path(__file__).parent
PAGE = (HERE.parents[1] / "docs/versions.md").read_text(encoding="utf-8")
VERSIONS = sorted(path.name for path in HERE.iterdir() if re.fullmatch(r"[\d.]+", path.name))
DIGESTS = {
    "2.0.0/command.jsonl": "d437334f4ed30231",
    "2.0.0/servo.jsonl": "4fe72cc9fa157f95",
    "2.0.0/session.jsonl": "ed116f7a389022cb",
    "2.1.0/command.jsonl": "ad159323e0e18cc1",
    "2.1.0/conversation.jsonl": "c4ccee337993dbcd",
    "2.1.0/servo.jsonl": "4fe72cc9fa157f95",
    "2.1.0/session.jsonl": "ed116f7a389022cb",
}
"""First digits of the SHA-256 of each file."""


def rows(name: str, **wanted: str) -> list[dict[str, Any]]:
    """The rows of a file of all versions that have these values."""
    found = []
    for version in VERSIONS:
        path = HERE / version / f"{name}.jsonl"
        for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
            row = json.loads(line)
            if all(row.get(key) == value for key, value in wanted.items()):
                found.append(row | {"version": version})
    assert found
    return found


def test_nobody_has_changed_them() -> None:
    present = {
        path.relative_to(HERE).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()[:16]
        for path in HERE.glob("*/*.jsonl")
    }
    assert present == DIGESTS


def test_the_page_names_every_version_and_the_present_one() -> None:
    named = set(re.findall(r"^\| firmware (\d+\.\d+\.\d+) \|", PAGE, re.MULTILINE))
    present = f"{tables.VERSION_MAJOR}.{tables.VERSION_MINOR}.{tables.VERSION_PATCH}"
    assert named == {*VERSIONS, present}, "freeze the vectors of the version before, and give it a row"


# --- the bytes mean what they meant ---------------------------------------------------------------------------


# What fails shows its row, as the argument of the test that it is given to.


def test_frames() -> None:
    for row in rows("session", kind="frame"):
        test_session_vectors.test_frame_is_parsed_and_built(row)
        test_session_vectors.test_frame_comes_out_of_a_stream(row)


def test_bad_frames() -> None:
    for row in rows("session", kind="bad"):
        test_session_vectors.test_bad_frame_is_refused_for_its_reason(row)


def test_bodies() -> None:
    for row in rows("command"):
        if "error" in row:
            test_commands.test_bad_body_is_refused(row)
            continue
        test_commands.test_vector_follows_the_schema(row)
        if test_commands.value_of(row) is not None:
            test_commands.test_typed_body_is_read_and_written(row)


def test_requests_to_servos() -> None:
    for row in rows("servo", kind="request"):
        test_servo_vectors.test_request_is_built_and_parsed(row)


def test_answers_of_servos() -> None:
    for row in rows("servo", kind="status"):
        test_servo_vectors.test_status_is_built_and_parsed(row)


def test_conversations() -> None:
    for row in rows("conversation"):
        test_conversation.test_vectors(row)


# --- an older host with the present board ---------------------------------------------------------------------


def test_the_board_knows_the_requests_of_older_hosts() -> None:
    """All but a part of a message in fragments, which no board of a line answers."""
    for row in rows("command", part="request"):
        if "error" in row or row["command"].startswith("FRAGMENT"):
            continue
        arm = Arm()
        reply = arm.driver.session.request(Command[row["command"]], bytes.fromhex(row["hex"]))
        # Tables of another number of joints than this arm has.
        refused = {Status.BAD_LENGTH} if len(row.get("rows", [])) not in (0, len(arm.driver.model.names)) else set()
        assert Status(reply.status) not in {Status.BAD_LENGTH, Status.UNKNOWN_COMMAND} - refused, (row, reply)


# --- the present host with an older board ---------------------------------------------------------------------


@pytest.fixture
def older(monkeypatch: pytest.MonkeyPatch) -> Arm:
    """A board that announces and knows what firmware 2.0.0 did."""
    known = sum(code for name, code in tables.CAPABILITIES.items() if code < tables.CAPABILITY_MAINTENANCE)
    monkeypatch.setattr(board_dialect2, "_CAPABILITIES", known)
    monkeypatch.setattr(board_dialect2, "_FIRMWARE", (2, 0, 0))
    arm = Arm(attach=False)
    handlers = arm.board.dialect2._handlers
    for command in [c for c in handlers if c >= Command.MAINTENANCE]:
        del handlers[command]
    arm.driver.attach()
    return arm


def test_a_new_host_moves_and_stops_an_older_board(older: Arm) -> None:
    driver = older.driver
    report = driver.probe()
    assert (report.dialect, report.firmware) == (2, "2.0.0")
    assert not {"maintenance", "trajectory", "several"} & set(report.capabilities)
    driver.torque(True)
    with driver.watched(0.5) as covered:
        assert covered
        driver.write(JointTarget.of({"J1": 0.1}, duration=0.3))
    older.wait(1.0)
    assert driver.read()["J1"].position == pytest.approx(0.1, abs=0.02)
    assert not driver.can(OnboardPaths)
    with pytest.raises(NotSupportedError):
        driver.path()
    driver.stop()
    with pytest.raises(StoppedError):
        driver.write(JointTarget.of({"J1": 0.0}))
    driver.resume()
    assert not driver.read().stopped


def test_what_an_older_board_cannot_do_is_said(older: Arm) -> None:
    with pytest.raises(NotSupportedError, match=r"firmware 2\.0\.0 has no maintenance; flash a newer one"):
        older.driver.maintenance(True)
