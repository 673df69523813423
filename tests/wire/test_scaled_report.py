"""The shortcut gives what the long way gives, or steps aside."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexwire.errors import RemoteProtocolError
from hexwire.wire.commands import JointReport
from hexwire.wire.scaled_report import ReportScaler

N = 7
FACTORS = {
    "speed": tuple(0.5 + i for i in range(N)),
    "load": tuple(-0.001 * i for i in range(N)),
    "voltage": (0.1,) * N,
    "temperature": (1.0,) * N,
    "current": tuple(0.001 * (i + 1) for i in range(N)),
}
AGE = 0.001


def column(low: int, high: int, n: int = N) -> st.SearchStrategy[tuple[int, ...]]:
    return st.lists(st.integers(low, high), min_size=n, max_size=n).map(tuple)


REPORTS = st.builds(
    JointReport,
    st.integers(0, 2**32 - 1),
    st.integers(0, 255),
    column(-32768, 32767),
    column(0, 255),
    column(-32768, 32767),
    column(-32768, 32767),
    column(0, 255),
    column(-128, 127),
    column(-32768, 32767),
    column(0, 65535),
)


@given(REPORTS)
def test_it_gives_the_same_as_the_full_parser_times_the_factors(report: JointReport) -> None:
    read = ReportScaler(**FACTORS, age=AGE).parse(report.serialize())
    assert read is not None
    time_us, flags, columns = read
    assert (time_us, flags) == (report.time_us, report.board_flags)
    assert columns[0] == report.position
    assert columns[1] == report.status
    for got, name in zip(columns[2:7], ("speed", "load", "voltage", "temperature", "current"), strict=True):
        raw = getattr(report, name)
        assert got == tuple(a * b for a, b in zip(raw, FACTORS[name], strict=True))
    assert report.age is not None
    assert columns[7] == tuple(a * AGE for a in report.age)


@given(st.binary(max_size=200))
def test_any_other_body_is_left_to_the_full_parser(body: bytes) -> None:
    scaler = ReportScaler(**FACTORS, age=AGE)
    read = scaler.parse(body)
    if read is not None:
        assert len(body) == scaler.size
        assert JointReport.parse(body).position == read[2][0]


def test_fewer_fields_and_other_numbers_of_joints_step_aside() -> None:
    scaler = ReportScaler(**FACTORS, age=AGE)
    short = JointReport(0, 0, (1,) * N, (0,) * N, speed=(1,) * N)
    assert scaler.parse(short.serialize()) is None
    six = JointReport(0, 0, *([(1,) * 6] * 8))
    assert scaler.parse(six.serialize()) is None
    full = bytearray(JointReport(0, 0, *([(1,) * N] * 8)).serialize())
    full[6] = 6
    assert scaler.parse(bytes(full)) is None
    with pytest.raises(RemoteProtocolError):
        JointReport.parse(bytes(full))
