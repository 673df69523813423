from __future__ import annotations

import contextlib
from itertools import product

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from hexwire.errors import RemoteProtocolError, UsageError
from hexwire.wire import servo_packet as sp
from hexwire.wire.servo_packet import BOARD_ID, Instruction, ServoPacket, StatusPacket

ids = st.integers(0, 253)
errors = st.integers(0, 0x7F)
params = st.binary(max_size=20)


@st.composite
def statuses(draw: st.DrawFn) -> tuple[StatusPacket, bytes]:
    packet = StatusPacket(draw(ids), draw(errors), draw(params), draw(st.booleans()))
    return packet, sp.make_status(packet.servo_id, packet.error, packet.params, legacy=packet.legacy)


# --- building and exact parsing ----------------------------------------------------------------------------


@given(st.integers(0, 254), st.sampled_from(list(Instruction)), st.binary(max_size=244))
def test_request_there_and_back(servo_id: int, instruction: Instruction, data: bytes) -> None:
    packet = ServoPacket(servo_id, instruction, data)
    assert sp.parse_packet(packet.serialize()) == packet


@given(statuses())
def test_status_there_and_back(case: tuple[StatusPacket, bytes]) -> None:
    packet, data = case
    assert sp.parse_status(data) == packet


@given(st.binary(max_size=300))
def test_parsers_raise_nothing_else(data: bytes) -> None:
    for parse in (sp.parse_packet, sp.parse_status):
        with contextlib.suppress(RemoteProtocolError):
            assert len(parse(data).params) == len(data) - 6


@given(statuses(), st.integers(0, 7), st.integers(0, 25))
def test_any_flipped_bit_is_noticed(case: tuple[StatusPacket, bytes], bit: int, at: int) -> None:
    data = case[1]
    at %= len(data)
    flipped = bytearray(data)
    flipped[at] ^= 1 << bit
    if flipped[1] in (0xFF, 0xF5) and at == 1:
        return  # FF F5 against FF FF is a change of header, not of what the checksum covers
    with pytest.raises(RemoteProtocolError):
        sp.parse_status(bytes(flipped))


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        ("FF FF 01 02", "shortest"),
        ("FE FF 01 02 00 FC", "starts with fe ff"),
        ("FF FF 01 03 00 FC", "length byte"),
        ("FF FF 01 02 00 FD", "should be fc"),
        ("FF FF FE 02 00 FF", "id 254"),
        ("FF FF 01 02 80 7C", "reserved"),
    ],
)
def test_bad_status_says_why(data: str, reason: str) -> None:
    with pytest.raises(RemoteProtocolError, match=reason):
        sp.parse_status(bytes.fromhex(data))


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        ("", "shortest"),
        ("FF F5 01 02 01 FB", "not ff ff"),
        ("FF FF 01 06 01 F7", "length byte"),
        ("FF FF 01 02 01 00", "should be fb"),
        ("FF FF FF 02 01 FD", "id 255"),
    ],
)
def test_bad_request_says_why(data: str, reason: str) -> None:
    with pytest.raises(RemoteProtocolError, match=reason):
        sp.parse_packet(bytes.fromhex(data))


@pytest.mark.parametrize(
    "call",
    [
        lambda: sp.make_ping(255),
        lambda: sp.make_ping(-1),
        lambda: sp.make_read(1, 256, 2),
        lambda: sp.make_read(1, 56, 0),
        lambda: sp.make_read(1, 56, 245),
        lambda: sp.make_write(1, -1, b"x"),
        lambda: sp.make_write(1, 0, bytes(245)),
        lambda: sp.make_packet(1, 256),
        lambda: sp.make_packet(1, -1),
        lambda: sp.make_packet(1, 3, bytes(245)),
        lambda: sp.make_sync_read(56, 2, [-1]),
        lambda: sp.make_sync_write(-1, {1: b"a"}),
        lambda: sp.make_sync_write(42, []),
        lambda: sp.make_sync_write(42, {1: bytes(243)}),
        lambda: sp.make_calibrate(1, b""),
        lambda: sp.make_calibrate(1, b"123"),
        lambda: sp.make_status(256),
        lambda: sp.make_status(-1),
        lambda: sp.make_status(1, -1),
        lambda: sp.make_calibrate(1, b"x"),
        lambda: sp.make_sync_read(56, 2, []),
        lambda: sp.make_sync_read(56, 2, [1, 1]),
        lambda: sp.make_sync_read(56, 2, [254]),
        lambda: sp.make_sync_write(42, {1: b"ab", 2: b"a"}),
        lambda: sp.make_sync_write(42, {1: b""}),
        lambda: sp.make_status(1, 256),
        lambda: sp.make_status(1, 0, bytes(245)),
        lambda: sp.make_board_error(3),
    ],
)
def test_what_cannot_be_built_is_a_usage_error(call) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(UsageError):
        call()


