"""What is published: whole, the same bytes every time, and with the firmware's real bytes."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import subprocess
import tarfile
import tomllib
import zipfile
from email import message_from_bytes
from pathlib import Path
from typing import Any

import pytest
from tests.avr import machines
from tests.release.scripts import ROOT, script, uv

from hexwire.drivers import firmware
from hexwire.drivers.firmware import find_image

build: Any = script("build")

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
IMAGE = b":00000001FF\n"


@pytest.mark.slow
def test_the_firmware_is_the_same_bytes_from_another_folder(tmp_path: Path) -> None:
    machines.built("mega2560")
    folder = tmp_path / "another/place/firmware"
    shutil.copytree(ROOT / "firmware", folder, ignore=shutil.ignore_patterns("build"))
    again = firmware.build(folder).hex_file.read_bytes()
    assert again == (machines.BUILD / "mega2560/hexwire.hex").read_bytes()


def fake_build(folder: Path, *, host_baud: int = 115200) -> firmware.BuildReport:
    file = folder / "build/x.hex"
    file.parent.mkdir(exist_ok=True)
    file.write_bytes(IMAGE + str(host_baud).encode())
    return firmware.BuildReport(file, "", "0.0.0", host_baud)


def build_in(folder: Path) -> list[Path]:
    """Wheel, source distribution and their ingredients; the compiler is replaced, it has its own test."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build.firmware, "build", fake_build)
        made: list[Path] = build.build(uv(), folder / "out", folder / "copy")
        return made


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return build_in(tmp_path_factory.mktemp("one"))


@pytest.mark.slow
def test_two_builds_give_the_same_bytes(built: list[Path], tmp_path: Path) -> None:
    for one, another in zip(built, build_in(tmp_path / "another" / "deeper"), strict=True):
        assert one.read_bytes() == another.read_bytes(), one.name


def test_no_link_of_the_package_page_is_relative(built: list[Path]) -> None:
    with zipfile.ZipFile(built[0]) as wheel:
        (name,) = (name for name in wheel.namelist() if name.endswith(".dist-info/METADATA"))
        page = message_from_bytes(wheel.read(name)).get_payload()
    links = re.findall(r"\]\(([^)\s]+)\)|(?:src|srcset|href)=\"([^\"]+)\"", str(page))
    assert len(links) > 20
    targets = ["".join(link) for link in links]
    assert all(target.startswith("https://") for target in targets)
    # Each is a file of the source distribution.
    with tarfile.open(built[1]) as source:
        files = {file.partition("/")[2] for file in source.getnames()}
    own = re.compile(
        r"https://(?:github\.com|raw\.githubusercontent\.com)/hexwire/hexwire/(?:blob/)?v[0-9.]+/([^#]+)"
    )
    found = {path[1] for target in targets if (path := own.match(target))}
    assert {"docs/pictures/studio-moving.webp", "docs/safety.md", "LICENSE"} <= found <= files


def test_the_wheel_brings_firmware_analysers_ros_and_pages(built: list[Path], tmp_path: Path) -> None:
    with zipfile.ZipFile(built[0]) as wheel:
        names = set(wheel.namelist())
        wheel.extractall(tmp_path)
    share = tmp_path / "hexwire/share"
    for rate in firmware.HOST_RATES:
        image = find_image(rate, folder=share / "firmware")
        assert image is not None
        assert image.file.read_bytes() == IMAGE + str(rate).encode()
        assert image.version == firmware.source_version(ROOT / "firmware")
    with zipfile.ZipFile(share / "analyzers.zip") as packed:
        assert {"wireshark/hexwire.lua", "saleae/extension.json", "LICENSE"} <= set(packed.namelist())
    data = f"hexwire-{PROJECT['version']}.data/data/share"
    assert {
        f"{data}/man/man1/hexwire.1",
        f"{data}/man/man1/hexwire-ros2.1",
        f"{data}/bash-completion/completions/hexwire",
        f"{data}/zsh/site-functions/_hexwire",
        f"{data}/fish/vendor_completions.d/hexwire.fish",
        "hexwire/py.typed",
        "hexwire/ros1/share/hexwire/package.xml",
        "hexwire/ros1/share/hexwire/launch/hardware.launch",
        "hexwire/ros1/share/hexwire/rviz/hexwire.rviz",
        "hexwire/studio/static/uPlot.iife.min.js",
    } <= names
    tracked = {name.removeprefix("src/") for name in build.sources() if name.startswith("src/hexwire/")}
    assert tracked <= names


