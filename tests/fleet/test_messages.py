"""What travels between server and clients: whatever arrives, there is a message or one documented error."""

from __future__ import annotations

import math
import random
import struct
import tracemalloc
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.soak import rounds

from hexwire.errors import RemoteProtocolError
from hexwire.fleet import messages as m

_HOSTILE = rounds(6_000, 1_000_000)
"""Hostile payloads, each decoded as every kind of message."""

KINDS: list[Any] = [m.State, m.LeaseRequest, m.Envelope, m.Ask, m.StopRequest, m.Facts, m.Goal, m.Answer]

EMPTY: tuple[float, ...] = ()
JOINT = m.Joint("J1", 1, "scs", 2048, -1, 0.0, 0.0015, -1.5, 1.5, 3.0)
VALID: list[Any] = [
    m.State(
        *(7, 3, 1.5, 1.6, 1.7e9, ("J1", "J2"), (0.1, math.nan), (0.0, 0.0)),
        *(EMPTY, EMPTY, EMPTY, EMPTY, (64, 128), EMPTY, 0.0, False, False, False, "Ann", "", "a stop", "", 12, 800),
    ),
    m.Take("Ann", True, 1.0, 1),
    m.Beat(2**53, 0.1),
    m.Leave(17, True),
    m.Envelope(17, 1, 1.5, 0.001, m.Write(("J1", "J2"), (0.1, 0.2), 1.0)),
    m.Envelope(17, 2, 1.5, 0.001, m.Torque(True, None)),
    m.Envelope(17, 3, 1.5, 0.001, m.Torque(False, ("J1",))),
    m.Envelope(17, 4, 1.5, 0.001, m.Resume()),
    m.Envelope(17, 5, 1.5, 0.001, m.Watchdog(0.5, 0)),
    m.Envelope(17, 6, 1.5, 0.001, m.Ioctl(3, b"\x00\xff")),
    m.Envelope(17, 7, 1.5, 0.001, m.Follow(("J1",), (0.5, 1.0), (0.1, 0.2), (0.0, 0.0), (), 3.5, False, True)),
    m.Envelope(17, 8, 1.5, 0.001, m.Confirm(9)),
    m.Envelope(17, 8, 1.5, 0.001, m.Cancel(7)),
    m.Ask("ping", 254),
    m.StopRequest("Ann", 1),
    m.Facts("hex7bot", (JOINT,), 100.0, 20.0, 0.25, 0.5, "pc", "sim://", "", "", 1.5),
    m.Goal(7, 3.5, "aborted", "stopped", "Ann stopped it", None, 2, "board", 0.001),
    m.Answer("LeaseError", "no", {"holder": "Ann"}, [1, "a", {"b": 2.5}, None, b"c"], 1.5, 12),
]


def kind_of(message: Any) -> Any:
    return next(kind for kind in KINDS if type(message) in getattr(kind, "__args__", (kind,)))


@pytest.mark.parametrize("message", VALID, ids=lambda message: type(message).__name__)
def test_a_message_is_the_same_after_its_way(message: Any) -> None:
    payload = m.encode(message)
    assert payload[0] == m.VERSION
    # Compared as text, since a position that is not known equals nothing.
    assert repr(m.decode(payload, kind_of(message))) == repr(message)


@pytest.mark.parametrize(
    ("version", "words"),
    [(m.VERSION + 1, "this program is older"), (255, "this program is older"), (0, "the other program is older")],
)
def test_another_version_is_refused_with_which_side_is_older(version: int, words: str) -> None:
    for payload in (bytes([version]) + m.encode(VALID[0])[1:], bytes([version])):
        with pytest.raises(RemoteProtocolError, match=f"version {version}, not {m.VERSION}: {words}"):
            m.decode(payload, m.State)


def test_an_empty_and_an_endless_payload_are_no_messages() -> None:
    with pytest.raises(RemoteProtocolError, match="empty"):
        m.decode(b"", m.State)
    with pytest.raises(RemoteProtocolError, match="longer than"):
        m.decode(bytes([m.VERSION]) + b"\x90" * m.LARGEST, m.State)


def test_a_message_of_another_kind_is_refused() -> None:
    for message in VALID:
        for kind in KINDS:
            if kind is not kind_of(message) and type(message).__struct_config__.tag != _tag(kind):
                with pytest.raises(RemoteProtocolError):
                    m.decode(m.encode(message), kind)


