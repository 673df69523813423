"""Programs of users, those of the documents too, pass `mypy --strict` and pyright with the installed package."""

from __future__ import annotations

import json
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
from hexwire import JointTarget, MotionHandle, MotionResult, RobotDriver, ServoBus, Session, StopMode, deg, mm
from hexwire.drivers.abilities import Counters, ServoPing, StateReports, Watchdog
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


def follow(arm: RobotDriver) -> None:
    if (dog := Watchdog.find(arm)) is not None and not dog.watchdog_armed:
        dog.watchdog(0.5, StopMode.TORQUE_OFF)
    with arm.watched(0.5) as covered:
        print(covered, arm.url, arm.command_rate, arm.stop_kept_by, arm.now())
        if (reports := StateReports.find(arm)) is not None:
            for state in reports.stream(0.02, slow=2.0):
                print(state.position)
                break
    latch = arm.stop_latch()
    error: int | None = ServoPing.of(arm).ping(1)
    counters = Counters.of(arm)
    retries: int = counters.host_counters()["retries"] + counters.board_counters().get("retries", 0)
    print(latch.stopped, latch.cause.value, error, retries, max(counters.round_trips, default=0.0))


def main() -> int:
    version: str = hexwire.__version__
    print(version)
    try:
        with hexwire.connect("/dev/ttyUSB0", robot="hex7bot") as arm:
            names: tuple[str, ...] = nod(arm.driver, 0.1)
            print(names, angles(arm.driver), arm.driver.probe().missing)
        with hexwire.connect() as arm:
            Watchdog.of(arm.driver).watchdog(0.5)
            follow(arm.driver)
            went: MotionResult = arm.goto((0.0, mm(200), 0.1), "home", down=True, speed=0.2)
            under_way: MotionHandle[MotionResult] = arm.move(J1=deg(10), wait=False)
            held: bool = arm.close(force=0.3).holds
            print(went.rest, under_way.cancel().cut, held, arm.poses["home"], arm.limits["J1"].maximum)
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
    """What `mypy --strict` says of programs in a folder; what it knows of hexwire serves every folder."""
    cache = str(installed.parents[2] / "cache")
    command = [sys.executable, "-m", "mypy", "--strict", "--config-file=", "--cache-dir", cache]
    return subprocess.run(
        [*command, "--python-executable", str(installed), *sorted(names)],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture(scope="module")
def programs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with every program, and no more."""
    folder = tmp_path_factory.mktemp("programs")
    programs = {**_programs(), "own": OWN}
    assert {"README_0", "adding_a_robot_0"} <= programs.keys()
    for name, text in programs.items():
        (folder / f"{name}.py").write_text(text, encoding="utf-8")
    return folder


@pytest.mark.slow
def test_programs_of_users_pass_mypy_strict(installed: Path, programs: Path) -> None:
    ended = mypy(installed, programs, *(path.name for path in programs.glob("*.py")))
    # ROS comes from the system and brings no types.
    faults = [line for line in ended.stdout.splitlines() if "error:" in line and '"import-untyped"' not in line]
    faults = [line for line in faults if not line.startswith("ros_") or "import-" not in line]
    assert not faults, "\n".join(faults)
    assert "Success" in ended.stdout or "ros_" in ended.stdout, ended.stdout + ended.stderr


@pytest.mark.slow
def test_a_name_that_is_not_there_is_found(installed: Path, tmp_path: Path) -> None:
    text = "import hexwire\nfrom hexwire import RobotDrivr\n\nprint(hexwire.conect, RobotDrivr)\n"
    (tmp_path / "misspelt.py").write_text(text, encoding="utf-8")
    ended = mypy(installed, tmp_path, "misspelt.py")
    assert 'Module "hexwire" has no attribute "RobotDrivr"' in ended.stdout
    assert 'Module has no attribute "conect"' in ended.stdout


@pytest.fixture(scope="module")
def pyright(installed: Path, programs: Path, tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """What pyright says of every program and of a misspelt one, a fault a line."""
    folder = tmp_path_factory.mktemp("pyright")
    shutil.copytree(programs, folder, dirs_exist_ok=True)
    text = "import hexwire\n\nwith hexwire.connect() as arm:\n    arm.hoome()\n    arm.goto('home', speed='fast')\n"
    (folder / "misspelt.py").write_text(text, encoding="utf-8")
    (folder / "pyrightconfig.json").write_text('{"typeCheckingMode": "standard"}', encoding="utf-8")
    ended = subprocess.run(
        [sys.executable, "-m", "basedpyright", "--outputjson", "--pythonpath", str(installed), "."],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    told = json.loads(ended.stdout)
    assert told["summary"]["filesAnalyzed"] == len(list(folder.glob("*.py"))), ended.stderr
    return [
        f"{Path(row['file']).name}:{row['range']['start']['line'] + 1}: {row['rule']}: {row['message']}"
        for row in told["generalDiagnostics"]
    ]


@pytest.mark.slow
def test_programs_of_users_pass_pyright(pyright: list[str]) -> None:
    # ROS comes from the system and need not be there.
    faults = [
        fault
        for fault in pyright
        if not (fault.startswith("ros_") and "reportMissingImports" in fault)
        and not fault.startswith("misspelt.py:")
    ]
    assert not faults, "\n".join(faults)


@pytest.mark.slow
def test_pyright_finds_what_is_not_there(pyright: list[str]) -> None:
    assert any("misspelt.py:4: reportAttributeAccessIssue" in fault for fault in pyright)
    assert any("misspelt.py:5: reportArgumentType" in fault for fault in pyright)
