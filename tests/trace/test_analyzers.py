"""Plug-ins come into the right folder of each system, and nothing of anybody else's is lost."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from hexwire.errors import ConfigError, DeviceError, UsageError
from hexwire.trace import analyzers
from hexwire.trace.analyzers import PROGRAMS, default_folder, install, load_files, remove, status

ROOT = Path(__file__).resolve().parents[2]
FILES = {
    "wireshark/hexwire.lua": "-- version 1\n",
    "wireshark/hexwire_tables.lua": "-- tables\n",
    "wireshark/README.md": "read me\n",
    "sigrok/hexwire_host/pd.py": "host = 1\n",
    "sigrok/hexwire_servo/pd.py": "servo = 1\n",
    "sigrok/README.md": "read me\n",
    "saleae/extension.json": "{}\n",
    "LICENSE": "GPL\n",
}


def pack(path: Path, changes: dict[str, str] | None = None) -> None:
    with zipfile.ZipFile(path, "w") as packed:
        for name, text in (FILES | (changes or {})).items():
            packed.writestr(name, text)


@pytest.fixture
def packed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A wheel's plug-ins, and a user's folders."""
    path = tmp_path / "analyzers.zip"
    pack(path)
    monkeypatch.setattr(analyzers, "_PACKED", path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "plugins"


@pytest.mark.parametrize(
    ("system", "program", "path"),
    [
        ("linux", "wireshark", "/u/.local/lib/wireshark/plugins"),
        ("linux", "sigrok", "/u/.local/share/libsigrokdecode/decoders"),
        ("linux", "saleae", "/u/.local/share/hexwire/saleae"),
        ("darwin", "wireshark", "/u/.local/lib/wireshark/plugins"),
        ("darwin", "sigrok", "/u/.local/share/libsigrokdecode/decoders"),
        ("darwin", "saleae", "/u/Library/Application Support/hexwire/saleae"),
        ("win32", "wireshark", "/u/AppData/Roaming/Wireshark/plugins"),
        ("win32", "sigrok", "/u/AppData/Local/libsigrokdecode/decoders"),
        ("win32", "saleae", "/u/AppData/Local/hexwire/saleae"),
    ],
)
def test_the_folder_of_each_system(system: str, program: str, path: str) -> None:
    assert default_folder(program, system=system, variables={}, home=Path("/u")) == Path(path)


def test_a_user_who_has_moved_the_folders() -> None:
    moved = {"XDG_DATA_HOME": "/d", "APPDATA": "/r", "LOCALAPPDATA": "/l"}
    assert default_folder("sigrok", system="linux", variables=moved, home=Path("/u")) == Path(
        "/d/libsigrokdecode/decoders"
    )
    relative = default_folder("sigrok", system="linux", variables={"XDG_DATA_HOME": "d"}, home=Path("/u"))
    assert relative == Path("/u/.local/share/libsigrokdecode/decoders")
    assert default_folder("wireshark", system="win32", variables=moved) == Path("/r/Wireshark/plugins")
    assert default_folder("saleae", system="win32", variables=moved) == Path("/l/hexwire/saleae")


@pytest.mark.slow
def test_wireshark_and_sigrok_look_into_these_folders(packed: Path, tmp_path: Path) -> None:
    told = subprocess.run(
        ["tshark", "-G", "folders"], capture_output=True, text=True, check=True, timeout=60
    ).stdout
    (line,) = (line for line in told.splitlines() if line.startswith("Personal Lua Plugins"))
    assert Path(line.partition(":")[2].strip()) == default_folder("wireshark")
    # The real decoders: sigrok loads what stands in its folder.
    packed.unlink()
    install("sigrok", default_folder("sigrok"))
    shown = subprocess.run(["sigrok-cli", "-L"], capture_output=True, text=True, check=True, timeout=60).stdout
    assert {"hexwire_host", "hexwire_servo"} <= set(shown.split())


def test_wireshark_loads_what_is_installed(packed: Path) -> None:
    packed.unlink()
    install("wireshark", default_folder("wireshark"))
    told = subprocess.run(["tshark", "-G", "protocols"], capture_output=True, text=True, check=True, timeout=60)
    assert "\thexwire" in told.stdout
    assert told.stderr.count("Lua") == 0, told.stderr


def test_install_list_and_remove(packed: Path, folder: Path) -> None:
    assert status("wireshark", folder).state == "none"
    written = install("wireshark", folder)
    assert [path.name for path in written] == ["hexwire.lua", "hexwire_tables.lua"]
    assert written[0].read_text() == "-- version 1\n"
    assert written[0].stat().st_mode & 0o777 == 0o644
    assert status("wireshark", folder).state == "current"
    assert not (folder / "README.md").exists()
    (folder / "others.lua").write_text("theirs")
    assert remove("wireshark", folder) == (written, [])
    assert [path.name for path in folder.iterdir()] == ["others.lua"]
    assert remove("wireshark", folder) == ([], [])


def test_a_new_version_replaces_the_old_one(packed: Path, folder: Path) -> None:
    install("wireshark", folder)
    pack(packed, {"wireshark/hexwire.lua": "-- version 2\n"})
    assert status("wireshark", folder).state == "older"
    install("wireshark", folder)
    assert (folder / "hexwire.lua").read_text() == "-- version 2\n"
    assert status("wireshark", folder).state == "current"


def test_a_file_that_a_new_version_no_longer_has_goes(packed: Path, folder: Path) -> None:
    pack(packed, {"wireshark/old.lua": "x", "wireshark/edited.lua": "x"})
    install("wireshark", folder)
    (folder / "edited.lua").write_text("mine")
    pack(packed)
    install("wireshark", folder)
    assert not (folder / "old.lua").exists()
    assert (folder / "edited.lua").read_text() == "mine"


def test_a_foreign_file_stays_and_nothing_is_installed(packed: Path, folder: Path) -> None:
    folder.mkdir()
    (folder / "hexwire_tables.lua").write_text("somebody else's")
    with pytest.raises(UsageError, match=r"hexwire_tables\.lua is not from hexwire.*--force"):
        install("wireshark", folder)
    assert not (folder / "hexwire.lua").exists()
    assert (folder / "hexwire_tables.lua").read_text() == "somebody else's"
    install("wireshark", folder, force=True)
    assert (folder / "hexwire_tables.lua").read_text() == "-- tables\n"


def test_a_file_that_the_user_has_changed_stays(packed: Path, folder: Path) -> None:
    install("wireshark", folder)
    (folder / "hexwire.lua").write_text("my colours")
    assert status("wireshark", folder).state == "changed"
    with pytest.raises(UsageError, match="or was changed; nothing was written"):
        install("wireshark", folder)
    removed, kept = remove("wireshark", folder)
    assert ([path.name for path in removed], [path.name for path in kept]) == (
        ["hexwire_tables.lua"],
        ["hexwire.lua"],
    )
    assert remove("wireshark", folder, force=True)[0] == [folder / "hexwire.lua"]


def test_a_symbolic_link_is_not_followed(packed: Path, folder: Path, tmp_path: Path) -> None:
    folder.mkdir()
    victim = tmp_path / "victim"
    victim.write_text("-- version 1\n")
    (folder / "hexwire.lua").symlink_to(victim)
    for force in (False, True):
        with pytest.raises(UsageError):
            install("wireshark", folder, force=force)
    assert victim.read_text() == "-- version 1\n"


def test_what_was_copied_by_hand_is_taken_for_ours(packed: Path, folder: Path) -> None:
    folder.mkdir()
    (folder / "hexwire.lua").write_text("-- version 1\n")
    assert status("wireshark", folder).state == "partly"
    install("wireshark", folder)
    assert status("wireshark", folder).state == "current"


def test_folders_of_decoders_go_when_they_are_empty(packed: Path, folder: Path) -> None:
    install("sigrok", folder)
    (folder / "hexwire_host/__pycache__").mkdir()
    (folder / "hexwire_host/__pycache__/pd.cpython-312.pyc").write_text("x")
    (folder / "hexwire_servo/notes.txt").write_text("mine")
    remove("sigrok", folder)
    assert sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*")) == [
        "hexwire_servo",
        "hexwire_servo/notes.txt",
    ]


