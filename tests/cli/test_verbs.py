"""What `Arm` does a command does, too: by the same name, or by one to which that name leads."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner
from tests.recorded import make_positions

import hexwire.cli
from hexwire import Arm
from hexwire.cli.main import COMMANDS, SPELLED, cli
from hexwire.trace.recording import RecordingWriter

TYPED: dict[str, tuple[str, str]] = {
    "read": ("state", ""),
    "tip": ("tip", "tip"),
    "limits": ("limits", "limits"),
    "move": ("move J1=5", "send"),
    "send": ("move J1=5", "send"),
    "goto": ("goto 0 220 200", "goto"),
    "line": ("line 0 0 10 --relative --speed 10", "line"),
    "home": ("goto home", "goto"),
    "play": ("play FILE", "play"),
    "grip": ("grip 50", "grip"),
    "open": ("grip open", "grip"),
    "close": ("grip close", "grip"),
    "teach": ("teach FILE --yes --force --duration 0.2", "teach"),
    "torque": ("torque on", "torque"),
    "stop": ("stop", ""),
    "resume": ("resume", "resume"),
}
"""What a person types, and the verb that this calls; ARCHITECTURE.md says why some call none."""
ELSEWHERE = {
    "states": "state --watch: until Ctrl-C",
    "newest": "state: a command asks once, so there is no older one",
    "opening": "grip: says it at its end",
    "follow": "follow: of two arms, in test_follow.py",
    "record": "--record FILE: before any command",
    "picture": "studio: draws it live",
    "model": "limits",
    "detach": "each command detaches at its end",
}


def test_no_verb_is_forgotten() -> None:
    assert {name for name in vars(Arm) if not name.startswith("_")} == {*TYPED, *ELSEWHERE}


@pytest.mark.parametrize("verb", TYPED)
def test_its_command_does_what_the_verb_does(
    bench: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, verb: str
) -> None:
    called: list[str] = []

    def noting(name: str, member: Any) -> Any:
        if isinstance(member, property):
            return property(lambda arm: (called.append(name), member.__get__(arm))[1])
        return lambda arm, *given, **how: (called.append(name), member(arm, *given, **how))[1]

    with RecordingWriter(tmp_path / "a.mcap") as writer:
        for i in range(20):
            writer.joint_state(make_positions(("J1",), (0.01 * i,)), 1.7e9 + i / 10)
    for name in TYPED:
        monkeypatch.setattr(Arm, name, noting(name, vars(Arm)[name]))
    words, wanted = TYPED[verb]
    result = bench.run(*words.replace("FILE", str(tmp_path / "a.mcap")).split())
    assert result.exit_code == 0, result.output
    assert called == ([wanted] if wanted else [])


@pytest.mark.parametrize("verb", [*TYPED, "poses"])
def test_the_name_of_a_verb_leads_to_its_command(verb: str) -> None:
    if verb not in COMMANDS:
        assert verb in SPELLED
        assert TYPED[verb][0].startswith(SPELLED[verb])
        said = CliRunner().invoke(cli, [verb]).stderr
        assert said.startswith(f"error: no command '{verb}'; did you mean '{SPELLED[verb]}'?")


def test_every_command_calls_verbs_as_a_front_whose_errors_name_commands() -> None:
    calls = [
        (path.name, node.lineno, {word.arg for word in node.keywords})
        for path in (Path(hexwire.cli.__file__).parent).glob("*.py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Arm"
    ]
    assert len(calls) > 8
    assert [call for call in calls if "front" not in call[2]] == []
