"""Where pages come from, and what becomes of their links; docs/site/pages.py."""

from __future__ import annotations

import ast
import functools
import re
from pathlib import Path

import pytest
import yaml
from tests.site.pages import ROOT, make, pages, repository_pages

import hexwire

TEXT = """\
# A page

See [b](b.md#two-words), [the top](../TOP.md), [code](../src/x.py), [out](https://example.com), `[no](link.md)`.

<img src="pictures/p.png"> ![q](pictures/p.png)

## Two words

## Two words

## `--wait`, and more

- item

  ```python fixture:arm
  [no](block.md)
  ```
"""


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    (tmp_path / "docs" / "sub").mkdir(parents=True)
    (tmp_path / "docs" / "site").mkdir()
    (tmp_path / "docs" / "a.md").write_text(TEXT)
    (tmp_path / "docs" / "b.md").write_text("# B\n")
    (tmp_path / "docs" / "sub" / "c.md").write_text("[a](../a.md) [top](../../SECURITY.md)\n")
    (tmp_path / "docs" / "site" / "note.md").write_text("not a page\n")
    (tmp_path / "SECURITY.md").write_text("# Top\n")
    return tmp_path


def test_sources_are_the_written_docs_and_of_the_top(tree: Path) -> None:
    found = pages.sources(tree)
    assert sorted(found) == ["a.md", "b.md", "security.md", "sub/c.md"]
    assert found["security.md"] == tree / "SECURITY.md"


def test_blocks_of_a_page_are_found_in_lists_too() -> None:
    (block,) = pages.blocks(TEXT)
    assert (block.line, block.info, block.language) == (15, "python fixture:arm", "python")
    assert block.text == "[no](block.md)\n"
    with pytest.raises(ValueError, match="line 2 has no end"):
        list(pages.blocks("x\n```text\n"))
    (outer,) = pages.blocks("````text\n```\n````\n")
    assert outer.text == "```\n"


def test_links_are_found_outside_of_code_only() -> None:
    targets = [target for _, _, target in pages.links(TEXT)]
    assert targets == [
        *("b.md#two-words", "../TOP.md", "../src/x.py", "https://example.com"),
        *("pictures/p.png", "pictures/p.png"),
    ]


def test_anchors_are_those_of_github() -> None:
    assert pages.headings(TEXT) == ["a-page", "two-words", "two-words-1", "--wait-and-more"]


def test_links_lead_to_written_the_site(tree: Path) -> None:
    made = pages.site_page("a.md", pages.sources(tree), tree)
    assert "[b](b.md#two-words), ../TOP.md" not in made
    assert "See [b](b.md#two-words), the top, code, [out](https://example.com), `[no](link.md)`." in made
    assert "```python\n" in made
    assert 'src="pictures/p.png"' in made
    (tree / "docs" / "b.md").write_text(
        "# Of B\n\n[a.md](a.md) [sub/c.md, section 2](sub/c.md#x) [`SECURITY.md`](../SECURITY.md)\n"
    )
    made = pages.site_page("b.md", pages.sources(tree), tree)
    assert "[A page](a.md) [c, section 2](sub/c.md#x) [Top](security.md)" in made
    assert pages.site_page("sub/c.md", pages.sources(tree), tree) == "[a](../a.md) [top](../security.md)\n"


def test_links_to_code_lead_to_the_reference_or_say_where_it_is(tree: Path) -> None:
    (tree / "src" / "hexwire").mkdir(parents=True)
    for name in ("known", "other"):
        (tree / "src" / "hexwire" / f"{name}.py").touch()
    (tree / "docs" / "sub" / "c.md").write_text(
        "# C\n\n[`f`](../../src/hexwire/known.py) [`g`](../../src/hexwire/other.py)\n"
    )
    made = pages.site_page("sub/c.md", pages.sources(tree), tree, {"reference/api/hexwire.known.md"})
    assert "[`f`](../reference/api/hexwire.known.md) `g` in `src/hexwire/other.py`\n" in made


# --- the pages of this repository ---------------------------------------------------------------------------------

NAV = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"]
FOR_DRIVERS = ("adding-a-robot.md", "adding-an-arm.md", "robot-on-a-line.md")
ROS = {
    "docs/ros.md: hexwire.ros1.path",
    "docs/ros.md: hexwire.ros1.messages",
}
"""What finds ROS and its messages where they are not installed."""
FROM_AN_INDEX = re.compile(
    r"\b(?:pip|pipx|uv(?: pip| tool)?) (?:install|add)(?: [^\s#`]+)*? '?hexwire(?:\[[\w,]+\])?'?(?=[`\s])(?! @)"
)
"""A line that installs hexwire by its name, not from a folder or a file."""
LONGEST = 250
"""Lines: a page that is longer is read by two kinds of reader, and each of them wants a page of their own."""


def test_every_link_leads_somewhere_on_github_too() -> None:
    headings = functools.cache(lambda file: pages.headings(file.read_text(encoding="utf-8")))
    gone = []
    for page in repository_pages():
        for _, _, target in pages.links((ROOT / page).read_text(encoding="utf-8")):
            name, _, anchor = target.partition("#")
            if "://" in name or name.startswith("mailto:"):
                continue
            file = (ROOT / page.parent / name) if name else ROOT / page
            if not file.exists() or (anchor and anchor not in headings(file)):
                gone.append(f"{page}: {target}")
    assert not gone


def listed(nav: list[object]) -> list[str]:
    found = []
    for entry in nav:
        target = entry if isinstance(entry, str) else next(iter(dict(entry).values()))  # type: ignore[call-overload]
        found += listed(target) if isinstance(target, list) else [str(target)]
    return found


