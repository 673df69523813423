from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from hexwire.wire.command_frame import frame_check


def _crc_by_hand(data: bytes, crc: int = 0xFFFF) -> int:
    """The polynomial division, a bit at a time, as the catalogue describes it."""
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


def test_the_catalogue_s_check_value() -> None:
    assert frame_check(b"123456789") == 0x29B1


@given(st.binary(max_size=64))
def test_it_is_the_polynomial_but_never_the_unchecked_mark(data: bytes) -> None:
    crc = _crc_by_hand(data)
    assert frame_check(data) == (0 if crc == 0xFFFF else crc)


def test_a_crc_of_ffff_is_zero() -> None:
    assert _crc_by_hand(b"") == 0xFFFF
    assert frame_check(b"") == 0