def test_zenoh_ros2_is_built_whole_beside_it(built: list[Path]) -> None:
    wheel, source = built[3:]
    with zipfile.ZipFile(wheel) as packed:
        names = set(packed.namelist())
        info = next(name for name in names if name.endswith(".dist-info/METADATA"))
        metadata = message_from_bytes(packed.read(info))
    assert {"zenoh_ros2/py.typed", "zenoh_ros2/interfaces/std_msgs/msg/String.msg"} <= names
    assert info.replace("METADATA", "licenses/LICENSE") in names
    assert metadata["License-Expression"] == "Apache-2.0"
    required = metadata.get_all("Requires-Dist") or []
    assert [row for row in required if ";" not in row] == ["eclipse-zenoh>=1.10", "xxhash>=3.5"]
    links = re.findall(r"\]\(([^)\s]+)\)", str(metadata.get_payload()))
    assert all(link.startswith("https://") for link in links)
    inside = "packages/zenoh-ros2/"
    tracked = {name.removeprefix(inside) for name in build.sources() if name.startswith(inside)}
    assert {name.removeprefix("src/") for name in tracked if name.startswith("src/")} <= names
    with tarfile.open(source) as packed_source:
        assert tracked <= {member.name.partition("/")[2] for member in packed_source.getmembers()}


def test_the_metadata_are_complete(built: list[Path]) -> None:
    with zipfile.ZipFile(built[0]) as wheel:
        info = f"hexwire-{PROJECT['version']}.dist-info"
        metadata = message_from_bytes(wheel.read(f"{info}/METADATA"))
        texts = [wheel.read(f"{info}/licenses/{name}") for name in metadata.get_all("License-File") or []]
    assert metadata["License-Expression"] == PROJECT["license"]
    for words in (b"Apache License", b"GNU GENERAL PUBLIC LICENSE", b"GNU LESSER GENERAL", b"avr-libc", b"MIT"):
        assert any(words in text for text in texts), words
    urls = {line.partition(",")[0] for line in metadata.get_all("Project-URL") or []}
    assert {"Homepage", "Documentation", "Source", "Issues", "Changelog", "Security"} <= urls
    assert len(metadata.get_all("Classifier") or []) > 15
    assert "SO-101" in metadata["Keywords"]
    assert metadata["Description-Content-Type"] == "text/markdown"
    assert metadata["Requires-Python"] == ">=3.11"


def test_the_source_distribution_is_whole(built: list[Path]) -> None:
    with tarfile.open(built[1]) as packed:
        members = {m.name.partition("/")[2]: m for m in packed.getmembers() if not m.isdir()}
    names = set(build.sources())
    assert len(names) > 1500
    link = "firmware/boards/mega2560/src/core"
    assert names - {link} <= set(members)
    assert f"{link}/board.cpp" in members
    assert "src/hexwire/share/firmware/firmware.json" in members, "a wheel built from it has the firmware, too"
    assert members[".ci/run"].mode & 0o111
    assert not any(member.issym() or member.uid for member in members.values())
    assert not [name for name in members if "__pycache__" in name or name.startswith(("build/", "dist/"))]