def test_a_record_that_was_changed_removes_no_file_elsewhere(packed: Path, folder: Path, tmp_path: Path) -> None:
    install("wireshark", folder)
    victim = tmp_path / "victim"
    victim.write_text("x")
    (record,) = (tmp_path / "data/hexwire/analyzers").iterdir()
    record.write_text(
        '{"files": {"../victim": "2d711642b726b04401627ca9fbac32f5c8530fb1903cc4db02258717921a4881"}}'
    )
    remove("wireshark", folder)
    assert victim.exists()
    install("wireshark", folder)
    record.write_text("{")
    with pytest.raises(ConfigError):
        status("wireshark", folder)


def test_a_checkout_assembles_what_a_wheel_brings(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(analyzers, "_PACKED", tmp_path / "none")
    assert load_files("saleae").keys() == {"HighLevelAnalyzer.py", "extension.json", "reading.py", "tables.py"}
    monkeypatch.setattr(analyzers, "_ASSEMBLE", Path(sys.executable))
    with pytest.raises(DeviceError, match="cannot be assembled"):
        load_files("saleae")
    monkeypatch.setattr(analyzers, "_ASSEMBLE", tmp_path / "none")
    with pytest.raises(UsageError, match="install hexwire again"):
        load_files("saleae")


def test_there_is_no_other_program(packed: Path) -> None:
    with pytest.raises(UsageError, match="no analyser for ghidra; there are wireshark, sigrok, saleae"):
        load_files("ghidra")
    assert {name.partition("/")[0] for name in FILES if "/" in name} == set(PROGRAMS)
