"""`make dist`: the wheel, the source distribution, their list of ingredients and checksums, in dist/.

Also wheel and source distribution of each package in packages/, which hexwire requires.

    python release/build.py --uv PATH            build everything twice, compare, and write dist/
    python release/build.py --uv PATH --once     build once, without the comparison

The sources are copied to a folder of their own, what is generated is added there, and uv builds both files from it:
first the source distribution, then the wheel from that. So the wheel is what somebody gets who builds from the
source distribution, which brings the generated files and needs no AVR compiler. Needs the compiler itself.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "schema"), str(ROOT / "src"), str(ROOT / "release")]

import assemble  # noqa: E402  (only now does Python find it)
import man  # noqa: E402
import sbom  # noqa: E402

from hexwire.drivers import firmware  # noqa: E402

BOARD = "mega2560"
NOT_SOURCES = {".git", ".venv", ".tools", "build", "dist", "__pycache__"}
LINK = re.compile(r"""(?<=\]\()(?![a-z]+:|#)[^)\s]+|(?<=src=")(?![a-z]+:)[^"]+|(?<=srcset=")(?![a-z]+:)[^"]+""")
PICTURE = (".svg", ".png")
ZIP_TIME = (1980, 1, 1, 0, 0, 0)


def sources(root: Path = ROOT) -> list[str]:
    """Paths of all source files below `root`: those that git tracks; without git, all but what tools create."""
    if (root / ".git").exists():
        listed = subprocess.run(["git", "ls-files", "-z"], cwd=root, capture_output=True, text=True, check=True)
        found = [name for name in listed.stdout.split("\0") if name]
    else:
        found = [path.relative_to(root).as_posix() for path in root.rglob("*") if not path.is_dir()]
        ignored = (root / ".gitignore").read_text(encoding="utf-8").splitlines()
        skip = NOT_SOURCES | {name.rstrip("/") for name in ignored if name.endswith("/")}
        # PKG-INFO and pyproject.toml.orig are made by the build of a source distribution.
        made = {"PKG-INFO", "pyproject.toml.orig"}
        found = [name for name in found if not skip & set(Path(name).parts) and name not in made]
    return sorted(name for name in found if (root / name).exists() and not generated(name))


def generated(name: str) -> bool:
    """Whether a path is one of those that `stage` adds: a source distribution has them."""
    return name.startswith(("src/hexwire/share/", "release/data/share/man/"))


def stage(into: Path, root: Path = ROOT) -> None:
    """Copy the sources and add what is generated.

    Raises:
        DeviceError: The firmware cannot be built.
    """
    for name in sources(root):
        copy(root / name, into / name)
    # The build backend reads no pyproject.toml that it has written itself.
    original = root / "pyproject.toml.orig"
    if original.exists():
        copy(original, into / "pyproject.toml")
    page = into / "README.md"
    page.write_text(with_whole_links(page.read_text(encoding="utf-8"), into), encoding="utf-8")
    share = into / "src/hexwire/share"
    add_firmware(into / "firmware", share / "firmware")
    add_analyzers(share / "analyzers.zip")
    man.write(into / "release/data/share/man/man1")


def with_whole_links(text: str, root: Path) -> str:
    """A page of the repository for the package index, where a link to a file needs its whole address."""
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    source, tag = project["urls"]["Source"], f"v{project['version']}"
    raw = source.replace("github.com", "raw.githubusercontent.com")

    def whole(link: re.Match[str]) -> str:
        path = link[0]
        return f"{raw}/{tag}/{path}" if path.endswith(PICTURE) else f"{source}/blob/{tag}/{path}"

    return LINK.sub(whole, text)


def copy(source: Path, target: Path) -> None:
    """Copy a file with one of two modes, whatever the umask was; a link to a folder becomes the folder."""
    if source.is_dir():
        for path in sorted(source.iterdir()):
            copy(path, target / path.name)
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(source.read_bytes())
    target.chmod(0o755 if source.stat().st_mode & 0o100 else 0o644)


def add_firmware(folder: Path, into: Path) -> None:
    """Build the firmware for each host rate, and write the files with a list of them."""
    into.mkdir(parents=True)
    rows = []
    for rate in firmware.HOST_RATES:
        report = firmware.build(folder, host_baud=rate)
        name = f"{BOARD}-{rate}.hex"
        image = report.hex_file.read_bytes()
        (into / name).write_bytes(image)
        digest = hashlib.sha256(image).hexdigest()
        rows.append({"file": name, "board": BOARD, "host_baud": rate, "sha256": digest})
    listed = {"version": firmware.source_version(folder), "compiler": compiler(), "images": rows}
    (into / firmware.LIST).write_text(json.dumps(listed, indent=1) + "\n", encoding="utf-8")
    shutil.rmtree(folder / "build")


def compiler() -> dict[str, str]:
    """Versions of what decides the bytes of the firmware: the same versions give the same bytes."""
    names = ("gcc-avr", "avr-libc", "binutils-avr", "arduino-core-avr")
    command = ["dpkg-query", "-W", "-f", "${Version}\n", *names]
    listed = subprocess.run(command, capture_output=True, text=True, check=True)
    return dict(zip(names, listed.stdout.split(), strict=True))


def add_analyzers(target: Path) -> None:
    """Write the folders of the analysers as one file: their Python is not for this package's interpreter."""
    with zipfile.ZipFile(target, "w") as packed:
        for name, text in sorted(assemble.files().items()):
            packed.writestr(zipfile.ZipInfo(name, ZIP_TIME), text)


def build(uv: str, into: Path, stage_in: Path) -> list[Path]:
    """Build all files from a new copy of the sources.

    Args:
        uv: The program.
        into: Folder for the files.
        stage_in: Folder for the copy.

    Returns:
        The wheel, the source distribution and the list of ingredients; then wheel and source distribution of each
        package.
    """
    stage(stage_in)
    made: list[Path] = []
    for project in (stage_in, *sorted((stage_in / "packages").iterdir())):
        command = [uv, "build", "--quiet", "--no-config", "--out-dir", str(into), str(project)]
        subprocess.run(command, check=True)
        read = tomllib.loads((project / "pyproject.toml").read_text(encoding="utf-8"))["project"]
        stem = f"{read['name'].replace('-', '_')}-{read['version']}"
        made += [into / f"{stem}-py3-none-any.whl", into / f"{stem}.tar.gz"]
        if project == stage_in:
            made.append(into / f"{stem}.cdx.json")
            made[-1].write_text(sbom.make(uv, stage_in), encoding="utf-8")
    return made


def main(arguments: list[str] | None = None) -> int:
    """Build, compare, check; returns the exit status."""
    parser = argparse.ArgumentParser(description="build what is published into dist/")
    parser.add_argument("--uv", default="uv", help="the program uv")
    parser.add_argument("--once", action="store_true", help="do not build a second time to compare")
    parser.add_argument("--into", type=Path, default=ROOT / "dist", metavar="DIR")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory(prefix="hexwire-dist-") as name:
        work = Path(name)
        first = build(options.uv, work / "first", work / "copy")
        if not options.once:
            second = build(options.uv, work / "again/second", work / "again/another/copy")
            for one, other in zip(first, second, strict=True):
                if one.read_bytes() != other.read_bytes():
                    sys.stderr.write(f"{one.name} is not the same when it is built again\n")
                    return 1
        packed = [str(path) for path in first if path.suffix != ".json"]
        subprocess.run([sys.executable, "-m", "twine", "check", "--strict", *packed], check=True)
        options.into.mkdir(parents=True, exist_ok=True)
        sums = []
        for path in first:
            shutil.copy(path, options.into / path.name)
            sums.append(f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n")
        (options.into / "SHA256SUMS").write_text("".join(sums), encoding="utf-8")
    sys.stdout.write("".join(sums))
    return 0


if __name__ == "__main__":
    sys.exit(main())