def test_every_file_at_the_top_is_in_the_source_distribution() -> None:
    """One that is not listed in pyproject.toml would be missing without a word."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["uv"]
    listed = {name.partition("/")[0] for name in settings["build-backend"]["source-include"]}
    always = {"LICENSE", "README.md", "pyproject.toml", "src"}
    assert {name.partition("/")[0] for name in build.sources()} <= listed | always


@pytest.mark.slow
def test_the_sources_without_git_are_those_of_git(built: list[Path], tmp_path: Path) -> None:
    with tarfile.open(built[1]) as packed:
        # Debian 12's Python has no argument for it yet.
        packed.extraction_filter = getattr(tarfile, "data_filter", None)
        packed.extractall(tmp_path)
    (root,) = tmp_path.iterdir()
    for name in (".venv/x.py", "build/x", "src/hexwire/__pycache__/x.pyc", ".ruff_cache/x"):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text("")
    core = "firmware/boards/mega2560/src/core"
    found, expected = (
        {name for name in build.sources(folder) if not name.startswith(core)} for folder in (root, ROOT)
    )
    assert found == expected


def test_the_ingredients_are_those_that_the_lock_names(built: list[Path]) -> None:
    listed = json.loads(built[2].read_text())
    assert (listed["bomFormat"], listed["specVersion"]) == ("CycloneDX", "1.5")
    parts = {part["name"]: part for part in listed["components"]}
    locked = {p["name"]: p for p in tomllib.loads((ROOT / "uv.lock").read_text())["package"]}
    wire = parts["zenoh-ros2"]
    assert (wire["purl"], wire["licenses"]) == ("pkg:pypi/zenoh-ros2@0.1.0", [{"expression": "Apache-2.0"}])
    for name in ("click", "rich", "pyserial", "eclipse-zenoh", "starlette", "uvicorn"):
        assert parts[name]["version"] == locked[name]["version"]
        assert parts[name]["purl"] == f"pkg:pypi/{name}@{parts[name]['version']}"
    assert not {"mypy", "hypothesis", "twine"} & parts.keys(), "only what users get"
    for name in ("uPlot", "three"):
        assert parts[name]["licenses"] == [{"license": {"id": "MIT"}}]
    image = parts["mega2560-115200.hex"]
    assert image["hashes"][0]["content"] == hashlib.sha256(IMAGE + b"115200").hexdigest()
    assert {"arduino-core-avr", "avr-libc"} <= parts.keys()
    assert "timestamp" not in listed["metadata"]
    assert re.fullmatch(r"urn:uuid:[0-9a-f-]{36}", listed["serialNumber"])


def test_a_build_that_is_not_the_same_again_is_not_published(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    count = iter(range(10))

    def different(uv: str, into: Path, stage: Path) -> list[Path]:
        into.mkdir(parents=True)
        (into / "hexwire.whl").write_text(str(next(count)))
        return [into / "hexwire.whl"]

    monkeypatch.setattr(build, "build", different)
    assert build.main(["--into", str(tmp_path / "dist")]) == 1
    assert "hexwire.whl is not the same when it is built again" in capfd.readouterr().err
    assert not (tmp_path / "dist").exists()


def test_a_copy_has_one_of_two_modes(tmp_path: Path) -> None:
    (tmp_path / "a").write_text("x")
    (tmp_path / "a").chmod(0o600)
    (tmp_path / "b").write_text("x")
    (tmp_path / "b").chmod(0o775)
    for name in "ab":
        build.copy(tmp_path / name, tmp_path / "out" / name)
    assert [(tmp_path / "out" / name).stat().st_mode & 0o777 for name in "ab"] == [0o644, 0o755]


@pytest.mark.slow
def test_make_dist_installs_what_builds_it() -> None:
    shown = subprocess.run(["make", "-n", "dist"], cwd=ROOT, capture_output=True, text=True, check=True, timeout=60)
    assert "install-packages arduino-core-avr avr-libc binutils-avr gcc-avr make" in shown.stdout
    assert "--group dist" in shown.stdout
