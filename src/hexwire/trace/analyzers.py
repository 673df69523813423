"""The plug-ins for Wireshark, sigrok and Logic 2: put into the user's folders, listed, and taken away.

Owns which folder each program reads on each system, and which files there are ours: those that an earlier
installation has written and nobody has changed since.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from hexwire.errors import DeviceError, UsageError
from hexwire.folders import make_folder
from hexwire.inputs import parse_json, read_bytes
from hexwire.new_file import OutputFile

__all__ = ["PROGRAMS", "Installed", "default_folder", "install", "load_files", "remove", "status"]

PROGRAMS = ("wireshark", "sigrok", "saleae")
"""Programs that have a plug-in."""
_PACKED = Path(__file__).resolve().parents[1] / "share" / "analyzers.zip"
_ASSEMBLE = Path(__file__).resolve().parents[3] / "schema" / "assemble.py"
_LARGEST = 4 * 1024 * 1024
_NOT_WANTED = {"README.md"}  # beside somebody else's plug-ins it would be anybody's


@dataclass(frozen=True, slots=True)
class Installed:
    """What is in a program's folder.

    Attributes:
        program: Of `PROGRAMS`.
        folder: Where its files are, or would be.
        files: Those of this version, relative to the folder.
        state: ``current``, ``older`` (written by another version), ``changed`` (somebody has changed them),
            ``partly`` (some are missing), or ``none``.
    """

    program: str
    folder: Path
    files: tuple[str, ...]
    state: str


def default_folder(
    program: str,
    *,
    system: str = sys.platform,
    variables: Mapping[str, str] | None = None,
    home: Path | None = None,
) -> Path:
    """The user's folder that a program reads; for Logic 2, which has none, one of hexwire's.

    Args:
        program: Of `PROGRAMS`.
        system: As `sys.platform`.
        variables: Environment; that of this program if None.
        home: The user's folder; asked for if None.

    Source:
        Wireshark User's Guide, B.5 "Plugin folders"; g_get_user_data_dir of GLib for libsigrokdecode.
    """
    values = os.environ if variables is None else variables
    user = Path.home() if home is None else home
    if system == "win32":
        roaming = Path(values.get("APPDATA") or user / "AppData" / "Roaming")
        local = Path(values.get("LOCALAPPDATA") or user / "AppData" / "Local")
        return {
            "wireshark": roaming / "Wireshark" / "plugins",
            "sigrok": local / "libsigrokdecode" / "decoders",
            "saleae": local / "hexwire" / "saleae",
        }[program]
    given = values.get("XDG_DATA_HOME", "")
    data = Path(given) if given.startswith("/") else user / ".local" / "share"
    own = user / "Library" / "Application Support" if system == "darwin" else data
    return {
        "wireshark": user / ".local" / "lib" / "wireshark" / "plugins",
        "sigrok": data / "libsigrokdecode" / "decoders",
        "saleae": own / "hexwire" / "saleae",
    }[program]


def load_files(program: str) -> dict[str, bytes]:
    """The files of a plug-in, by their path relative to the program's folder.

    Raises:
        UsageError: There is no such program, or this installation brings no plug-ins.
        DeviceError: A checkout cannot assemble them.
    """
    if program not in PROGRAMS:
        raise UsageError(f"no analyser for {program}; there are {', '.join(PROGRAMS)}")
    if _PACKED.is_file():
        packed = read_bytes(_PACKED, largest=_LARGEST)
    elif _ASSEMBLE.is_file():
        packed = _assemble()
    else:
        raise UsageError(f"{_PACKED} is missing; install hexwire again, from a wheel")
    with zipfile.ZipFile(io.BytesIO(packed)) as archive:
        found = {
            name.partition("/")[2]: archive.read(name)
            for name in archive.namelist()
            if name.startswith(f"{program}/") and PurePosixPath(name).name not in _NOT_WANTED
        }
    # A program's plug-ins stand among those of others: only what is clearly ours is put there.
    return {name: data for name, data in found.items() if name}


def install(program: str, folder: Path, *, force: bool = False) -> list[Path]:
    """Write the files of a plug-in; all of them, or none if one belongs to somebody else.

    Args:
        program: Of `PROGRAMS`.
        folder: See `default_folder`.
        force: Overwrite files that others have written or changed.

    Returns:
        The files.

    Raises:
        UsageError: A file is there that no installation of hexwire has left so; or it cannot be written.
    """
    wanted = load_files(program)
    ours = _record(program, folder)
    foreign = [name for name, data in wanted.items() if not _may_replace(folder / name, data, ours.get(name))]
    if foreign and not force:
        raise UsageError(
            f"{folder / foreign[0]} is not from hexwire, or was changed; nothing was written. --force overwrites it"
        )
    gone = {name: digest for name, digest in ours.items() if name not in wanted}
    for name, data in wanted.items():
        _write(folder / name, data)
    for name, digest in gone.items():
        if _digest(folder / name) == digest:
            (folder / name).unlink()
    _write_record(program, folder, {name: hashlib.sha256(data).hexdigest() for name, data in wanted.items()})
    return [folder / name for name in sorted(wanted)]


def remove(program: str, folder: Path, *, force: bool = False) -> tuple[list[Path], list[Path]]:
    """Take away what `install` has written, and folders that become empty.

    Args:
        program: Of `PROGRAMS`.
        folder: See `default_folder`.
        force: Also files that somebody has changed.

    Returns:
        The files that were removed, and those that stay because they were changed.

    Raises:
        UsageError: A file cannot be removed.
    """
    wanted = load_files(program)
    known = {name: hashlib.sha256(data).hexdigest() for name, data in wanted.items()} | _record(program, folder)
    removed, kept = [], []
    for name, digest in sorted(known.items()):
        path = folder / name
        present = _digest(path)
        if not present:
            continue
        # What this version would write is ours as well, whoever has put it there.
        if force or present == digest or (name in wanted and path.read_bytes() == wanted[name]):
            try:
                path.unlink()
            except OSError as error:
                raise UsageError(f"{path} cannot be removed: {error.strerror}") from error
            removed.append(path)
            _remove_if_empty(path.parent, folder)
        else:
            kept.append(path)
    _record_path(program, folder).unlink(missing_ok=True)
    return removed, kept


def status(program: str, folder: Path) -> Installed:
    """Say what is in a program's folder.

    Raises:
        UsageError: As `load_files`.
    """
    wanted = load_files(program)
    ours = _record(program, folder)
    present = {name: _digest(folder / name) for name in wanted}
    if not any(present.values()):
        state = "none"
    elif not all(present.values()):
        state = "partly"
    elif all(present[name] == hashlib.sha256(data).hexdigest() for name, data in wanted.items()):
        state = "current"
    elif all(present[name] == ours.get(name) for name in wanted):
        state = "older"
    else:
        state = "changed"
    return Installed(program, folder, tuple(sorted(wanted)), state)


# -- whose a file is --------------------------------------------------------------------------------------


def _may_replace(path: Path, data: bytes, recorded: str | None) -> bool:
    """Whether a path is free, or holds what we have written or would write."""
    if path.is_symlink():
        return False
    present = _digest(path)
    return not present or present in (recorded, hashlib.sha256(data).hexdigest())


def _digest(path: Path) -> str:
    """Digest of a file; empty if there is none."""
    return hashlib.sha256(read_bytes(path, largest=_LARGEST)).hexdigest() if path.is_file() else ""


def _record_path(program: str, folder: Path) -> Path:
    """Where an installation is recorded: beside hexwire's own data, since the folder belongs to the program."""
    number = hashlib.sha256(str(folder.resolve()).encode()).hexdigest()[:12]
    return default_folder("saleae").parent / "analyzers" / f"{program}-{number}.json"


