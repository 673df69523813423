"""Traffic as a file in memory: a recording (MCAP) or a capture for Wireshark (pcapng).

Owns which formats there are and their times. Must not know where the bytes go.
"""

from __future__ import annotations

import io
import tempfile
from collections.abc import Iterable
from pathlib import Path

from hexwire.errors import UsageError
from hexwire.link.tap import Passed

from .capture import Capture
from .pcap import write_pcapng

__all__ = ["FORMATS", "saved_traffic"]

FORMATS = ("mcap", "pcapng")


def saved_traffic(traffic: Iterable[Passed], form: str, *, offset: float = 0.0) -> bytes:
    """A file of this traffic.

    Args:
        traffic: The transfers, in order.
        form: One of `FORMATS`.
        offset: Seconds to add to their times for seconds since 1970.

    Raises:
        UsageError: There is no traffic, it is not such a format, or the package ``mcap`` is not installed.
    """
    kept = list(traffic)
    if form not in FORMATS:
        raise UsageError(f"traffic is saved as {' or '.join(FORMATS)}, not as {form[:20]!r}")
    if not kept:
        raise UsageError("there is no traffic to save yet")
    if form == "pcapng":
        file = io.BytesIO()
        write_pcapng(file, (each._replace(time=each.time + offset) for each in kept), name="hexwire")
        return file.getvalue()
    with tempfile.TemporaryDirectory(prefix="hexwire-") as folder:
        path = Path(folder) / "traffic.mcap"
        with Capture(path, offset=offset) as capture:
            for each in kept:
                capture.passed(each)
        return path.read_bytes()
