from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from hexwire.wire.checksum import crc16, frame_check, servo_checksum


def _crc_by_hand(data: bytes, crc: int = 0xFFFF) -> int:
    """The polynomial division, a bit at a time, as the catalogue describes it."""
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


def test_servo_checksum_of_the_chapters_read() -> None:
    assert servo_checksum(bytes.fromhex("00 04 02 38 02")) == 0xBF


def test_crc16_catalogue_check_value() -> None:
    assert crc16(b"123456789") == 0x29B1


@given(st.binary(max_size=64))
def test_crc16_is_the_polynomial(data: bytes) -> None:
    assert crc16(data) == _crc_by_hand(data)


@given(st.binary(max_size=64), st.binary(max_size=64))
def test_crc16_goes_on(first: bytes, second: bytes) -> None:
    assert crc16(second, crc16(first)) == crc16(first + second)


@given(st.binary(max_size=64))
def test_frame_check_is_the_crc_but_never_the_unchecked_mark(data: bytes) -> None:
    assert frame_check(data) == (0 if crc16(data) == 0xFFFF else crc16(data))


def test_frame_check_of_a_crc_of_ffff_is_zero() -> None:
    assert crc16(b"") == 0xFFFF
    assert frame_check(b"") == 0
