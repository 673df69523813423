"""The error index: every error text with its cause and its cure, a page for each subject.

Owns how ``errors/*.toml`` becomes pages, and what is missing or too much in these files. Must not know how texts
are found in the source.

    python docs/site/error_pages.py     name the texts that have no entry, and the entries whose text is gone
"""

from __future__ import annotations

import re
import sys
import tomllib
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent))

from error_texts import ErrorText, error_texts  # found by the line above

__all__ = ["Entry", "Subject", "differences", "pages", "subjects"]

HERE = Path(__file__).resolve().parent
SOURCES = (HERE.parents[1] / "src/hexwire", HERE.parents[1] / "packages/zenoh-ros2/src/zenoh_ros2")
FOLDER = "reference/errors"
_ORDER = (
    "command-line",
    "ports",
    "boards",
    "servos",
    "motions",
    "files",
    "recordings",
    "sharing",
    "studio",
    "ros1",
    "ros2",
    "joysticks",
    "emulated",
    "bytes",
)


@dataclass(frozen=True, slots=True)
class Entry:
    """Texts that have one cause and one cure.

    Attributes:
        title: What has happened, in a few words.
        cause: Why.
        cure: What to do.
        texts: The texts, as `error_texts` finds them.
    """

    title: str
    cause: str
    cure: str
    texts: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Subject:
    """A page of the index.

    Attributes:
        name: Of its file.
        title: Its heading.
        intro: What it is about.
        entries: In their order.
    """

    name: str
    title: str
    intro: str
    entries: tuple[Entry, ...]


def subjects(folder: Path = HERE / "errors") -> list[Subject]:
    """All subjects, in the order of the index.

    Args:
        folder: The folder of their files.
    """
    found = []
    for path in sorted(folder.glob("*.toml"), key=lambda path: _ORDER.index(path.stem)):
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        entries = tuple(Entry(**{**row, "texts": tuple(row["texts"])}) for row in table["entry"])
        found.append(Subject(path.stem, table["title"], table["intro"], entries))
    return found


def differences(said: dict[str, ErrorText], listed: list[Subject]) -> list[str]:
    """What is wrong with the index, a line each; nothing if it is complete.

    Args:
        said: The texts in the source.
        listed: The index.
    """
    texts = Counter(text for subject in listed for entry in subject.entries for text in entry.texts)
    wrong = [f"no entry: {text!r} ({', '.join(sorted(said[text].places))})" for text in said if text not in texts]
    wrong += [f"not in the source any more: {text!r}" for text in texts if text not in said]
    return wrong + [f"listed twice: {text!r}" for text, count in texts.items() if count > 1]


def pages() -> dict[str, str]:
    """Page of the site -> its text."""
    said = error_texts(*SOURCES)
    index = [
        "# Errors",
        "",
        "Every error text of hexwire, with its cause and its cure. Search for words of the message, or begin with",
        "its subject. A word in braces, as in `no answer from {silent}`, stands for what differs each time; long",
        "messages consist of several of these texts. The exit status of a command is 1 for an error of the",
        "device or the line, and 2 for a wrong use.",
        "",
        "| subject | texts |",
        "|---|---|",
    ]
    made = {}
    for subject in subjects():
        count = sum(len(entry.texts) for entry in subject.entries)
        index.append(f"| [{subject.title}]({subject.name}.md) | {count} |")
        made[f"{FOLDER}/{subject.name}.md"] = _page(subject, said)
    index += ["", "In Python every error is an exception of [hexwire.errors](../api/hexwire.errors.md).", ""]
    return {f"{FOLDER}/index.md": "\n".join(index), **made}


def _page(subject: Subject, said: dict[str, ErrorText]) -> str:
    lines = ["---", f"title: {subject.title}", "---", "", f"# Errors: {subject.title}", "", subject.intro, ""]
    for entry in subject.entries:
        lines += [f"## {entry.title}", "", f"**Cause:** {entry.cause}", "", f"**Cure:** {entry.cure}", ""]
        lines += ['<div class="texts" markdown>', ""]
        lines += [f"- {_code(text)}{_kinds(said.get(text))}" for text in entry.texts]
        lines += ["", "</div>", ""]
    return "\n".join(lines)


def _code(text: str) -> str:
    """A text as code, also if it has backquotes."""
    fence = "`" * (max(map(len, re.findall("`+", text)), default=0) + 1)
    space = " " if len(fence) > 1 else ""
    return f"{fence}{space}{text}{space}{fence}"


def _kinds(text: ErrorText | None) -> str:
    names = sorted(kind for kind in text.kinds if kind.endswith("Error") and kind != "ValueError") if text else []
    return f' <span class="kind">{", ".join(names)}</span>' if names else ""


def main() -> None:
    """Print what is wrong with the index."""
    wrong = differences(error_texts(*SOURCES), subjects())
    sys.stdout.write("".join(f"{line}\n" for line in wrong))
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
