"""Completion in real shells: the lines of docs/shell.md, and the files that the wheel installs."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs/shell.md").read_text(encoding="utf-8")
INSTALLED = {
    "bash": "bash-completion/completions/hexwire",
    "zsh": "zsh/site-functions/_hexwire",
    "fish": "fish/vendor_completions.d/hexwire.fish",
}
LINES = dict(zip(INSTALLED, re.findall(r"```sh\n(.*)\n```", PAGE), strict=True))

# What zsh's editor would do with the result, printed.
ZSH = """
compdef() {{ : }}
_describe() {{ print -rl -- $completions_with_descriptions }}
compadd() {{ print -rl -- $completions }}
{setup}
words=({words}); CURRENT=$#words
_hexwire_completion
"""


def environment(home: Path) -> dict[str, str]:
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("HEXWIRE_", "XDG_"))}
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    return kept | {"PATH": path, "HOME": str(home), "TERM": "dumb", "LC_ALL": "C.UTF-8"}


def sh(*command: str, home: Path) -> str:
    done = subprocess.run(
        command, env=environment(home), capture_output=True, text=True, check=True, timeout=60, cwd=home
    )
    return done.stdout


@pytest.mark.parametrize("shell", INSTALLED)
def test_the_wheel_installs_what_the_program_writes(shell: str, tmp_path: Path) -> None:
    written = sh("sh", "-c", f"_HEXWIRE_COMPLETE={shell}_source hexwire", home=tmp_path)
    assert (ROOT / "release/data/share" / INSTALLED[shell]).read_text() == written


def bash(words: str, setup: str, home: Path) -> set[str]:
    parts = words.split(" ")
    quoted = " ".join(f"'{part}'" for part in parts)
    script = (
        f"{setup}\nCOMP_WORDS=({quoted}); COMP_CWORD={len(parts) - 1}\n"
        "_hexwire_completion hexwire 2>/dev/null\nprintf '%s\\n' \"${COMPREPLY[@]}\""
    )
    return set(sh("bash", "--norc", "-c", script, home=home).split())


def test_bash(tmp_path: Path) -> None:
    assert bash("hexwire fi", LINES["bash"], tmp_path) == {"firmware"}
    assert bash("hexwire analyzers install ", LINES["bash"], tmp_path) == {"wireshark", "sigrok", "saleae"}
    assert "--dry-run" in bash("hexwire firmware flash --d", LINES["bash"], tmp_path)


@pytest.mark.slow
def test_zsh(tmp_path: Path) -> None:
    command = ZSH.format(setup=LINES["zsh"], words="hexwire firm")
    assert sh("zsh", "-f", "-c", command, home=tmp_path).startswith("firmware:Build, flash")
    command = ZSH.format(setup=LINES["zsh"], words="hexwire analyzers install ''")
    assert sh("zsh", "-f", "-c", command, home=tmp_path).split() == ["wireshark", "sigrok", "saleae"]


@pytest.mark.slow
def test_fish(tmp_path: Path) -> None:
    (tmp_path / ".config/fish/completions").mkdir(parents=True)
    sh("sh", "-c", LINES["fish"], home=tmp_path)
    shown = sh("fish", "-c", "complete -C 'hexwire fi'", home=tmp_path)
    assert shown.split()[0] == "firmware"
    assert "saleae" in sh("fish", "-c", "complete -C 'hexwire analyzers install s'", home=tmp_path).split()