def test_every_page_has_its_place_in_the_navigation() -> None:
    nav = listed(NAV)
    written = set(pages.sources())
    assert not written - set(nav), "give them a place in the navigation of mkdocs.yml"
    assert len(nav) == len(set(nav))
    assert {page for page in nav if page not in written} == {
        f"reference/{name}/index.md" for name in ("commands", "api", "registers", "errors")
    }


def test_the_index_of_a_generated_folder_stands_for_its_pages() -> None:
    made = {"x/index.md": "", "x/one.md": "", "y/index.md": ""}
    nav = ["a.md", {"Part": [{"X": "x/index.md"}, {"B": "b.md"}]}]
    assert make.navigation(nav, made) == ["a.md", {"Part": [{"X": ["x/index.md", "x/one.md"]}, {"B": "b.md"}]}]


def test_every_name_of_the_package_has_its_page_in_the_reference() -> None:
    from api import MODULES  # type: ignore[import-not-found]

    known = {module for modules in MODULES.values() for module in modules}
    gone = {name: module for name, module in hexwire._LAZY.items() if module not in known}
    assert gone == {}, "add these modules to MODULES in docs/site/api.py: `make docs` fails without them"


def test_names_that_pages_import_are_in_the_reference() -> None:
    from api import MODULES  # type: ignore[import-not-found]

    known = {
        "hexwire",
        "hexwire.control",
        "hexwire.testing",
        *(module for modules in MODULES.values() for module in modules),
    }
    # Of the repository, not of the package: how these pages start an emulated board.
    known |= {"hexwire.cli.demo"}
    for page in pages.sources().values():
        for block in pages.blocks(page.read_text(encoding="utf-8")):
            if block.language == "python":
                names = {n.module for n in ast.walk(ast.parse(block.text)) if isinstance(n, ast.ImportFrom)}
                ours = {name for name in names if name is not None and re.match(r"hexwire\b", name)}
                assert ours <= known, f"{page.name}: add {ours - known} to MODULES in docs/site/api.py"


def test_each_page_says_at_its_top_who_it_is_for() -> None:
    told = re.compile(
        r"\bfor (?:those|readers|users|owners|everybody|Python programmers)\b|Read this page|\bYou need\b",
        re.IGNORECASE,
    )
    # Made from the code: a reference is for who looks something up. The first page asks the reader.
    listed = re.findall(r"(\S+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE)
    written = [page for page in listed if not page.startswith("reference/") and page != "index.md"]
    assert len(written) > 25
    silent = []
    for page in written:
        source = ROOT / "docs" / page
        if not source.exists():
            source = ROOT / f"{Path(page).stem.upper()}.md"
        top = source.read_text(encoding="utf-8").split("\n## ")[0].split("\n|")[0].split("```")[0]
        if not told.search(" ".join(top.split())):
            silent.append(page)
    assert silent == []


@pytest.mark.parametrize(
    "line", ["pip install hexwire", "pip install -U 'hexwire[a,b]' x", "uv add hexwire", "`pip install hexwire`"]
)
def test_an_install_line_that_needs_an_index_is_found(line: str) -> None:
    assert FROM_AN_INDEX.search(f"{line}\n")


@pytest.mark.parametrize(
    "line",
    [
        "pip install '.[record]'",
        "pip install ./hexwire",
        "pip install 'hexwire @ file:///x'",
        "hexwire installs it",
    ],
)
def test_an_install_line_that_needs_no_index_of_hexwire_is_not(line: str) -> None:
    assert not FROM_AN_INDEX.search(f"{line}\n")


def test_no_page_installs_from_an_index_that_has_no_hexwire() -> None:
    assert "hexwire is not on the package index yet" in (ROOT / "README.md").read_text(encoding="utf-8")
    files = [
        *repository_pages(),
        *(path.relative_to(ROOT) for path in (ROOT / "examples").iterdir() if path.is_file()),
    ]
    found = {
        f"{file}: {line.strip()}"
        for file in files
        for line in (ROOT / file).read_text(encoding="utf-8").splitlines(keepends=True)
        if FROM_AN_INDEX.search(line)
    }
    # An extra is added to the hexwire that is there already.
    assert {line for line in found if "to an installed hexwire" not in line} == set()


def test_no_page_is_long() -> None:
    written = [ROOT / "ARCHITECTURE.md", *(ROOT / "docs").rglob("*.md")]
    lines = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in written}
    assert len(lines) > 30
    long = {str(path.relative_to(ROOT)): count for path, count in lines.items() if count > LONGEST}
    assert long == {}, f"split by what a reader wants; at most {LONGEST} lines"


def test_the_readme_is_read_in_three_minutes() -> None:
    words = len((ROOT / "README.md").read_text(encoding="utf-8").split())
    assert words <= 700, words


def test_whoever_uses_an_arm_imports_from_hexwire_alone() -> None:
    """In README, tutorials, how-to pages and examples; other layers are for references and authors of drivers."""
    kinds = {title: listed(entries) for part in NAV for title, entries in part.items() if isinstance(entries, list)}
    tasks = {page: pages.sources()[page] for kind in ("Tutorials", "How-to") for page in kinds[kind]}
    programs = [ROOT / "README.md", *(path for page, path in tasks.items() if page not in FOR_DRIVERS)]
    assert len(programs) > 20
    texts = {path: [block.text for block in pages.blocks(path.read_text(encoding="utf-8"))] for path in programs}
    examples = [path for path in (ROOT / "examples").iterdir() if path.suffix in (".py", ".ipynb")]
    texts |= {path: [path.read_text(encoding="utf-8")] for path in examples}
    deeper = {
        f"{path.relative_to(ROOT)}: {name}"
        for path, found in texts.items()
        for text in found
        for name in re.findall(r"^\W*from (hexwire\.\S+) import", text, re.MULTILINE)
    }
    assert deeper == ROS
