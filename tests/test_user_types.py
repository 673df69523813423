"""Programs of users pass `mypy --strict` against the installed package: those of the documents, and more."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"```python([^\n]*)\n(.*?)```", re.DOTALL)

OWN = """
import hexwire
from hexwire import JointTarget, RobotDriver, ServoBus, Session, StopMode
from hexwire.errors import HexwireError, LimitError, StoppedError


def nod(arm: RobotDriver, angle: float) -> tuple[str, ...]:
    try:
        sent = arm.write(JointTarget.of({"J5": angle}, duration=0.5))
        print(sent.duration, *sent.clamped)
    except (LimitError, StoppedError) as refused:
        print(refused)
    return arm.stop(StopMode.HOLD)


def angles(arm: RobotDriver) -> dict[str, float]:
    state = arm.read()
    return {joint.name: joint.position for joint in state if joint.position == joint.position}


def main() -> int:
    version: str = hexwire.__version__
    print(version)
    try:
        with hexwire.connect("/dev/ttyUSB0", robot="hex7bot") as arm:
            names: tuple[str, ...] = nod(arm, 0.1)
            print(names, angles(arm), arm.probe().missing)
    except HexwireError as error:
        print(error)
        return 1
    return 0


def raw() -> None:
    session: Session = Session.from_url("tcp://127.0.0.1:15030")
    with session:
        print(session.negotiate().dialect, session.request(0x1B).body)
    with ServoBus.from_url("serial:///dev/ttyUSB0?baud=1000000") as bus:
        readings = bus.sync_read("present_position", [1, 2])
        counts: dict[int, int | None] = dict(zip(readings.ids, readings.raw, strict=True))
        print(counts)
"""


def _programs() -> dict[str, str]:
    """Name and text of every program in the documents; a block that continues another belongs to its program."""
    programs: dict[str, str] = {}
    for page in PAGES:
        name = ""
        for number, (info, code) in enumerate(BLOCK.findall(page.read_text(encoding="utf-8"))):
            if "continuation" in info:
                programs[name] += code
            else:
                name = f"{page.stem}_{number}".replace("-", "_")
                programs[name] = code
    return programs


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An interpreter of its own that has hexwire as pip puts it there, not as source."""
    folder = tmp_path_factory.mktemp("user") / "venv"
    venv.create(folder, with_pip=False)
    (packages,) = folder.glob("lib/python*/site-packages")
    shutil.copytree(ROOT / "src" / "hexwire", packages / "hexwire")
    # What hexwire depends on. The source of hexwire lies behind another .pth file there, which is not followed.
    (packages / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")
    return folder / "bin" / "python"


def test_the_package_says_that_it_has_types() -> None:
    assert (ROOT / "src" / "hexwire" / "py.typed").is_file()


def mypy(installed: Path, folder: Path, *names: str) -> subprocess.CompletedProcess[str]:
    """What `mypy --strict` says of programs in a folder."""
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file=", "--cache-dir", str(folder / "cache")]
    return subprocess.run(
        [*command, "--python-executable", str(installed), *sorted(names)],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        timeout=110,
    )


def test_programs_of_users_pass_mypy_strict(installed: Path, tmp_path: Path) -> None:
    programs = {**_programs(), "own": OWN}
    assert {"README_0", "adding_a_robot_0"} <= programs.keys()
    for name, text in programs.items():
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
    ended = mypy(installed, tmp_path, *(f"{name}.py" for name in programs))
    # ROS comes from the system and brings no types.
    faults = [line for line in ended.stdout.splitlines() if "error:" in line and '"import-untyped"' not in line]
    faults = [line for line in faults if not line.startswith("ros_") or "import-" not in line]
    assert not faults, "\n".join(faults)
    assert "Success" in ended.stdout or "ros_" in ended.stdout, ended.stdout + ended.stderr


def test_a_name_that_is_not_there_is_found(installed: Path, tmp_path: Path) -> None:
    text = "import hexwire\nfrom hexwire import RobotDrivr\n\nprint(hexwire.conect, RobotDrivr)\n"
    (tmp_path / "misspelt.py").write_text(text, encoding="utf-8")
    ended = mypy(installed, tmp_path, "misspelt.py")
    assert 'Module "hexwire" has no attribute "RobotDrivr"' in ended.stdout
    assert 'Module has no attribute "conect"' in ended.stdout
