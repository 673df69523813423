"""What every test shares: a clean environment, property-test profiles, and no thread left behind."""

from __future__ import annotations

import atexit
import gc
import os
import shutil
import signal
import stat
import tempfile
import threading
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from tests.strangers import BelongsTo
from tests.threads import left_behind

# Programs that tests start with the system's Python, for its rospy: nothing that pytest could import here.
collect_ignore = ["bench/ros1_client.py", "ros1/ros_client.py"]

# The user's own settings (HEXWIRE_PORT and the like) must not steer a test.
for _name in [name for name in os.environ if name.startswith("HEXWIRE_")]:
    del os.environ[_name]

# Nor may stops that this user's programs have made, nor tests leave any behind.
os.environ["XDG_RUNTIME_DIR"] = tempfile.mkdtemp(prefix="hexwire-tests-")
# Nor are this user's saved poses read or changed.
os.environ["XDG_CONFIG_HOME"] = os.environ["XDG_RUNTIME_DIR"]
atexit.register(shutil.rmtree, os.environ["XDG_RUNTIME_DIR"], ignore_errors=True)

# No deadlines: a loaded machine is not a fault of the code. `make test` draws the same examples every time ("ci"),
# so that a failure belongs to the change that it meets. Fifty of them are enough; pytest alone draws 100 new ones.
_quiet = {"deadline": None, "suppress_health_check": [HealthCheck.too_slow], "print_blob": True}
settings.register_profile("default", max_examples=100, **_quiet)
settings.register_profile("ci", max_examples=50, derandomize=True, database=None, **_quiet)
settings.register_profile("thorough", max_examples=5000, **_quiet)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci" if os.environ.get("CI") else "default"))


# A shell ignores Ctrl-C for what it starts in the background, and so would every program that a test starts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_xdist_auto_num_workers() -> int:
    """Two workers for each processor: half of the time the tests wait for a process, a line or a servo."""
    return 2 * len(os.sched_getaffinity(0))


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Let the garbage collector leave alone what is collected here: it stays to the end, and is large."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with what takes longest."""
    items.sort(key=lambda item: item.get_closest_marker("long") is None)


@pytest.hookimpl(wrapper=True)
def pytest_report_to_serializable() -> Generator[None, Any, Any]:
    """Escape what UTF-8 cannot encode: a worker of xdist that reports such a text ends the whole run."""
    return _encodable((yield))


def _encodable(value: Any) -> Any:
    if isinstance(value, str):
        return value if value.isascii() else value.encode("utf-8", "backslashreplace").decode()
    if isinstance(value, dict):
        return {_encodable(key): _encodable(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(_encodable(each) for each in value)
    return value


@pytest.fixture
def belongs_to(monkeypatch: pytest.MonkeyPatch) -> BelongsTo:
    """Makes what is at a path look as if it were another user's: a test cannot become one."""
    owners: dict[tuple[int, int], int] = {}

    def with_owner(result: os.stat_result) -> os.stat_result:
        uid = owners.get((result.st_dev, result.st_ino))
        fields = list(result)
        if uid is not None:
            fields[stat.ST_UID] = uid
        return os.stat_result(fields)

    real_stat, real_fstat = os.stat, os.fstat

    def look(*args: Any, **options: Any) -> os.stat_result:
        return with_owner(real_stat(*args, **options))

    def look_at_open(fd: int) -> os.stat_result:
        return with_owner(real_fstat(fd))

    monkeypatch.setattr(os, "stat", look)
    monkeypatch.setattr(os, "fstat", look_at_open)

    def say(path: Path, uid: int) -> None:
        found = real_stat(path, follow_symlinks=False)
        owners[found.st_dev, found.st_ino] = uid

    return say


@pytest.fixture(autouse=True)
def _no_thread_left() -> Iterator[None]:
    """Fail a test whose threads outlive it; those of wider fixtures are there before and do not count."""
    before = set(threading.enumerate())
    yield
    assert not (left := left_behind(before)), f"threads left behind: {left}"