def _record(program: str, folder: Path) -> dict[str, str]:
    path = _record_path(program, folder)
    if not path.is_file():
        return {}
    rows = parse_json(read_bytes(path), str(path)).table(("files",))["files"].table()
    # A record that somebody has changed leads to no file elsewhere.
    return {name: item.text() for name, item in rows.items() if ".." not in PurePosixPath(name).parts}


def _write_record(program: str, folder: Path, digests: Mapping[str, str]) -> None:
    text = json.dumps({"folder": str(folder), "files": dict(sorted(digests.items()))}, indent=1)
    _write(_record_path(program, folder), f"{text}\n".encode())


def _write(path: Path, data: bytes) -> None:
    make_folder(path.parent)
    with OutputFile(path, force=True, mode=0o644) as output:
        output.file.write(data)


def _remove_if_empty(folder: Path, top: Path) -> None:
    # Python of sigrok has compiled what it has loaded.
    cache = folder / "__pycache__"
    if cache.is_dir() and folder != top:
        for path in cache.glob("*.pyc"):
            path.unlink()
        cache.rmdir()
    while folder != top and not any(folder.iterdir()):
        folder.rmdir()
        folder = folder.parent


def _assemble() -> bytes:
    """The same as the file of a wheel, made in a checkout, whose script is not part of the package."""
    with tempfile.TemporaryDirectory() as name:
        command = [sys.executable, str(_ASSEMBLE), name]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise DeviceError(f"the analysers cannot be assembled: {done.stderr.strip()}")
        packed = io.BytesIO()
        with zipfile.ZipFile(packed, "w") as archive:
            for path in sorted(Path(name).rglob("*")):
                if path.is_file():
                    archive.writestr(path.relative_to(name).as_posix(), path.read_bytes())
        return packed.getvalue()