def _tag(kind: Any) -> object:
    return getattr(getattr(kind, "__struct_config__", None), "tag", None)


_HUGE = [b"\xdd\xff\xff\xff\xff", b"\xdf\xff\xff\xff\xff", b"\xdb\xff\xff\xff\xff", b"\xc6\xff\xff\xff\xff"]


@pytest.mark.parametrize("huge", [*_HUGE, b"\xc9\xff\xff\xff\xff\x01", b"\xdd\x00\x0f\xff\xff" * 1000])
@pytest.mark.parametrize("place", range(6))
def test_a_length_that_is_announced_costs_no_memory(huge: bytes, place: int) -> None:
    answer = (
        bytes([m.VERSION]) + b"\x97\x14" + b"".join([b"\xa0", b"\xa0", b"\x80", b"\xc0", b"\xca\0\0\0\0"][:place])
    )
    tracemalloc.start()
    try:
        with pytest.raises(RemoteProtocolError):
            m.decode(answer + huge, m.Answer)
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("opening", [b"\x91", b"\x81\xa0", b"\xdc\x00\x01", b"\x81"])
def test_a_nest_without_end_is_refused(opening: bytes) -> None:
    payload = bytes([m.VERSION]) + b"\x97\x14\xa0\xa0\x80" + opening * (m.LARGEST // len(opening) - 8)
    with pytest.raises(RemoteProtocolError):
        m.decode(payload, m.Answer)


def test_more_than_a_message_may_have_is_refused() -> None:
    for message, kind in (
        (m.Envelope(1, 1, 0.0, 0.0, m.Write(("J",) * 65, (0.0,) * 65, 1.0)), m.Envelope),
        (m.Envelope(1, 1, 0.0, 0.0, m.Ioctl(0, bytes(4097))), m.Envelope),
        (m.Envelope(1, -1, 0.0, 0.0, m.Resume()), m.Envelope),
        (m.Envelope(2**53 + 1, 1, 0.0, 0.0, m.Resume()), m.Envelope),
        (m.Envelope(1, 2**64 - 1, 0.0, 0.0, m.Resume()), m.Envelope),
        (m.Take("x" * 4097), m.LeaseRequest),
        (m.Ask("x" * 65), m.Ask),
    ):
        with pytest.raises(RemoteProtocolError):
            m.decode(m.encode(message), kind)


def test_a_key_that_is_given_twice_counts_once() -> None:
    payload = bytes([m.VERSION]) + b"\x97\x14\xa0\xa0\x82\xa1a\x01\xa1a\x02\xc0\xca\0\0\0\0\x00"
    assert m.decode(payload, m.Answer).details == {"a": 2}


_POISON = [
    *[struct.pack(">Bd", 0xCB, value) for value in (math.nan, math.inf, -math.inf, 1e308, -1e308, 5e-324, -0.0)],
    *[struct.pack(">Bq", 0xD3, value) for value in (-1, -(2**63), 2**53 + 1, 2**63 - 1)],
    struct.pack(">BQ", 0xCF, 2**64 - 1),
    b"\xc0", b"\xc1", b"\xc2", b"\xc3", b"\xa2\xff\xfe", b"\xa1\x00", b"\xd4\x05x", b"\xd6\xff\xff\xff\xff\xff",
    b"\xc7\x0c\xff" + b"\xff" * 12, b"\x90", b"\x80", b"\x82\xa1a\x01\xa1a\x02", b"\x81\x90\x01", b"\x81\x80\x01",
    b"\x91" * 300, b"\xd9\x05hello", b"\xc4\x02\x00\xff", *_HUGE,
]  # fmt: skip


def _hostile(rng: random.Random, parts: list[Any]) -> Iterator[bytes]:
    """Payloads of every sort: noise, valid messages with changed bytes, and with hostile values in every place."""
    payloads = [m.encode(message) for message in VALID]
    while True:
        yield bytes([m.VERSION]) + rng.randbytes(rng.randrange(80))
        payload = bytearray(rng.choice(payloads))
        for _ in range(rng.randrange(1, 4)):
            payload[rng.randrange(1, len(payload))] = rng.randrange(256)
        yield bytes(payload)
        yield bytes(payload[: rng.randrange(1, len(payload) + 1)])
        at = rng.randrange(1, len(payload))
        yield bytes(payload[:at]) + rng.choice(_POISON) + bytes(payload[at + rng.randrange(2) :])
        yield bytes([m.VERSION]) + _poisoned(rng, rng.choice(parts))


def _poisoned(rng: random.Random, value: Any) -> bytes:
    """MessagePack of a value, in which a hostile value stands in some places."""
    if rng.random() < 0.08:
        return rng.choice(_POISON)
    if isinstance(value, list):
        return bytes([0x90 + len(value)]) + b"".join(_poisoned(rng, row) for row in value) if len(value) < 16 else (
            struct.pack(">BH", 0xDC, len(value)) + b"".join(_poisoned(rng, row) for row in value)
        )  # fmt: skip
    return msgspec.msgpack.encode(value)


@pytest.mark.soak
def test_whatever_arrives_is_a_message_of_the_kind_or_one_error() -> None:
    rng = random.Random(17)
    parts = [msgspec.msgpack.decode(m.encode(message)[1:]) for message in VALID]
    source = _hostile(rng, parts)
    taken = dict.fromkeys(map(str, KINDS), 0)
    for _ in range(_HOSTILE):
        payload = next(source)
        for kind in KINDS:
            try:
                message = m.decode(payload, kind)
            except RemoteProtocolError:
                continue
            assert isinstance(message, kind)
            taken[str(kind)] += 1
    # Otherwise the payloads would only meet the first check.
    assert all(count > _HOSTILE / 1000 for count in taken.values()), taken


def test_there_is_a_decoder_for_every_kind_before_there_are_threads() -> None:
    """Made by two threads at the same time, they crash the program; so none is made later."""
    with pytest.raises(KeyError):
        m.decode(m.encode(VALID[0]), m.State | m.Facts)
    for kind in KINDS:
        with pytest.raises(RemoteProtocolError):
            m.decode(bytes([m.VERSION]), kind)


@pytest.mark.parametrize("key", [0, 1, 0x7F, 0x80, 0xFF, 0x100, 0xFFFF, 0x1_0000, 2**32 - 1, 2**32, 2**53])
def test_the_key_of_an_order_is_found_without_the_order(key: int) -> None:
    payload = m.encode(m.Envelope(key, 7, 1.0, 0.0, m.Follow(("J1",), (0.0,) * 100, (0.0,) * 100)))
    assert m.lease_key(payload) == key
    # Nothing behind it matters.
    assert m.lease_key(payload[:12]) == key
    with pytest.raises(RemoteProtocolError, match="this program is older"):
        m.lease_key(bytes([m.VERSION + 1]) + payload[1:])


@given(st.binary(max_size=20) | st.binary(max_size=12).map(lambda rest: bytes([m.VERSION, 0x96, 10]) + rest))
def test_whatever_arrives_has_a_key_or_is_one_error(payload: bytes) -> None:
    try:
        key = m.lease_key(payload)
    except RemoteProtocolError:
        return
    try:
        assert m.decode(payload, m.Envelope).key == key
    except RemoteProtocolError:
        assert 0 <= key < 2**64


@pytest.mark.parametrize("kind", [m.LeaseRequest, m.Take, m.Beat, m.Leave, m.Ask, m.StopRequest, m.Question])
def test_what_anybody_may_send_is_short_or_refused_undecoded(kind: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    decoded = []

    class Decoder:
        def decode(self, data: object) -> None:
            decoded.append(data)

    monkeypatch.setitem(m._decoders, kind, Decoder())  # type: ignore[arg-type]
    with pytest.raises(RemoteProtocolError, match="longer than 32768"):
        m.decode(bytes([m.VERSION]) + b"\x90" * m.SHORT, kind)
    assert not decoded
    m.decode(bytes([m.VERSION]) + b"\x90" * (m.SHORT - 1), kind)
    assert decoded


def test_the_longest_request_of_this_program_is_short() -> None:
    longest = "\N{GRINNING FACE}" * 4096
    for request, kind in ((m.Take(longest), m.LeaseRequest), (m.StopRequest(longest), m.Question)):
        assert m.decode(m.encode(request), kind) == request
