from __future__ import annotations

import errno
import fcntl
import os
import struct
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from far_ends import PtyEnd, take_over

from hexwire.errors import (
    LinkBusyError,
    LinkError,
    LinkLostError,
    LinkNotFoundError,
    LinkPermissionError,
    LinkTimeoutError,
    UsageError,
)
from hexwire.link import port_identity, serial_port
from hexwire.link import serial as serial_module
from hexwire.link.base import Link
from hexwire.link.serial import SerialLink, terminal_rate
from hexwire.testing.link import ALL_BYTES, Background, LinkConformance, descriptors, read_bytes, soon


class TestSerial(LinkConformance):
    def make_pair(self, tmp_path: Path) -> tuple[Link, Link]:
        path = tmp_path / "ttyUSB0"
        return SerialLink(str(path)), PtyEnd(path)

    def second_owner(self, near: Link) -> Link:
        assert isinstance(near, SerialLink)
        return SerialLink(near.device)


@pytest.fixture
def line(tmp_path: Path) -> Iterator[PtyEnd]:
    with PtyEnd(tmp_path / "ttyUSB0") as end:
        yield end


@pytest.fixture
def device(line: PtyEnd, tmp_path: Path) -> str:
    return str(tmp_path / "ttyUSB0")


def test_a_terminal_can_be_opened_again_by_who_is_not_root(line: PtyEnd, device: str) -> None:
    # The system lets root open one that is shut, so root's tests would never see it.
    with SerialLink(device):
        pass
    terminal = os.open(device, os.O_RDWR | os.O_NOCTTY)
    try:
        (shut,) = struct.unpack("i", fcntl.ioctl(terminal, 0x80045440, bytes(4)))  # TIOCGEXCL
    finally:
        os.close(terminal)
    assert shut == 0


# --- raw mode -----------------------------------------------------------------------------------------


def test_nothing_is_translated_or_echoed(line: PtyEnd, device: str) -> None:
    # A terminal in its usual mode: line editing, echo, CR to NL, XON/XOFF.
    cooked = os.open(device, os.O_RDWR | os.O_NOCTTY)
    settings = termios.tcgetattr(cooked)
    settings[0] |= termios.ICRNL | termios.IXON | termios.ISTRIP | termios.PARMRK | termios.INLCR
    settings[1] |= termios.OPOST | termios.ONLCR
    settings[3] |= termios.ICANON | termios.ECHO | termios.ISIG
    termios.tcsetattr(cooked, termios.TCSANOW, settings)
    os.close(cooked)
    with SerialLink(device) as port:
        line.write(ALL_BYTES, soon())
        assert read_bytes(port, 256) == ALL_BYTES
        port.write(ALL_BYTES, soon())
        assert read_bytes(line, 256) == ALL_BYTES
        assert line.read(time.monotonic() + 0.05) == b""
        now = termios.tcgetattr(port.fileno())
        assert now[0] == now[1] == now[3] == 0
        assert now[2] & termios.CSIZE == termios.CS8
        assert now[2] & termios.CLOCAL
        assert not now[2] & (termios.HUPCL | termios.PARENB | termios.CSTOPB | termios.CRTSCTS)


@pytest.mark.parametrize("baud", [9600, 57600, 115200, 1_000_000, 250_000, 12_345, 1_250_000])
def test_any_baud_rate_is_set_and_reads_back(line: PtyEnd, device: str, baud: int) -> None:
    with SerialLink(device, baud) as port:
        raw = fcntl.ioctl(port.fileno(), 0x802C542A, bytes(44))  # TCGETS2
        assert struct.unpack_from("=2I", raw, 36) == (baud, baud)
        assert terminal_rate(port.fileno()) == baud
        port.write(b"x", soon())
        assert line.read(soon()) == b"x"


def test_a_rate_that_the_port_does_not_make_is_an_error(
    line: PtyEnd, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SerialLink, "_actual_baud", lambda self: 9600)
    with pytest.raises(UsageError, match=r"cannot do 250000 baud \(it chose 9600\): use 115200"):
        SerialLink(device, 250_000).open()
    monkeypatch.setattr(SerialLink, "_actual_baud", lambda self: 254_000)
    with SerialLink(device, 250_000) as port:  # 1.6 % off is still within a receiver's reach
        assert port.is_open


