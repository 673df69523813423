"""The pages of the documentation site: where each comes from, and what becomes of its links.

Owns the way from the repository's Markdown files to those that the site is built from: every page is written once,
for readers of the repository, with relative links. A page of ``docs/`` keeps its place, one of the top folder has
its name in lower case. Must not know what the generated pages contain.
"""

from __future__ import annotations

import os
import re
from collections.abc import Container, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

__all__ = ["ROOT", "Block", "blocks", "headings", "links", "site_page", "sources", "title"]

ROOT = Path(__file__).resolve().parents[2]
_TOP = ("ARCHITECTURE.md", "CHANGELOG.md", "CONTRIBUTING.md", "PROTOCOL.md", "SECURITY.md")
_FENCE = re.compile(r"^( *)(`{3,}|~{3,})(.*)$")
_LINK = re.compile(r"(?<=\]\()([^)\s]+)(?=\))|(?<=\b(?:src)=\")([^\"]+)(?=\")|(?<=\bsrcset=\")([^\"]+)(?=\")")
_NAMED = re.compile(r"\[`?[\w./-]+\.md`?([^\]]*)\]\(([^)#\s]+)(#[^)\s]*)?\)")
_CODE = re.compile(r"(`+)(?!`).*?(?<!`)\1(?!`)")


@dataclass(frozen=True, slots=True)
class Block:
    """A fenced block of a page.

    Attributes:
        line: Line of its fence, from 1.
        info: What follows the fence: the language, and what the tests make of it.
        text: Its lines, without the indentation of the fence.
    """

    line: int
    info: str
    text: str

    @property
    def language(self) -> str:
        return (self.info.split() or [""])[0]


def sources(root: Path = ROOT) -> dict[str, Path]:
    """Page of the site -> file of the repository, of all that are written by hand."""
    found = {name.lower(): root / name for name in _TOP if (root / name).is_file()}
    folder = root / "docs"
    for path in sorted(folder.rglob("*.md")):
        if "site" not in path.relative_to(folder).parts:
            found[path.relative_to(folder).as_posix()] = path
    return found


def blocks(text: str) -> Iterator[Block]:
    """The fenced blocks of a page, those within lists too.

    Raises:
        ValueError: A block has no end.
    """
    begun: tuple[int, str, str, str] | None = None
    lines: list[str] = []
    for number, line in enumerate(text.splitlines(), 1):
        fence = _FENCE.match(line)
        if begun is None:
            if fence is not None and "`" not in fence[3]:
                begun, lines = (number, fence[1], fence[2], fence[3].strip()), []
        elif fence is not None and fence[2].startswith(begun[2]) and not fence[3].strip():
            yield Block(begun[0], begun[3], "".join(f"{one}\n" for one in lines))
            begun = None
        else:
            lines.append(line.removeprefix(begun[1]))
    if begun is not None:
        raise ValueError(f"the block that begins in line {begun[0]} has no end")


def _outside(text: str) -> str:
    """A page with its blocks and code blanked, line for line and character for character."""
    inside: str | None = None
    lines = []
    for line in text.splitlines():
        fence = _FENCE.match(line)
        if inside is None and fence is not None and "`" not in fence[3]:
            inside = fence[2]
            lines.append(" " * len(line))
        elif inside is not None:
            if fence is not None and fence[2].startswith(inside) and not fence[3].strip():
                inside = None
            lines.append(" " * len(line))
        else:
            lines.append(_CODE.sub(lambda found: "`" * len(found[0]), line))
    return "\n".join(lines)


def links(text: str) -> Iterator[tuple[int, int, str]]:
    """Start, end and target of each link and picture of a page."""
    for found in _LINK.finditer(_outside(text)):
        yield found.start(), found.end(), text[found.start() : found.end()]


def headings(text: str) -> list[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    anchors: list[str] = []
    for line, plain in zip(text.splitlines(), _outside(text).splitlines(), strict=True):
        if re.match(r"#{1,6} ", plain):
            words = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", line.lstrip("#").strip()).replace("`", "")
            anchor = re.sub(r"[^\w\- ]", "", words.lower()).replace(" ", "-")
            before = sum(re.fullmatch(rf"{re.escape(anchor)}(-\d+)?", one) is not None for one in anchors)
            anchors.append(f"{anchor}-{before}" if before else anchor)
    return anchors


def title(path: Path) -> str:
    """The heading of a page."""
    found = re.search(r"^# (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return found[1] if found is not None else path.stem


def site_page(page: str, pages: Mapping[str, Path], root: Path = ROOT, made: Container[str] = ()) -> str:
    """A page as the site builds it.

    Links to other pages lead to those of the site, and links to a module to its page among those in `made`. A
    link to any other file of the repository becomes its text and the file's path, one to nothing its text. Of a
    fence only the language stays: the rest is for the tests.
    """
    path = pages[page]
    here = PurePosixPath(page).parent
    text = path.read_text(encoding="utf-8")
    of_file = {file.resolve(): name for name, file in pages.items()}

    def titled(target: str, rest: str, anchor: str) -> str:
        named = pages.get(os.path.normpath(here / target))
        words = title(named) if named is not None else target
        return f"[{words}{rest}]({target}{anchor})"

    out, end = [], 0
    for start, stop, target in links(text):
        name, _, anchor = target.partition("#")
        file = (path.parent / name).resolve()
        if not name or "://" in name or name.startswith("mailto:"):
            continue
        if file in of_file:
            new = os.path.relpath(of_file[file], here) + (f"#{anchor}" if anchor else "")
        elif file.is_relative_to(root / "docs") and file.suffix in (".svg", ".png", ".webp"):
            new = os.path.relpath(file.relative_to(root / "docs"), here)
        else:
            known = file.is_file() and file.is_relative_to(root.resolve())
            inside = file.relative_to(root.resolve()).as_posix() if known else ""
            module = f"reference/api/{inside.removeprefix('src/').removesuffix('.py').replace('/', '.')}.md"
            new = os.path.relpath(module, here) if module in made else _NOWHERE + inside
        out += [text[end:start], new]
        end = stop
    done = "".join([*out, text[end:]])
    done = re.sub(rf"\[([^\]]+)\]\({_NOWHERE}([^)]+)\)", r"\1 in `\2`", done)
    done = re.sub(rf"\[([^\]]+)\]\({_NOWHERE}\)", r"\1", done)
    # Readers of the site know no files: a link that is called by its file gets the page's title.
    done = _NAMED.sub(lambda found: titled(found[2], found[1], found[3] or ""), done)
    return re.sub(r"^( *`{3,})(\w+) .*$", r"\1\2", done, flags=re.MULTILINE)


_NOWHERE = "nowhere:"
