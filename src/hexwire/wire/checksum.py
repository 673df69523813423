"""The three checksums of the wire: servo packet, command frame, and the CRC the frame's check is made of.

Pure functions of bytes. Knows no layout: the caller says which bytes.
"""

from __future__ import annotations

from binascii import crc_hqx

__all__ = ["crc16", "frame_check", "servo_checksum"]


def servo_checksum(data: bytes | bytearray | memoryview) -> int:
    """Checksum of a servo packet: NOT of the low byte of the sum (PROTOCOL.md, servo packet).

    Args:
        data: From the id to the last parameter; neither header nor checksum.
    """
    return ~sum(data) & 0xFF


def crc16(data: bytes | bytearray | memoryview, crc: int = 0xFFFF) -> int:
    """CRC-16/IBM-3740: poly 1021, init FFFF, not reflected, no final xor. Of "123456789" it is 29B1.

    Args:
        data: Any bytes.
        crc: Result of the bytes before, to go on from.
    """
    return crc_hqx(data, crc)


def frame_check(data: bytes | bytearray | memoryview) -> int:
    """Check field of a dialect-2 frame, from byte 0 to the end of the body.

    FFFF means "not checked" on the wire, so a CRC of FFFF is sent as 0000.
    """
    crc = crc_hqx(data, 0xFFFF)
    return 0 if crc == 0xFFFF else crc
