"""Layer by layer, good and bad; never an exception, never a byte unaccounted for."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.frames import frame_bytes

from hexwire.link.tap import Direction, Passed
from hexwire.trace.explain import Explained, Explainer
from hexwire.wire.command_frame import Command
from hexwire.wire.commands import JointReport
from hexwire.wire.servo_packet import make_read, make_status, make_sync_read, make_sync_write, make_write

VECTORS = Path(__file__).parents[2] / "vectors"
SENT, RECEIVED = Direction.SENT, Direction.RECEIVED


def frame(proto: int, cmd: int, body: bytes, *, src: int = 7, seq: int = 1, ext: int = 0) -> bytes:
    return frame_bytes(cmd, body, proto=proto, seq=seq, src=src, dst=15 - src, cmd_ext=ext)


def explain(*transfers: tuple[Direction, bytes, float]) -> list[Explained]:
    explainer = Explainer()
    found = [e for way, data, time in transfers for e in explainer.feed(Passed(way, data, time, ""))]
    return [*found, *explainer.finish()]


def layer(explained: Explained, name: str) -> dict[str, object]:
    return next(part.fields for part in explained.layers if part.name == name)


def test_a_dialect_1_read_is_paired_and_its_register_named() -> None:
    request = frame(1, Command.READ, make_read(0, 0x38, 2))
    # The board swaps a legacy answer to little-endian: 2053 is 05 08.
    reply = frame(1, Command.READ, make_status(0, 0, b"\x05\x08", legacy=True), src=8, seq=9)
    asked, answered = explain((SENT, request, 1.0), (RECEIVED, reply, 1.0359))
    assert layer(asked, "servo")["register"] == "present_position"
    assert layer(answered, "servo")["registers"][0]["raw"] == 2053  # type: ignore[index]  # a list of dicts
    assert layer(answered, "pairing") == {"request_seq": 1, "took_ms": 35.9}
    assert not answered.problem


def test_a_dialect_2_reply_is_paired_by_seq_and_its_check_judged() -> None:
    report = JointReport(0, 0, (2047,) * 7, (0,) * 7)
    request = frame(2, Command.JOINT_STATE, b"\0", seq=4)
    other = frame(2, Command.STATS, b"", seq=5)
    reply = frame(2, Command.JOINT_STATE, report.serialize(), src=8, seq=4, ext=0x80)
    *_, answered = explain((SENT, request, 1.0), (SENT, other, 1.0), (RECEIVED, reply, 1.02))
    assert layer(answered, "pairing")["request_seq"] == 4
    assert layer(answered, "command")["check_verdict"] == "good"
    assert "position 2047" in answered.layers[2].text


def test_bytes_that_are_no_frame_have_their_time_and_way() -> None:
    (noise,) = explain((RECEIVED, b"noise", 2.5))
    assert (noise.direction, noise.time, noise.data) == (RECEIVED, 2.5, b"noise")
    assert noise.problem


def test_the_flags_of_a_board_have_names() -> None:
    report = frame(2, Command.JOINT_STATE, JointReport(0, 3, (2047,), (0,)).serialize(), src=8, ext=0x40)
    maintenance = frame(2, Command.MAINTENANCE, bytes([1, 0x48]), src=8, ext=0x80)
    short = frame(2, Command.MAINTENANCE, bytes([1]), src=8, ext=0x80)
    asked = frame(2, Command.MAINTENANCE, bytes([1]))
    told, also, *others = explain((RECEIVED, report + maintenance + short + asked, 0.0))
    assert layer(told, "body")["board_flags"] == ["stopped", "watchdog tripped"]
    assert told.layers[2].text.endswith("(position 2047, status 0) [stopped, watchdog tripped]")
    assert also.layers[2].text.endswith(" [settings default, maintenance]")
    assert not [other for other in others if "board_flags" in layer(other, "body")]


def test_what_a_line_says_in_words_its_fields_say_too() -> None:
    asked = make_sync_read(0x38, 2, [4, 9])
    request, *answers = explain(
        (SENT, asked, 1.0), *((RECEIVED, make_status(i, 0, b"\x00\x08"), 1.0) for i in (4, 9))
    )
    assert layer(request, "servo")["register"] == "present_position"
    (register,) = layer(answers[0], "servo")["registers"]
    assert (register["name"], register["raw"], "present_position 2048" in answers[0].text) == (
        "present_position", 2048, True,
    )  # fmt: skip
    # Which registers servo 9 has is not known.
    assert "registers" not in layer(answers[1], "servo")
    assert answers[1].text == "status 9: 00 08"
    explainer = Explainer("sts_sms")
    write = Passed(SENT, frame(1, Command.SYNC_WRITE, make_write(4, 0x2A, b"\x34\x12")), 0.0, "")
    (reading,) = explainer.lines.feed(write)
    (value,) = (part.value for part in explainer.dissect(reading).leaves() if part.name == "goal_position")
    assert f"goal_position {value} " in reading.text


def test_a_cooked_port_is_recognised_and_the_frame_explained_all_the_same() -> None:
    reply = frame(1, Command.READ, make_status(6, 0, b"\x34\x00"), src=8)
    (explained,) = explain((RECEIVED, reply[:-2] + b"\n\n", 0.0))
    assert "ICRNL" in explained.problem
    assert explained.kind == "frame"
    assert explained.data.endswith(b"\n\n")


def test_corrupt_bytes_are_shown_in_place_and_explaining_continues() -> None:
    good = frame(2, Command.STATS, b"", seq=1)
    flipped = bytearray(frame(2, Command.JOINT_STATE, b"\x3f", seq=2))
    flipped[40] ^= 1
    found = explain((SENT, b"noise" + good + bytes(flipped) + good, 0.0))
    assert [e.kind for e in found] == ["garbage", "frame", "bad", "frame"]
    assert found[2].problem.startswith("check is")
    assert found[2].data == bytes(flipped)


def test_a_frame_in_pieces_is_one() -> None:
    data = frame(2, Command.STATS, b"", seq=1)
    found = explain(*[(SENT, data[i : i + 1], float(i)) for i in range(len(data))])
    assert [e.kind for e in found] == ["frame"]


def test_the_chapters_hazards_are_pointed_out() -> None:
    marker = frame(1, Command.READ, make_read(13, 10, 2))
    assert b"\r\n" not in marker[4:-2]
    inside = frame(1, Command.SYNC_WRITE, make_sync_write(0x2A, {1: b"\x0d\x0a\x10\x00"}))
    (explained,) = explain((SENT, inside, 0.0))
    assert layer(explained, "command")["hazard"] == "0D 0A inside"
    block = frame(1, Command.SYNC_WRITE, make_sync_write(0x2A, {4: b"\x00\x08\xb8\x06"}))
    (explained,) = explain((SENT, block, 0.0))
    assert "current ceiling" in str(layer(explained, "servo")["hazard"])


def test_a_bus_without_a_board() -> None:
    request = make_read(4, 0x38, 2)
    asked, answered = explain((SENT, request, 1.0), (RECEIVED, make_status(4, 0, b"\x00\x08"), 1.001))
    assert asked.kind == answered.kind == "servo packet"
    assert "present_position 2048" in answered.text
    (written,) = explain((SENT, make_write(4, 0x28, b"\x01"), 0.0))
    assert "torque_enable" in written.text
    # There is no register behind the last one.
    (written,) = Explainer("sts_sms").feed(Passed(SENT, make_write(4, 0x30, b"\xf4\x01\x07"), 0.0, ""))
    assert layer(written, "servo")["registers"][-1] == {"address": 0x32, "raw": 7}  # type: ignore[index]  # a list of dicts


def test_every_vector_is_explained_and_json_takes_it() -> None:
    for name in ("session.jsonl", "command.jsonl", "servo.jsonl"):
        for line in (VECTORS / name).read_text().splitlines():
            data = bytes.fromhex(json.loads(line)["hex"])
            found = explain((SENT, data, 0.0))
            assert bool(found) == bool(data), line
            assert b"".join(e.data for e in found) == data
            json.dumps([e.as_fields() for e in found])


@given(st.lists(st.tuples(st.sampled_from(Direction), st.binary(max_size=120)), max_size=8))
def test_any_noise_is_explained_and_no_byte_lost(transfers: list[tuple[Direction, bytes]]) -> None:
    found = explain(*[(way, data, 0.0) for way, data in transfers])
    for direction in Direction:
        told = b"".join(e.data for e in found if e.direction is direction)
        assert told == b"".join(data for way, data in transfers if way is direction)
    json.dumps([e.as_fields() for e in found])


@given(st.data())
def test_mutated_frames_never_raise(data: st.DataObject) -> None:
    good = frame(2, Command.JOINT_STATE, b"\x3f") + frame(1, Command.READ, make_read(0, 0x38, 2))
    spoilt = bytearray(good)
    for _ in range(data.draw(st.integers(1, 6))):
        spoilt[data.draw(st.integers(0, len(spoilt) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(spoilt)))
    found = explain((SENT, bytes(spoilt[:cut]), 0.0), (SENT, bytes(spoilt[cut:]), 0.0))
    assert b"".join(e.data for e in found) == bytes(spoilt)


@pytest.mark.parametrize("error", [0x80, 0xA1, 0xFF])
def test_reserved_error_bits_are_shown_as_they_are(error: int) -> None:
    status = make_status(1, error, b"\x00\x08")
    asked, answered = explain((SENT, make_read(1, 0x38, 2), 1.0), (RECEIVED, status, 1.001))
    assert layer(asked, "servo")["id"] == 1
    assert (answered.kind, layer(answered, "servo")["error"]) == ("servo packet", error)
    assert answered.reading.startswith("status 1 error ")
    (through_the_board,) = explain((RECEIVED, frame(1, Command.READ, status, src=8), 1.0))
    assert layer(through_the_board, "servo")["error"] == error
    assert "status 1 error " in through_the_board.reading


@st.composite
def sound_packets(draw: st.DrawFn) -> bytes:
    """Servo packets whose checksum is good, whatever stands in them."""
    params = draw(st.binary(max_size=12))
    body = bytes((draw(st.integers(0, 255)), len(params) + 2, draw(st.integers(0, 255)))) + params
    return draw(st.sampled_from((b"\xff\xff", b"\xff\xf5"))) + body + bytes((~sum(body) & 0xFF,))


@given(st.lists(st.tuples(st.sampled_from(Direction), sound_packets()), max_size=8), st.booleans())
def test_sound_packets_of_any_content_are_explained_without_an_exception(
    transfers: list[tuple[Direction, bytes]], framed: bool
) -> None:
    def wrapped(way: Direction, data: bytes) -> bytes:
        return frame(1, Command.READ, data, src=7 if way is SENT else 8) if framed else data

    found = explain(*((way, wrapped(way, data), 1.0) for way, data in transfers))
    for way in Direction:
        whole = b"".join(wrapped(each, data) for each, data in transfers if each is way)
        assert b"".join(e.data for e in found if e.direction is way) == whole
    assert all(isinstance(e.reading, str) for e in found)


def test_what_follows_an_unfinished_frame_is_explained_at_the_end() -> None:
    good = frame(2, Command.STATS, b"", seq=1)
    long = bytearray(good[:40])
    long[28:32], long[36:38] = (8000).to_bytes(4, "little"), (8000 - 44).to_bytes(2, "little")
    found = explain((SENT, bytes(long) + good + good, 0.0))
    assert [(e.kind, e.problem) for e in found] == [
        ("bad", "cut short, 128 of 8000 bytes"),
        ("frame", ""),
        ("frame", ""),
    ]


def test_an_explanation_that_is_not_taken_is_not_given_again() -> None:
    good = frame(2, Command.STATS, b"", seq=1)
    explainer = Explainer()
    for first in explainer.feed(Passed(SENT, good + good, 0.0, "")):
        assert first.data == good
        break
    assert [e.data for e in explainer.feed(Passed(SENT, good[:8], 0.0, ""))] == [good]
