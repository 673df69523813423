from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from far_ends import take_over

from hexwire.link import port_identity
from hexwire.link.port_identity import PortIdentity, UsbDevice, identify_port, why_not, why_not_again

ME = os.geteuid()
SOMEBODY = ME + 4711
MEGA, UNO = UsbDevice("2341", "0042", "A1"), UsbDevice("2341", "0043", "")
TERMINAL = PortIdentity(os.makedev(136, 4000), None, True, 5_000_000_001, ME)
LINKED = replace(TERMINAL, link="/tmp/arm", link_made=5_000_000_002, link_owner=ME)
SERIAL = PortIdentity(os.makedev(4, 64 + 200), None, False, 0, 0)


@pytest.fixture
def pty() -> Iterator[tuple[int, int]]:
    master, slave = os.openpty()
    yield master, slave
    os.close(master)
    os.close(slave)


def test_a_terminal_is_known_by_its_number_and_age_and_the_link_to_it(pty: tuple[int, int], tmp_path: Path) -> None:
    _, slave = pty
    name = os.ttyname(slave)
    bare = identify_port(name, os.fstat(slave))
    status = os.fstat(slave)
    assert bare == PortIdentity(status.st_rdev, None, True, status.st_ctime_ns, ME, among=status.st_dev)
    (tmp_path / "tty").symlink_to(name)
    (tmp_path / "arm").symlink_to("tty")
    linked = identify_port(str(tmp_path / "arm"), os.fstat(slave))
    assert (linked.link, linked.link_owner) == (str(tmp_path / "tty"), ME)
    assert linked.link_made == (tmp_path / "tty").lstat().st_mtime_ns >= linked.made
    assert why_not(bare) == why_not(linked) == ""
    os.write(slave, b"x")
    assert identify_port(name, os.fstat(slave)) == bare, "what goes over it does not make it younger"


def test_a_name_that_leads_elsewhere_meanwhile_is_no_port(pty: tuple[int, int], tmp_path: Path) -> None:
    other, there = os.openpty()
    try:
        (tmp_path / "arm").symlink_to(os.ttyname(there))
        with pytest.raises(OSError, match="elsewhere"):
            identify_port(str(tmp_path / "arm"), os.fstat(pty[1]))
    finally:
        os.close(other)
        os.close(there)


