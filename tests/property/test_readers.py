"""Every reader of files, whatever the file holds: a value, or one error that names the file.

`NAMES` lists all of them, but for those of the kernel's own files and of open ports. A new reader belongs here, and
into the table of docs/files.md.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.recorded import make_positions

from hexwire.bus.backup import ServoBackup, load_backup, serialize_backups
from hexwire.cli.main import cli
from hexwire.drivers.arm_file import load_arm_file, load_calibration
from hexwire.drivers.firmware import source_version
from hexwire.errors import HexwireError
from hexwire.inputs import LARGEST_DATA, read_bytes, read_text
from hexwire.ipc.conf import load_conf
from hexwire.link.certs import issue_certificate, make_authority
from hexwire.link.tls import TlsFiles
from hexwire.model.calibration import Calibration, JointCalibration
from hexwire.model.geometry import make_kinematics
from hexwire.motion.waypoint_file import parse_waypoints
from hexwire.trace.explain import Explainer
from hexwire.trace.recording import RecordingWriter, read_joint_states
from hexwire.trace.sources import LARGEST, read_traffic


class Reader(NamedTuple):
    """How a file is read, what it is called, and a good one."""

    read: Callable[[Path], object]
    suffix: str
    good: bytes


ARM = b"""name = "bench"
baud = 1000000
[[joints]]
name = "J1"
servo_id = 1
series = "sts_sms"
minimum_deg = -90.0
maximum_deg = 90.0
gearing = 2.0
"""
LINKS = b"""name = "own"
a = 120
b = 40
c = 188
d = 24.28
e = 79
f = 121.6
g = 12
h = 34.8
offset = 90
elbow = [10, 165]
"""
CONF = b"""ARM_7BOT_SERIAL_TRX CLIENT_TRX ARM_7BOT_ARDUINO_TRX SERIAL /dev/ttyUSB0 115200
"""
CONF_TOML = b"""[[channel]]
module = "ARM_7BOT_SERIAL_TRX"
direction = "CLIENT_TRX"
destination = "ARM_7BOT_ARDUINO_TRX"
interface = "SERIAL"
address = "/dev/ttyUSB0"
baud = 115200
"""
WAYPOINTS = b"""{"joint_names": ["J1", "J2"], "points": [
 {"time_from_start": 0, "positions": [0.1, 0.2], "velocities": [0, 0], "accelerations": [0, 0]},
 {"time_from_start": {"secs": 1, "nsecs": 500}, "positions": [0.3, 0.2]}]}