def test_a_system_without_odd_rates_says_so(line: PtyEnd, device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(self: SerialLink, request: int, size: int) -> bytes:
        raise OSError(errno.ENOTTY, "Inappropriate ioctl for device")

    monkeypatch.setattr(SerialLink, "_ioctl_read", refuse)
    with pytest.raises(UsageError, match="only the usual rates"):
        SerialLink(device, 12_345).open()
    with SerialLink(device, 57600) as port:
        assert termios.tcgetattr(port.fileno())[4] == termios.B57600


@pytest.mark.parametrize("baud", [0, -1, 49, 12_000_001])
def test_a_senseless_baud_rate_is_refused_before_opening(baud: int) -> None:
    with pytest.raises(UsageError, match="baud must be from 50"):
        SerialLink("/dev/ttyUSB0", baud)


def test_a_port_that_keeps_its_own_settings_is_refused(
    line: PtyEnd, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = termios.tcgetattr
    monkeypatch.setattr(termios, "tcgetattr", lambda fd: [termios.ICRNL, *real(fd)[1:]])
    with pytest.raises(LinkError, match="refuses raw mode"):
        SerialLink(device).open()


def test_settings_that_fail_are_reported(line: PtyEnd, device: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise termios.error(errno.EIO, "Input/output error")

    monkeypatch.setattr(termios, "tcsetattr", fail)
    with pytest.raises(LinkLostError, match=r"does not accept its settings \(Input/output error\)"):
        SerialLink(device).open()


def test_the_rate_of_an_open_port_can_be_changed(
    line: PtyEnd, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    port = SerialLink(device)
    port.set_baud(57600)
    with port:
        for baud in (1_000_000, 12_345):
            port.set_baud(baud)
            assert struct.unpack_from("=2I", fcntl.ioctl(port.fileno(), 0x802C542A, bytes(44)), 36) == (baud, baud)
            assert (port.baud, port.url) == (baud, f"serial://{device}?baud={baud}")
            line.write(b"x", soon())
            assert port.read(soon()) == b"x"
        with pytest.raises(UsageError, match="baud must be from 50"):
            port.set_baud(1)
        line.close()
        with pytest.raises(LinkLostError, match="unplugged"):
            port.set_baud(9600)


# --- one owner ----------------------------------------------------------------------------------------

OTHER_PROGRAM = """
import sys
from hexwire.link.serial import SerialLink
port = SerialLink(sys.argv[1])
port.open()
print("open", flush=True)
sys.stdin.read()
"""


def test_two_programs_on_one_port(line: PtyEnd, device: str) -> None:
    command = [sys.executable, "-c", OTHER_PROGRAM, device]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        try:
            assert other.stdout is not None
            assert other.stdout.readline() == "open\n"
            with pytest.raises(LinkBusyError) as caught:
                SerialLink(device).open()
            name = Path(f"/proc/{other.pid}/comm").read_text().strip()
            assert str(caught.value) == f"{device} is in use by {name} (pid {other.pid}): close that first"
        finally:
            other.communicate()
    with SerialLink(device) as port:
        assert port.is_open


def test_a_port_that_another_program_took_for_itself(
    line: PtyEnd, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> int:
        raise OSError(errno.EBUSY, "Device or resource busy")

    monkeypatch.setattr(serial_module.os, "open", refuse)
    monkeypatch.setattr(serial_port.owner, "device_owner", lambda device: "")
    with pytest.raises(LinkBusyError, match="in use by another program: close that first"):
        SerialLink(device).open()


# --- errors a person meets --------------------------------------------------------------------------------


def test_no_such_port_lists_those_there_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serial_port.ports, "ports_in_words", lambda: "ports here: /dev/ttyACM0 (Mega)")
    with pytest.raises(LinkNotFoundError) as caught:
        SerialLink(str(tmp_path / "ttyUSB7")).open()
    assert str(caught.value) == f"{tmp_path}/ttyUSB7 does not exist; ports here: /dev/ttyACM0 (Mega)"
    assert caught.value.url.startswith("serial://")


@pytest.mark.parametrize("path", ["/dev/null", "/tmp", "{tmp}/plain"])
def test_a_device_that_is_not_a_serial_port_is_refused(path: str, tmp_path: Path) -> None:
    (tmp_path / "plain").write_bytes(b"text")
    before = descriptors()
    with pytest.raises(LinkNotFoundError, match="is not a serial port"):
        SerialLink(path.format(tmp=tmp_path)).open()
    assert descriptors() <= before
    assert (tmp_path / "plain").read_bytes() == b"text"


@pytest.mark.parametrize("number", [errno.ENXIO, errno.ENODEV, errno.ENOTDIR])
def test_a_node_without_a_device(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> int:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(serial_module.os, "open", refuse)
    with pytest.raises(LinkNotFoundError, match="has no device behind it"):
        SerialLink("/dev/ttyUSB0").open()


def test_any_other_fault_of_opening_is_a_link_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> int:
        raise OSError(errno.ENFILE, "Too many open files in system")

    monkeypatch.setattr(serial_module.os, "open", refuse)
    with pytest.raises(LinkError, match="/dev/ttyUSB0 cannot be opened: Too many open files in system"):
        SerialLink("/dev/ttyUSB0").open()


def _deny(*_: object) -> int:
    raise PermissionError(errno.EACCES, "Permission denied")


class _Status:
    st_uid = 0
    st_gid = 20
    st_mode = 0o020660


def test_no_permission_names_the_group_and_the_remedy(monkeypatch: pytest.MonkeyPatch) -> None:
    import grp

    monkeypatch.setattr(serial_module.os, "open", _deny)
    monkeypatch.setattr(serial_port.Path, "stat", lambda self: _Status())
    monkeypatch.setattr(grp, "getgrgid", lambda gid: grp.struct_group(("dialout", "x", gid, [])))
    with pytest.raises(LinkPermissionError) as caught:
        SerialLink("/dev/ttyUSB0").open()
    assert str(caught.value) == (
        "no permission for /dev/ttyUSB0: it belongs to group dialout; run 'sudo usermod -aG dialout $USER', "
        "then log out and in again"
    )


def test_no_permission_where_no_group_helps(monkeypatch: pytest.MonkeyPatch) -> None:
    import grp

    monkeypatch.setattr(serial_module.os, "open", _deny)
    monkeypatch.setattr(serial_port.Path, "stat", lambda self: _Status())
    monkeypatch.setattr(grp, "getgrgid", lambda gid: grp.struct_group(("root", "x", gid, [])))
    with pytest.raises(LinkPermissionError, match="belongs to root alone; add a udev rule"):
        SerialLink("/dev/ttyUSB0").open()


def test_no_permission_without_a_known_cause(monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(gid: int) -> object:
        raise KeyError(gid)

    import grp

    monkeypatch.setattr(serial_module.os, "open", _deny)
    monkeypatch.setattr(serial_port.Path, "stat", lambda self: _Status())
    monkeypatch.setattr(grp, "getgrgid", unknown)
    with pytest.raises(LinkPermissionError, match="ask the owner of this machine"):
        SerialLink("/dev/ttyUSB0").open()


# --- unplugging and plugging in again ---------------------------------------------------------------------


def test_unplugged_says_what_to_do(line: PtyEnd, device: str) -> None:
    with SerialLink(device) as port:
        reader = Background(lambda: port.read(None))
        reader.let_it_block()
        line.close()
        with pytest.raises(LinkLostError) as caught:
            reader.outcome()
        assert str(caught.value) == f"{device} went away; was it unplugged?"
        # While it is out, opening says that it is not there; when it is back behind its name, all is well.
        port.close()
        with pytest.raises(LinkNotFoundError, match="does not exist"):
            port.open()
        line.open()
        port.open()
        line.write(b"back", soon())
        assert read_bytes(port, 4) == b"back"


def test_unplugged_while_writing(line: PtyEnd, device: str) -> None:
    with SerialLink(device) as port:
        line.close()
        with pytest.raises(LinkLostError, match="unplugged"):
            port.write(b"x", soon())
        with pytest.raises(LinkLostError, match="unplugged"):
            port.read(soon())


def test_unplugged_while_a_write_waits(line: PtyEnd, device: str) -> None:
    with SerialLink(device) as port:
        writer = Background(lambda: port.write(bytes(1_000_000), None))
        writer.let_it_block()
        line.close()
        with pytest.raises(LinkLostError):
            writer.outcome()


def test_a_lost_port_opens_again_without_closing(line: PtyEnd, device: str) -> None:
    port = SerialLink(device)
    port.open()
    line.close()
    with pytest.raises(LinkLostError):
        port.read(soon())
    line.open()
    port.open()
    port.write(b"x", soon())
    assert line.read(soon()) == b"x"
    port.close()


def test_a_line_that_nobody_reads_says_how_much_it_took(line: PtyEnd, device: str) -> None:
    with (
        SerialLink(device) as port,
        pytest.raises(LinkTimeoutError, match=r"took \d+ of 1000000 bytes in time"),
    ):
        port.write(bytes(1_000_000), time.monotonic() + 1.0)


# --- reset and latency ------------------------------------------------------------------------------------


def test_reset_pulses_dtr_and_drops_what_came_before(
    line: PtyEnd, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[tuple[int, bytes]] = []
    real = fcntl.ioctl

    def record(fd: int, request: int, *rest: object) -> object:
        if request in (termios.TIOCMBIC, termios.TIOCMBIS):
            calls.append((request, rest[0]))  # type: ignore[arg-type]  # a pseudo-terminal has no such line
            return rest[0]
        return real(fd, request, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(serial_module.fcntl, "ioctl", record)
    with SerialLink(device) as port:
        assert calls == [], "opening leaves the line as the kernel sets it"
        line.write(b"boot noise", soon())
        TestSerial().wait_readable(port)
        port.reset()
        dtr = struct.pack("I", termios.TIOCM_DTR)
        assert calls == [(termios.TIOCMBIC, dtr), (termios.TIOCMBIS, dtr)]
        line.write(b"x", soon())
        assert port.read(soon()) == b"x"
    calls.clear()
    with SerialLink(device, reset_board=True):
        assert [request for request, _ in calls] == [termios.TIOCMBIC, termios.TIOCMBIS]


def test_reset_without_such_a_line_does_nothing(line: PtyEnd, device: str) -> None:
    with SerialLink(device, reset_board=True) as port:
        assert port.is_open


def test_low_latency_is_asked_for_once_and_optional(
    line: PtyEnd, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    flags: list[int] = []
    real = fcntl.ioctl

    def driver(fd: int, request: int, *rest: object) -> object:
        if request == termios.TIOCGSERIAL:
            rest[0][4] = 0x10  # type: ignore[index]  # a flag of the driver's own
            return 0
        if request == termios.TIOCSSERIAL:
            flags.append(rest[0][4])  # type: ignore[index]
            return 0
        return real(fd, request, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(serial_module.fcntl, "ioctl", driver)
    with SerialLink(device):
        assert flags == [0x2010]
    with SerialLink(device, low_latency=False):
        assert flags == [0x2010]


# --- whether it is the port that was meant ------------------------------------------------------------


@pytest.fixture
def taken_over(tmp_path: Path) -> Iterator[tuple[str, int, int]]:
    """A link that an emulator left behind, and the terminal that has its number now: link, master, slave."""
    link = tmp_path / "arm"

    def leave_one_behind() -> str:
        master, slave = os.openpty()
        name = os.ttyname(slave)
        link.unlink(missing_ok=True)
        link.symlink_to(name)
        os.close(master)
        os.close(slave)
        return name

    opened = take_over(leave_one_behind)
    yield str(link), opened[-2], opened[-1]
    for fd in opened:
        os.close(fd)


def test_nothing_is_written_to_a_terminal_that_took_over_the_number(taken_over: tuple[str, int, int]) -> None:
    device, master, slave = taken_over
    before = termios.tcgetattr(slave)
    link = SerialLink(device)
    with pytest.raises(LinkNotFoundError) as caught:
        link.open()
    assert str(caught.value).startswith(
        f"{device} is stale: the terminal it leads to was created after the link {device}"
    )
    assert str(caught.value).endswith("recreate the link; nothing was written to it")
    assert "\n" not in str(caught.value)
    assert not link.is_open
    os.set_blocking(master, False)
    with pytest.raises(BlockingIOError):
        os.read(master, 1)
    assert termios.tcgetattr(slave) == before
    os.close(os.open(device, os.O_RDWR | os.O_NOCTTY))  # nor is it locked for others


def test_nor_when_the_line_is_opened_again_after_a_loss(tmp_path: Path) -> None:
    path = tmp_path / "arm"
    link = SerialLink(str(path))

    def lose_it() -> str:
        path.unlink(missing_ok=True)
        with PtyEnd(path) as far, link:
            name = str(path.readlink())
            far.write(b"x", soon())
            assert link.read(soon()) == b"x"
            far.close()
            with pytest.raises(LinkLostError):
                link.read(soon())
        path.symlink_to(name)  # as one that was killed leaves it
        return name

    opened = take_over(lose_it)
    try:
        with pytest.raises(LinkNotFoundError, match="is stale"):
            link.open()
    finally:
        for fd in opened:
            os.close(fd)
    path.unlink()
    with PtyEnd(path), link:  # the emulator was started anew, with its link
        assert link.is_open


def test_a_terminal_that_somebody_works_at_is_left_alone(tmp_path: Path) -> None:
    master, slave = os.openpty()
    name = os.ttyname(slave)
    before = termios.tcgetattr(slave)
    (tmp_path / "arm").symlink_to(name)
    code = "import os, sys; os.open(sys.argv[1], os.O_RDWR); print('ready', flush=True); sys.stdin.read()"
    try:
        with subprocess.Popen(
            [sys.executable, "-c", code, name],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
        ) as shell:
            assert shell.stdout is not None
            assert shell.stdout.readline() == b"ready\n"
            for device in (name, str(tmp_path / "arm")):
                with pytest.raises(
                    LinkNotFoundError, match=rf"is the terminal that .* \(pid {shell.pid}\) runs in"
                ):
                    SerialLink(device).open()
            assert termios.tcgetattr(slave) == before
            os.set_blocking(master, False)
            with pytest.raises(BlockingIOError):
                os.read(master, 1)
            shell.communicate(b"")
    finally:
        os.close(master)
        os.close(slave)


def test_another_usb_device_under_the_same_name_is_not_adopted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(port_identity, "_SYSFS", tmp_path / "char")
    monkeypatch.setattr(port_identity, "PTS_MAJORS", range(0))
    path = tmp_path / "ttyACM0"

    def plug_in(serial: str) -> PtyEnd:
        end = PtyEnd(path)
        end.open()
        number = path.stat().st_rdev
        folder = tmp_path / "char" / f"{os.major(number)}:{os.minor(number)}" / "device"
        folder.mkdir(parents=True, exist_ok=True)
        for file, text in (("idVendor", "2341"), ("idProduct", "0042"), ("serial", serial)):
            (folder / file).write_text(text + "\n")
        return end

    link = SerialLink(str(path))
    for serial in ("A1", "A1"):
        board = plug_in(serial)
        link.open()
        board.close()
        with pytest.raises(LinkLostError):
            link.read(soon())
        link.close()
    board = plug_in("B2")
    with pytest.raises(LinkNotFoundError) as caught:
        link.open()
    assert str(caught.value) == (
        f"{path} is another device now: 2341:0042 with serial number B2 instead of 2341:0042 with serial number "
        "A1; nothing was written to it"
    )
    with SerialLink(str(path)) as fresh:  # who means the new one says so by asking for it
        assert fresh.is_open
    board.close()