@pytest.mark.parametrize("shared", [False, True])
def test_a_link_that_another_user_put_into_a_shared_folder_is_not_followed(
    shared: bool, pty: tuple[int, int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the kernel follows it, as with fs.protected_symlinks=0; his own terminal may stand behind it."""
    folder = tmp_path / "folder"
    folder.mkdir()
    folder.chmod(0o1777 if shared else 0o755)
    link, mine = folder / "arm", tmp_path / "mine"
    link.symlink_to(os.ttyname(pty[1]))
    mine.symlink_to(link)
    real = os.stat

    def look(path: Any, **options: Any) -> Any:
        found = real(path, **options)
        if str(path) != str(link) or options.get("follow_symlinks", True):
            return found
        fields = {name: getattr(found, name) for name in dir(found) if name.startswith("st_")}
        return SimpleNamespace(**fields | {"st_uid": SOMEBODY})

    monkeypatch.setattr(os, "stat", look)
    status = os.fstat(pty[1])
    by_name, by_mine = identify_port(str(link), status), identify_port(str(mine), status)
    assert by_name.link_owner == SOMEBODY
    if shared:
        for port in (by_name, by_mine, replace(by_name, owner=SOMEBODY)):
            assert why_not(port) == (
                f"is reached by the link {link}, which user {SOMEBODY} has placed in a folder that everybody may "
                "write to; use the port's own name"
            )
    else:
        assert why_not(replace(by_name, owner=SOMEBODY)) == ""


def test_links_in_a_circle_end(pty: tuple[int, int], tmp_path: Path) -> None:
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    with pytest.raises(OSError, match="symbolic links"):
        identify_port(str(tmp_path / "a"), os.fstat(pty[1]))


def test_a_terminal_that_a_program_runs_in_is_no_robot(pty: tuple[int, int]) -> None:
    _, slave = pty
    name = os.ttyname(slave)
    # Whoever leads a session and opens a terminal has it for his own, as a shell does.
    code = "import os, sys; os.open(sys.argv[1], os.O_RDWR); print('ready', flush=True); sys.stdin.read()"
    with subprocess.Popen(
        [sys.executable, "-c", code, name], stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
    ) as shell:
        assert shell.stdout is not None
        assert shell.stdout.readline() == b"ready\n"
        problem = why_not(identify_port(name, os.fstat(slave)))
        assert problem.startswith("is the terminal that ")
        assert problem.endswith(f"(pid {shell.pid}) runs in, not a robot")
        shell.communicate(b"")
    assert why_not(identify_port(name, os.fstat(slave))) == ""


def test_our_own_terminal_by_its_other_name() -> None:
    own = PortIdentity(os.makedev(5, 0), None, False, 0, 0)
    assert why_not(own) == "is the terminal that this program runs in"


@pytest.mark.parametrize(
    ("port", "words"),
    [
        (LINKED, ""),
        (replace(LINKED, link_made=5_000_000_001), ""),
        (
            replace(LINKED, link_made=4_999_999_999),
            "is stale: the terminal it leads to was created after the link /tmp/arm",
        ),
        (replace(LINKED, link_made=4_000_000_000), ""),  # a file system of whole seconds
        (replace(LINKED, link_made=2_000_000_000), "is stale"),
        (replace(LINKED, owner=SOMEBODY), f"leads to a terminal of user {SOMEBODY}, but "),
        (replace(LINKED, owner=SOMEBODY, link_owner=SOMEBODY), ""),
        (SERIAL, ""),
    ],
)
def test_signs_that_a_port_is_not_the_device(port: PortIdentity, words: str) -> None:
    problem = why_not(port)
    assert problem.startswith(words)
    assert bool(problem) == bool(words)


def test_a_bare_terminal_of_another_user(monkeypatch: pytest.MonkeyPatch) -> None:
    theirs = replace(TERMINAL, owner=SOMEBODY)
    monkeypatch.setattr(os, "geteuid", lambda: 1000 if SOMEBODY != 1000 else 1001)
    assert why_not(theirs) == f"is a terminal of user {SOMEBODY}"
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    assert why_not(theirs) == ""


@pytest.mark.parametrize(
    ("before", "now", "words"),
    [
        (replace(SERIAL, usb=MEGA), replace(SERIAL, usb=MEGA, device=os.makedev(188, 1)), ""),
        (
            replace(SERIAL, usb=MEGA),
            replace(SERIAL, usb=replace(MEGA, serial="B2")),
            "is another device now: 2341:0042 with serial number B2 instead of 2341:0042 with serial number A1",
        ),
        (
            replace(SERIAL, usb=UNO),
            replace(SERIAL, usb=MEGA),
            "is another device now: 2341:0042 with serial number A1 instead of 2341:0043",
        ),
        (replace(SERIAL, usb=MEGA), SERIAL, "is another device now"),
        (SERIAL, SERIAL, ""),
        (SERIAL, replace(SERIAL, device=os.makedev(4, 65)), "is another device now"),
        (replace(SERIAL, usb=MEGA), LINKED, "is another device now"),
        (LINKED, replace(LINKED, device=os.makedev(136, 5), made=6, link_made=7), ""),
        (LINKED, replace(LINKED, owner=SOMEBODY, link_owner=SOMEBODY), f"belongs to user {SOMEBODY} now"),
        (TERMINAL, TERMINAL, ""),
        (TERMINAL, replace(TERMINAL, made=9), "is another terminal now"),
    ],
)
def test_whether_it_is_the_port_that_was_here_before(before: PortIdentity, now: PortIdentity, words: str) -> None:
    assert why_not_again(before, now) == words or (words and why_not_again(before, now).startswith(words + ":"))


def test_a_usb_device_is_known_by_what_the_system_keeps_of_it(
    pty: tuple[int, int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(port_identity, "_SYSFS", tmp_path / "char")
    monkeypatch.setattr(port_identity, "PTS_MAJORS", range(0))
    status = os.fstat(pty[1])
    device = tmp_path / "devices" / "usb1" / "1-2"
    tty = device / "1-2:1.0" / "ttyACM0"
    tty.mkdir(parents=True)
    entry = tmp_path / "char" / f"{os.major(status.st_rdev)}:{os.minor(status.st_rdev)}"
    entry.mkdir(parents=True)
    (entry / "device").symlink_to(tty)
    name = os.ttyname(pty[1])
    assert identify_port(name, status).usb is None
    (device / "idVendor").write_text("2341\n")
    (device / "idProduct").write_text("0042\n")
    assert identify_port(name, status).usb == UsbDevice("2341", "0042", "")
    (device / "serial").write_text("A1\n")
    assert identify_port(name, status).usb == MEGA


def test_processes_that_go_or_cannot_be_read_are_passed_over(
    pty: tuple[int, int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(port_identity, "_PROC", tmp_path)
    for pid, text in (("1", None), ("2", "2 (x"), ("3", "3 (a) b) S 1 2 3 x"), ("4", "4 (sh) S 1")):
        (tmp_path / pid).mkdir()
        if text is not None:
            (tmp_path / pid / "stat").write_text(text)
    port = identify_port(os.ttyname(pty[1]), os.fstat(pty[1]))
    assert why_not(port) == ""
    minor = os.minor(port.device)
    number = (minor & 0xFF) | os.major(port.device) << 8 | (minor & ~0xFF) << 12
    (tmp_path / "5").mkdir()
    (tmp_path / "5" / "stat").write_text(f"5 (a (b) c) S 1 5 5 {number} 5 0\n")
    assert why_not(port) == "is the terminal that a (b) c (pid 5) runs in, not a robot"
    # Its terminals may be those of a container, which have the same numbers.
    (tmp_path / "5" / "root" / "dev" / "pts").mkdir(parents=True)
    (tmp_path / "5" / "root" / "dev" / "pts" / "ptmx").symlink_to("/dev/pts/ptmx")
    assert why_not(port) != ""
    assert why_not(replace(port, among=port.among + 1)) == ""
    (tmp_path / "5" / "fd").mkdir()
    (tmp_path / "5" / "fd" / "0").symlink_to(os.ttyname(pty[1]))
    assert why_not(port) != ""
    assert why_not(replace(port, among=port.among + 1)) == ""
    # One's own counts where the port is a pseudo-terminal, not where one opened a port without care.
    (tmp_path / "5").rename(tmp_path / str(os.getpid()))
    assert why_not(port) != ""
    assert why_not(replace(port, terminal=False)) == ""


def test_another_terminal_of_that_name_is_younger() -> None:
    """What the checks rest on: a pseudo-terminal that takes a number over does not take its time over."""
    made = 0

    def leave_one_behind() -> str:
        nonlocal made
        master, slave = os.openpty()
        name, made = os.ttyname(slave), os.fstat(slave).st_ctime_ns
        os.close(master)
        os.close(slave)
        return name

    opened = take_over(leave_one_behind)
    try:
        assert os.fstat(opened[-1]).st_ctime_ns > made
    finally:
        for fd in opened:
            os.close(fd)
