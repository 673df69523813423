from __future__ import annotations

import math
from pathlib import Path

from hexwire.link.adapter import inspect_adapter, set_latency


def _sysfs(tmp_path: Path, latency: str | None) -> Path:
    driver = tmp_path / "drivers" / "ftdi_sio"
    port = tmp_path / "devices" / "ttyUSB7"
    driver.mkdir(parents=True)
    port.mkdir(parents=True)
    (port / "driver").symlink_to(driver)
    if latency is not None:
        (port / "latency_timer").write_text(latency)
    return tmp_path / "devices"


def test_a_timer_is_set_low_where_the_system_lets_us(tmp_path: Path) -> None:
    sysfs = _sysfs(tmp_path, "16\n")
    report = inspect_adapter("/dev/ttyUSB7", sysfs=sysfs)
    assert (report.driver, report.latency_ms, report.advice) == ("ftdi_sio", 1, "")
    assert (sysfs / "ttyUSB7" / "latency_timer").read_text() == "1\n"


def test_a_timer_that_stays_is_reported_with_its_remedy(tmp_path: Path) -> None:
    sysfs = _sysfs(tmp_path, None)
    # What cannot be written, by root either: a folder whose file is a link to nowhere that may be made.
    timer = sysfs / "ttyUSB7" / "latency_timer"
    (tmp_path / "value").write_text("16\n")
    timer.symlink_to("/proc/self/limits")
    assert not set_latency("/dev/ttyUSB7", sysfs=sysfs)
    assert inspect_adapter("/dev/ttyUSB7", sysfs=sysfs).latency_ms is None
    timer.unlink()
    timer.symlink_to("/proc/sys/kernel/ngroups_max")
    report = inspect_adapter("/dev/ttyUSB7", sysfs=sysfs)
    assert report.latency_ms == 65536
    assert "latency_timer" in report.advice
    assert 'ATTR{latency_timer}="1"' in report.advice


def test_an_adapter_without_a_timer(tmp_path: Path) -> None:
    report = inspect_adapter("/dev/ttyACM3", sysfs=tmp_path)
    assert report.latency_ms is None
    assert report.advice == ""
    assert math.isnan(report.overhead)
    assert report.held_back is False
    held = inspect_adapter("/dev/ttyACM3", 0.0155, True, sysfs=tmp_path)
    assert (held.device, held.driver, held.overhead, held.held_back) == ("/dev/ttyACM3", "", 0.0155, True)
    assert "16 ms longer" in held.advice