@given(st.integers(0, 254), st.integers(0, 255), st.binary(max_size=244))
def test_the_bytes_of_a_request(servo_id: int, instruction: int, data: bytes) -> None:
    packet = sp.make_packet(servo_id, instruction, data)
    assert packet[:5] == bytes((0xFF, 0xFF, servo_id, len(data) + 2, instruction))
    assert packet[5:-1] == data
    assert sum(packet[2:]) % 256 == 255


@given(st.integers(0, 255), st.integers(0, 255), st.binary(max_size=244), st.booleans())
def test_the_bytes_of_a_status(servo_id: int, error: int, data: bytes, legacy: bool) -> None:
    packet = sp.make_status(servo_id, error, data, legacy=legacy)
    assert packet[:5] == bytes((0xFF, 0xF5 if legacy else 0xFF, servo_id, len(data) + 2, error))
    assert packet[5:-1] == data
    assert sum(packet[2:]) % 256 == 255


def test_the_largest_values_that_still_fit() -> None:
    assert len(sp.make_packet(254, 255, bytes(244))) == 250
    assert sp.make_read(1, 255, 244)[5:7] == b"\xff\xf4"
    assert sp.make_read(1, 0, 1)[5:7] == b"\0\1"
    assert sp.make_sync_read(255, 244, [0, 253])[5:-1] == b"\xff\xf4\0\xfd"
    assert len(sp.make_write(1, 255, bytes(243))) == 250
    assert len(sp.make_sync_write(255, {253: bytes(241)})) == 250
    assert sp.make_calibrate(3, b"\x08\x05")[2:-1] == b"\x03\x04\x0b\x08\x05"
    assert len(sp.make_status(255, 255, bytes(244))) == 250
    assert sp.make_action()[2] == 254
    assert sp.make_board_error(4)[2] == 255


def test_every_instruction_has_its_code() -> None:
    made = {
        "PING": sp.make_ping(1),
        "READ": sp.make_read(1, 56, 2),
        "WRITE": sp.make_write(1, 40, b"\x01"),
        "REG_WRITE": sp.make_reg_write(1, 40, b"\x01"),
        "ACTION": sp.make_action(1),
        "RESTORE": sp.make_restore(1),
        "REBOOT": sp.make_reboot(1),
        "BACKUP": sp.make_backup(1),
        "RESET_STATE": sp.make_reset_state(1),
        "CALIBRATE": sp.make_calibrate(1),
        "SYNC_READ": sp.make_sync_read(56, 2, [1]),
        "SYNC_WRITE": sp.make_sync_write(40, {1: b"\x01"}),
    }
    codes = [1, 2, 3, 4, 5, 6, 8, 9, 10, 11, 0x82, 0x83]
    assert [made[name][4] for name in made] == codes
    assert set(made) == set(Instruction.__members__)


def rows_of(size: int) -> st.SearchStrategy[dict[int, bytes]]:
    return st.dictionaries(ids, st.binary(min_size=size, max_size=size), min_size=1, max_size=20)


@given(st.integers(1, 6).flatmap(rows_of), st.integers(0, 255))
def test_sync_write_there_and_back(data: dict[int, bytes], address: int) -> None:
    packet = sp.parse_packet(sp.make_sync_write(address, data))
    assert sp.parse_sync_write(packet) == (address, tuple(data.items()))


