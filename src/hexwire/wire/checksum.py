"""Checksum of a command frame.

A pure function of bytes. Knows no layout: the caller chooses the bytes.
"""

from __future__ import annotations

from binascii import crc_hqx

__all__ = ["frame_check"]


def frame_check(data: bytes | bytearray | memoryview) -> int:
    """Compute the check field of a dialect-2 frame, from byte 0 to the end of the body.

    CRC-16/IBM-3740: poly 1021, init FFFF, not reflected, no final xor. FFFF means "not checked" on
    the wire, so a CRC of FFFF is sent as 0000.
    """
    crc = crc_hqx(data, 0xFFFF)
    return 0 if crc == 0xFFFF else crc