"""
LEROBOT = b"""{"elbow": {"id": 3, "drive_mode": 0, "homing_offset": -20, "range_min": 100, "range_max": 4000}}
"""
LOG = b"""SerialPort sent - Length=8
FF FF 00 04 02 38 02 BF| / 8
1.5 SerialPort receive - Length=8
FF FF 00 04 00 05 08 EE|
"""


def _calibration() -> bytes:
    row = JointCalibration("J1", 1, 2000, 1000, 3000, -1, 5, "sts3215", "3.10")
    return Calibration("bench", "2026-01-02", (row,)).serialize().encode()


def _backup() -> bytes:
    backup = ServoBackup(1, "sts_sms", "3.10", "sts3215", "", {"id": 1, "max_temperature": 70})
    return serialize_backups([backup]).encode()


def _recording(folder: Path) -> bytes:
    with RecordingWriter(folder / "a.mcap") as writer:
        for i in range(3):
            writer.joint_state(make_positions(("J1", "J2"), (0.1 * i, 0.0)), 1.7e9 + i)
    return (folder / "a.mcap").read_bytes()


def _decode(path: Path) -> int:
    explainer, n = Explainer(), 0
    for item in read_traffic(read_bytes(path, largest=LARGEST), str(path)):
        if not isinstance(item, str):
            n += sum(1 for _ in explainer.feed(item))
    return n + sum(1 for _ in explainer.finish())


def _pose(path: Path) -> str:
    result = CliRunner().invoke(cli, ["model", "ik", str(path), "--json"])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    if result.exit_code:
        assert result.stderr.count("\n") == 1
        raise HexwireError(result.stderr.removesuffix("\n"))
    return result.stdout


def _waypoints(path: Path) -> object:
    way = parse_waypoints(read_bytes(path, largest=LARGEST_DATA), str(path))
    for _, sample in way.samples(max(way.duration / 5, 1e-3)):
        assert all(abs(value) < 1e300 for values in sample for value in values)
    assert 0 <= way.duration <= 3600
    return way


def _authority(path: Path) -> object:
    (path.parent / "ca.key").unlink(missing_ok=True)
    (path.parent / "ca.key").symlink_to(path)
    return issue_certificate(path.parent, "x", "client")


def _version(path: Path) -> str:
    (path.parent / "core").mkdir(exist_ok=True)
    named = path.parent / "core" / "generated.h"
    named.unlink(missing_ok=True)
    named.symlink_to(path)
    return source_version(path.parent)


def make_readers(folder: Path) -> dict[str, Reader]:
    """Every reader by its name; good files that others need are made in `folder`."""
    ca = make_authority(folder)
    own = issue_certificate(folder, "arm", "client")
    posed = CliRunner().invoke(cli, ["model", "fk", "90", "90", "90", "90", "90", "90", "--json"])
    recording = _recording(folder)
    return {
        "waypoints": Reader(_waypoints, ".json", WAYPOINTS),
        "arm": Reader(load_arm_file, ".toml", ARM),
        "calibration": Reader(load_calibration, ".toml", _calibration()),
        "LeRobot": Reader(lambda p: Calibration.from_lerobot(read_text(p), arm="x", file=str(p)), ".json", LEROBOT),
        "link set": Reader(lambda p: make_kinematics("hex7bot", str(p)), ".toml", LINKS),
        "channels": Reader(load_conf, ".conf", CONF),
        "channels in TOML": Reader(load_conf, ".toml", CONF_TOML),
        "settings of servos": Reader(load_backup, ".json", _backup()),
        "pose": Reader(_pose, ".json", posed.stdout.encode()),
        "joint states": Reader(lambda p: list(read_joint_states(p)), ".mcap", recording),
        "joint states, whole": Reader(lambda p: list(read_joint_states(p, whole=True)), ".mcap", recording),
        "log": Reader(_decode, ".txt", LOG),
        "hex dump": Reader(_decode, ".txt", b"0000: FF FF 01 02 01 FB  ......\n< FF FF 01 02 00 FC\n"),
        "raw capture": Reader(_decode, ".bin", bytes.fromhex("FFFF010201FB") * 3 + b"\0"),
        "traffic of a recording": Reader(_decode, ".mcap", recording),
        "authority's key": Reader(_authority, ".key", ca.key.read_bytes()),
        "trusted authority": Reader(
            lambda p: TlsFiles(str(p), str(own.cert), str(own.key)).client_context(), ".pem", ca.cert.read_bytes()
        ),
        "own certificate": Reader(
            lambda p: TlsFiles(str(ca.cert), str(p), str(own.key)).client_context(), ".pem", own.cert.read_bytes()
        ),
        "own key": Reader(
            lambda p: TlsFiles(str(ca.cert), str(own.cert), str(p)).client_context(), ".key", own.key.read_bytes()
        ),
        "firmware sources": Reader(_version, ".h", b"VERSION_MAJOR = 1;\nVERSION_MINOR = 0;\nVERSION_PATCH = 0;\n"),
    }


@pytest.fixture(scope="session")
def readers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Reader]:
    return make_readers(tmp_path_factory.mktemp("good"))


NAMES = (
    "waypoints", "arm", "calibration", "LeRobot", "link set", "channels", "channels in TOML", "settings of servos",
    "pose", "joint states", "joint states, whole", "log", "hex dump", "raw capture", "traffic of a recording",
    "authority's key", "trusted authority", "own certificate", "own key", "firmware sources",
)  # fmt: skip


def outcome(reader: Reader, path: Path, *, names_file: bool = True) -> str:
    """Empty for a value, else what the error says."""
    (path.parent / "x.pem").unlink(missing_ok=True)
    (path.parent / "x.key").unlink(missing_ok=True)
    try:
        reader.read(path)
    except HexwireError as error:
        said = str(error)
        assert said.isprintable(), said[:200]
        assert len(said) < 3000
        # Those that link to the file say the name that was looked up.
        named = path.name in said or path.parent.name in said or said.startswith("error: out of reach")
        assert not names_file or named, said[:200]
        return said
    return ""


@pytest.fixture
def place(tmp_path: Path, readers: dict[str, Reader]) -> Path:
    (tmp_path / "ca.pem").write_bytes(readers["trusted authority"].good)
    return tmp_path


HOSTILE: dict[str, bytes] = {
    "nothing": b"",
    "blanks": b" \r\n\t\n",
    "a NUL": b"\0",
    "NULs": bytes(5000),
    "UTF-16": 'name = "x"'.encode("utf-16"),
    "a mark and nothing": b"\xef\xbb\xbf",
    "not UTF-8": b"\xff\xfe\xfd\x80",
    "a huge line": b"a" * 200_000,
    "a huge line of blanks": b" " * 200_000 + b"x",
    "many lines": b"\n" * 200_000 + b"x",
    "many digits": b"9" * 5000,
    "a value of many digits": b"a = " + b"9" * 5000,
    "brackets": b"[" * 100_000,
    "tables": b'{"a":' * 100_000,
    "brackets and a key": b"a = " + b"[" * 100_000,
    "inline tables": b"a = " + b"{a=" * 100_000,
    "dots": b".".join([b"a"] * 100_000) + b" = 1",
    "null": b"null",
    "a list": b"[]",
    "a table": b"{}",
    "a text": b'"x"',
    "infinity": b"Infinity",
    "NaN": b"NaN",
    "escape sequences": b"\x1b[2J\x1b]0;x\x07 = 1",
    "escaped keys": b'{"\\u001b[2J": 1, "\\ud800": 2}',
    "quoted keys": b'"\\u001b[2J" = 1\n"a\\nb" = 2',
    "magic of a recording": b"\x89MCAP0\r\n",
    "begin of a recording": b"\x89MCAP0\r\n\x01" + b"\xff" * 20,
    "a headline of many digits": b"SerialPort sent - Length=" + b"9" * 5000,
    "a comment": b"#" * 200_000,
    "an equals sign": b"=" * 10_000,
    "quotes": b'"' * 10_001,
    "PEM without end": b"-----BEGIN CERTIFICATE-----\n" + b"A" * 200_000,
}
TOKENS = (
    "NaN", "nan", "-Infinity", "inf", "1e308", "-1e308", "1e999", "-1", "1.5", "9" * 5000, "0x" + "f" * 60, "null",
    "true", '"x"', '""', '"\\u001b"', '"' + "y" * 5000 + '"', "[]", "{}", "[[1]]", "1979-05-27",
)  # fmt: skip
_SCALAR = re.compile(r'"[^"\n]*"|-?\b[0-9][0-9.]*\b')


@pytest.mark.parametrize("name", NAMES)
def test_a_good_file_is_read_with_marks_and_line_ends_of_other_systems(
    name: str, readers: dict[str, Reader], place: Path
) -> None:
    reader = readers[name]
    forms = [reader.good]
    if reader.suffix not in (".mcap", ".bin", ".pem", ".key"):
        forms += [b"\xef\xbb\xbf" + reader.good, reader.good.replace(b"\n", b"\r\n")]
    for form in forms:
        path = place / f"file{reader.suffix}"
        path.write_bytes(form)
        assert outcome(reader, path) == ""


@pytest.mark.parametrize("name", NAMES)
def test_hostile_files_give_a_value_or_one_error(name: str, readers: dict[str, Reader], place: Path) -> None:
    path = place / f"file{readers[name].suffix}"
    for content in HOSTILE.values():
        path.write_bytes(content)
        outcome(readers[name], path)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_file_cut_at_each_byte_gives_a_value_or_one_error(
    name: str, readers: dict[str, Reader], place: Path
) -> None:
    reader, path = readers[name], place / f"file{readers[name].suffix}"
    step = max(1, len(reader.good) // (60 if reader.suffix in (".key", ".pem") or name == "pose" else 400))
    for end in range(0, len(reader.good), step):
        path.write_bytes(reader.good[:end])
        outcome(reader, path)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in NAMES if "key" not in name and "cert" not in name])
def test_each_value_made_another_one_gives_a_value_or_one_error(
    name: str, readers: dict[str, Reader], place: Path
) -> None:
    reader, path = readers[name], place / f"file{readers[name].suffix}"
    text = reader.good.decode("latin-1")
    for found in list(_SCALAR.finditer(text))[:12]:
        for token in TOKENS:
            path.write_bytes((text[: found.start()] + token + text[found.end() :]).encode("latin-1"))
            outcome(reader, path)


@pytest.mark.parametrize("name", NAMES)
def test_a_pipe_or_device_is_an_error_at_once(name: str, readers: dict[str, Reader], place: Path) -> None:
    reader, path = readers[name], place / f"file{readers[name].suffix}"
    os.mkfifo(path)
    assert outcome(reader, path)
    path.unlink()
    path.symlink_to("/dev/zero")
    assert outcome(reader, path)
    path.unlink()
    assert outcome(reader, path)
    path.symlink_to(path)
    assert outcome(reader, path)
    path.unlink()
    with path.open("wb") as file:
        file.truncate(LARGEST + 1)
    if reader.suffix != ".mcap":
        assert outcome(reader, path)
    path.unlink()
    path.mkdir()
    assert outcome(reader, path)


@settings(max_examples=200)
@given(data=st.data())
def test_spoilt_files_give_a_value_or_one_error(
    data: st.DataObject, readers: dict[str, Reader], tmp_path_factory: pytest.TempPathFactory
) -> None:
    name = data.draw(st.sampled_from([name for name in NAMES if name != "authority's key"]))
    reader = readers[name]
    spoilt = bytearray(reader.good)
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(spoilt)))
        piece = data.draw(st.binary(max_size=6) | st.sampled_from(TOKENS).map(str.encode))
        spoilt[at : at + data.draw(st.integers(0, 6))] = piece
    path = tmp_path_factory.getbasetemp() / f"spoilt{reader.suffix}"
    path.write_bytes(bytes(spoilt))
    outcome(reader, path, names_file=name != "firmware sources")


def _joint_states(folder: Path, *bodies: str) -> Path:
    path = folder / "made.mcap"
    with RecordingWriter(path) as writer:
        writer.joint_state(make_positions(("J1",), (0.0,)), 1.7e9)
        channel = writer._channels["/joint_states"]
        for body in bodies:
            writer._writer.add_message(
                channel_id=channel, log_time=1, publish_time=1, data=body.encode(), sequence=2
            )
    return path


_JOINT = '{"joints": [{"name": "a", "position": %s}]}'
_STAMP = '{"joints": [], "timestamp": {%s}}'


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("7", " must be a table, not 7"),
        ("{}", ".joints is missing"),
        ('{"joints": {}}', ".joints must be a list, not a table"),
        ('{"joints": [7]}', ".joints[0] must be a table, not 7"),
        ('{"joints": [{"position": 1}]}', ".joints[0].name is missing"),
        (_JOINT % "NaN", ".joints[0].position must be a finite number"),
        (_JOINT % "1e999", ".joints[0].position must be a finite number"),
        (_JOINT % "1e30", ".joints[0].position is 1e+30, but must be -10000 to 10000 rad"),
        (_JOINT % "true", ".joints[0].position must be a number, not true"),
        ('{"joints": [{"name": "a"}, {"name": "a"}]}', ".joints name a joint twice"),
        (_STAMP % '"sec": 1', ".timestamp.nsec is missing"),
        (_STAMP % '"sec": NaN, "nsec": 0', ".timestamp.sec must be a whole number, not nan"),
        (_STAMP % '"sec": 1, "nsec": 1e9', ".timestamp.nsec must be a whole number, not 1000000000.0"),
        ("[" * 100_000, ": brackets are nested too deeply"),
    ],
)
def test_an_invalid_joint_state_is_reported_with_its_place(body: str, words: str, tmp_path: Path) -> None:
    path = _joint_states(tmp_path, body)
    with pytest.raises(HexwireError) as caught:
        list(read_joint_states(path))
    assert str(caught.value) == f"{path}: joint state 2{words}"