def test_a_sync_write_is_read_only_where_its_rows_fill_it() -> None:
    for size, more in product(range(5), range(13)):
        packet = ServoPacket(254, Instruction.SYNC_WRITE, bytes((42, size, *range(more))))
        if size and more % (1 + size) == 0:
            address, rows = sp.parse_sync_write(packet)
            assert address == 42
            assert [len(data) for _, data in rows] == [size] * (more // (1 + size)), (size, more)
            assert b"".join(bytes((servo_id,)) + data for servo_id, data in rows) == packet.params[2:]
        else:
            with pytest.raises(RemoteProtocolError, match="ends within a row"):
                pytest.fail(f"{more} bytes of rows of {size} are {sp.parse_sync_write(packet)}")


@pytest.mark.parametrize("body", [b"", b"\x2a"])
def test_a_sync_write_without_its_head_is_refused(body: bytes) -> None:
    with pytest.raises(RemoteProtocolError, match="ends within a row"):
        sp.parse_sync_write(ServoPacket(254, Instruction.SYNC_WRITE, body))


def test_other_instructions_are_no_sync_write() -> None:
    with pytest.raises(RemoteProtocolError, match="not a sync write"):
        sp.parse_sync_write(ServoPacket(1, Instruction.PING, b""))


# --- quirks ------------------------------------------------------------------------------------------------


def test_legacy_ping_status_is_six_bytes_whatever_its_length_byte_says() -> None:
    for data in (sp.make_legacy_ping_status(3), sp.make_status(3, legacy=True)):
        assert len(data) == 6
        assert sp.parse_status(data) == StatusPacket(3, 0, b"", True)
        assert sp.find_status(data + b"\xff\xff", 3, 0) == (StatusPacket(3, 0, b"", True), 6)


def test_length_six_without_the_legacy_header_is_no_quirk() -> None:
    data = bytes.fromhex("FF FF 03 06 00 F6")
    with pytest.raises(RemoteProtocolError):
        sp.parse_status(data)
    assert sp.find_status(data, 3, None) is None


def test_a_true_four_parameter_legacy_status_is_still_found() -> None:
    data = sp.make_status(3, 0, b"\x01\x02\x03\x04", legacy=True)
    assert sp.find_status(data, 3, 4) == (StatusPacket(3, 0, b"\x01\x02\x03\x04", True), 10)


@pytest.mark.parametrize(
    ("code", "servo_id", "name", "size"),
    [
        (4, BOARD_ID, "frame_short", 6),
        (7, BOARD_ID, "command_unknown", 6),
        (5, 3, "ping_silent", 6),
        (1, 5, "read_silent", 8),
    ],
)
def test_board_errors(code: int, servo_id: int, name: str, size: int) -> None:
    data = sp.make_board_error(code, servo_id)
    assert len(data) == size
    status = sp.parse_status(data)
    assert sp.board_error_name(status) == name
    assert list(sp.iter_status(data + data)) == [status, status]


@pytest.mark.parametrize(
    "status",
    [
        StatusPacket(3, 0, b"", True),
        StatusPacket(3, 5, b"", False),
        StatusPacket(3, 1, b"\x05\x08", True),
        StatusPacket(3, 7, b"", True),
        StatusPacket(3, 4, b"", True),
        StatusPacket(BOARD_ID, 3, b"", True),
        StatusPacket(BOARD_ID, 4, b"\0", True),
        StatusPacket(3, 5, b"\0", True),
        StatusPacket(3, 1, b"", True),
        StatusPacket(3, 1, b"\0", True),
    ],
)
def test_what_is_no_board_error(status: StatusPacket) -> None:
    assert sp.board_error_name(status) is None


def test_swapped_one_byte_read_looks_sound_until_it_is_undone() -> None:
    data = bytes.fromhex("FF F5 01 03 00 FA 01")
    assert sp.parse_status(data).params == b"\xfa"  # wrong, but the sum is the same
    assert sp.parse_status(sp.undo_one_byte_swap(data)) == StatusPacket(1, 0, b"\x01", True)


@given(ids, errors, st.integers(0, 255))
def test_undo_is_its_own_inverse_on_one_byte_reads(servo_id: int, error: int, value: int) -> None:
    data = sp.make_status(servo_id, error, bytes((value,)), legacy=True)
    swapped = sp.undo_one_byte_swap(data)
    assert (swapped[5], swapped[6]) == (data[6], data[5])
    assert sp.undo_one_byte_swap(swapped) == data


@given(st.binary(max_size=10))
def test_undo_leaves_everything_else_alone(data: bytes) -> None:
    if len(data) != 7 or data[:2] != b"\xff\xf5" or data[3] != 3:
        assert sp.undo_one_byte_swap(data) == data
    feetech = sp.make_status(1, 0, b"\x07")
    assert sp.undo_one_byte_swap(feetech) == feetech


def begins_like_a_ping(data: bytes) -> bool:
    """Whether a legacy answer with four parameters begins with what is a whole ping answer too."""
    return data[1] == 0xF5 and data[3] == 6 and sum(data[2:6]) & 0xFF == 0xFF


def status_at(data: bytes, at: int, n_params: int | None) -> int:
    """`status_end` by the words of its page: header, id, error, and a length whose sum fits."""
    legacy = data[at : at + 2] == b"\xff\xf5"
    servo_id, length, error = data[at + 2 : at + 5]
    if not legacy and data[at : at + 2] != b"\xff\xff":
        return 0
    if error > 127 or servo_id == 254 or (servo_id == 255 and not legacy):
        return 0

    def sound(size: int) -> bool:
        part = data[at + 2 : at + size]
        return len(part) == size - 2 and sum(part) % 256 == 255

    whole = at + 4 + length if length >= 2 and sound(4 + length) else 0
    if legacy and length == 6 and sound(6) and not (whole and n_params == 4):
        return at + 6
    return whole


@st.composite
def almost_statuses(draw: st.DrawFn) -> bytes:
    """A status packet with any id, error and length, whose checksum fits somewhere, if anywhere."""
    length = draw(st.sampled_from((0, 1, 2, 3, 6, 8)))
    body = bytearray((draw(st.sampled_from((0, 1, 253, 254, 255))), length, draw(st.sampled_from((0, 127, 128)))))
    body += draw(st.binary(max_size=10))
    at = draw(st.sampled_from((3, length + 1)))
    if at < len(body):
        body[at] = ~sum(body[:at]) & 0xFF
    data = bytes((0xFF, draw(st.sampled_from((0xFF, 0xF5, 0xF6))), *body))
    return data if len(data) >= 6 else data + bytes(6 - len(data))


@given(st.binary(max_size=3), almost_statuses(), st.sampled_from((None, 0, 1, 4)))
def test_where_a_status_ends(before: bytes, data: bytes, n_params: int | None) -> None:
    assert sp.status_end(before + data, len(before), n_params) == status_at(before + data, len(before), n_params)


# --- streams -----------------------------------------------------------------------------------------------


@given(st.lists(statuses().filter(lambda case: not begins_like_a_ping(case[1])), max_size=8))
def test_packets_in_a_row_are_all_found(cases: list[tuple[StatusPacket, bytes]]) -> None:
    stream = b"".join(data for _, data in cases)
    assert list(sp.iter_status(stream)) == [packet for packet, _ in cases]


@given(
    st.lists(
        st.tuples(
            st.binary(max_size=12).filter(lambda b: 0xFF not in b),
            statuses().filter(lambda case: not begins_like_a_ping(case[1])),
        ),
        max_size=6,
    )
)
def test_packets_among_noise_are_found(cases: list[tuple[bytes, tuple[StatusPacket, bytes]]]) -> None:
    stream = b"".join(noise + data for noise, (_, data) in cases)
    assert list(sp.iter_status(stream)) == [packet for _, (packet, _) in cases]


@given(st.integers(1, 9), statuses(), st.binary(max_size=5))
def test_a_run_of_ff_hides_nothing(run: int, case: tuple[StatusPacket, bytes], after: bytes) -> None:
    packet, data = case
    found = sp.find_status(b"\xff" * run + data + after, packet.servo_id, len(packet.params))
    assert found == (packet, run + len(data))


@pytest.mark.parametrize(
    "before", [b"", b"\xff", b"\xff\0", b"\xff\xff\0", b"\xff\xf5", b"\0\xff\1\xff", b"\xff" * 9]
)
@pytest.mark.parametrize(
    "packet", [sp.make_status(1, 0, b"\5\6"), sp.make_status(0), sp.make_legacy_ping_status(2)]
)
def test_the_start_of_a_packet_hides_no_other_and_a_part_is_not_a_packet(before: bytes, packet: bytes) -> None:
    status = sp.parse_status(packet)
    for after in (b"", b"\xff", b"\xff\xff", packet[:-1]):
        assert list(sp.iter_status(before + packet + after)) == [status]
        found = sp.find_status(before + packet + after, status.servo_id, len(status.params))
        assert found == (status, len(before + packet))
    for n in range(len(packet)):
        assert list(sp.iter_status(before + packet[:n])) == []
        assert sp.find_status(before + packet[:n], status.servo_id, None) is None


@given(st.binary(max_size=400))
def test_scanning_anything_raises_nothing_and_finds_only_sound_packets(data: bytes) -> None:
    for status in sp.iter_status(data):
        assert (
            sp.make_status(*status[:3], legacy=status.legacy) in data
            or sp.make_legacy_ping_status(status.servo_id, status.error) in data
        )
    for packet in sp.iter_packets(data):
        assert packet.serialize() in data


def test_noise_that_looks_like_another_servo_does_not_swallow_the_answer() -> None:
    data = bytes.fromhex("FF F5 02 07 01 00 00 00 00 00 F5")
    stream = b"\xff" + data  # FF FF F5 02 07 01 is a sound packet of id 245
    assert next(sp.iter_status(stream)).servo_id == 245
    assert sp.find_status(stream, 2, 5) == (sp.parse_status(data), 12)


@given(statuses(), st.integers(0, 253), st.binary(max_size=6))
def test_find_takes_the_id_and_length_asked_for(case: tuple[StatusPacket, bytes], other: int, more: bytes) -> None:
    packet, data = case
    stranger = sp.make_status((packet.servo_id + 1) % 254, 0, more)
    # Whoever scans finds what looks like a packet inside another one (PROTOCOL.md section 4): here no header is.
    assume(b"\xff" not in stranger[2:] + data[2:])
    stream = stranger + data
    assert sp.find_status(stream, packet.servo_id, len(packet.params)) == (packet, len(stream))
    assert sp.find_status(stream, packet.servo_id, None) == (packet, len(stream))
    assert sp.find_status(stream, packet.servo_id, len(packet.params) + 1) is None
    assert sp.find_status(stream, packet.servo_id, len(packet.params), start=len(stranger) + 1) is None
    if other not in (packet.servo_id, (packet.servo_id + 1) % 254):
        assert sp.find_status(stream, other, None) is None


@given(st.lists(st.tuples(ids, st.sampled_from(list(Instruction)), params), max_size=6))
def test_requests_in_a_row_are_all_found(cases: list[tuple[int, Instruction, bytes]]) -> None:
    packets = [ServoPacket(*case) for case in cases]
    stream = b"\x00\xff\x00".join(packet.serialize() for packet in packets)
    assert list(sp.iter_packets(stream)) == packets


@pytest.mark.parametrize(
    ("packet", "found"),
    [
        ("FF FF FE 02 01 FE", True),
        ("FF FF FF 02 01 FD", False),  # the id of no servo
        ("FF FF 01 02 01 FB", True),
        ("FF FF 01 02 01 FA", False),  # the sum
        ("FF FF 01 01 01 FC", False),  # too short for its instruction
        ("FF FF 01 00 01 FD", False),
        ("FF FF 01 03 01 FA", False),  # cut short
        ("FF F5 01 02 01 FB", False),
    ],
)
@pytest.mark.parametrize("after", ["", "FF FF 02 02 01 FA"])
def test_what_is_a_request_in_a_stream(packet: str, found: bool, after: str) -> None:
    data = bytes.fromhex(packet)
    wanted = [ServoPacket(data[2], 1, b"")] if found else []
    if after:
        wanted.append(ServoPacket(2, 1, b""))
    assert list(sp.iter_packets(data + bytes.fromhex(after))) == wanted


def test_requests_with_an_unknown_instruction_are_passed_over() -> None:
    assert list(sp.iter_packets(sp.make_packet(1, 0x55) + sp.make_ping(2))) == [ServoPacket(2, 1, b"")]


def test_echo_is_removed_wherever_it_starts() -> None:
    request = sp.make_read(1, 56, 2)
    answer = sp.make_status(1, 0, b"\x18\x05")
    stale = sp.make_status(1, 0, b"\x00\x00")
    assert sp.strip_echo(request + answer, request) == answer
    assert sp.strip_echo(stale + request + answer, request) == answer
    assert sp.strip_echo(answer, request) == answer
    assert sp.strip_echo(answer, b"") == answer


def test_an_unstripped_echo_would_pass_for_an_answer() -> None:
    request = sp.make_read(1, 56, 2)
    assert sp.find_status(request, 1, 2) == (StatusPacket(1, 2, b"\x38\x02", False), 8)
    assert sp.find_status(sp.strip_echo(request, request), 1, 2) is None


def test_an_answer_whose_front_passes_for_a_legacy_ping_is_found_by_its_length() -> None:
    data = bytes.fromhex("FFF5000634C500000000")
    assert sp.find_status(data, 0, 4) == (sp.StatusPacket(0, 0x34, b"\xc5\0\0\0", True), len(data))
    ping = sp.find_status(data, 0, 0)
    assert ping is not None
    assert ping[1] == 6
    assert sp.find_status(data[:9], 0, 4) is None


def test_a_packet_can_be_shown_as_it_is() -> None:
    reserved = sp.make_status(1, 0x80, b"\x01\x02")
    with pytest.raises(RemoteProtocolError, match="reserved error bits"):
        sp.parse_status(reserved)
    assert sp.parse_status(reserved, as_it_is=True) == (1, 0x80, b"\x01\x02", False)
    assert sp.parse_status(sp.make_status(254), as_it_is=True).servo_id == 254
    with pytest.raises(RemoteProtocolError, match="checksum"):
        sp.parse_status(reserved[:-1] + b"\0", as_it_is=True)
