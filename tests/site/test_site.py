"""The built site: every link and anchor, no request to anybody, a search without a network, narrow screens.

Building all pages takes half a minute: `make test` builds a site of one page, and `test_pages.py` follows the links
of the pages as they are written.
"""

from __future__ import annotations

import functools
import http.server
import posixpath
import re
import threading
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import unquote, urldefrag

import pytest
from tests.site.pages import ROOT, commands, make

if TYPE_CHECKING:
    from playwright.sync_api import Browser

# Building all pages.
pytestmark = pytest.mark.long

LOADS = {"script": "src", "img": "src", "iframe": "src", "source": "srcset", "link": "href"}


class Page(HTMLParser):
    """The anchors, the links, and whatever a browser would load."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.ids: set[str] = set()
        self.links: list[str] = []
        self.loads: list[str] = []
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        self.ids |= {values[name] for name in ("id", "name") if name in values}
        if tag == "a" and "href" in values:
            self.links.append(values["href"])
        elif values.get(LOADS.get(tag, ""), ""):
            self.loads.append(values[LOADS[tag]])


@pytest.fixture(scope="module")
def html(site: Path) -> dict[str, Page]:
    return {path.relative_to(site).as_posix(): Page(path) for path in sorted(site.rglob("*.html"))}


@pytest.mark.slow
def test_every_page_is_built(html: dict[str, Page]) -> None:
    wanted = {*make.pages.sources(), *make.generated()}
    assert {page.replace(".md", ".html") for page in wanted} == set(html)


@pytest.mark.slow
def test_every_link_and_anchor_leads_somewhere(html: dict[str, Page], site: Path) -> None:
    gone = []
    files = {path.relative_to(site).as_posix() for path in site.rglob("*") if path.is_file()}
    for name, page in html.items():
        for link in [*page.links, *page.loads]:
            target, anchor = urldefrag(unquote(link))
            if re.match(r"\w+:", target):
                continue
            file = posixpath.normpath(posixpath.join(posixpath.dirname(name), target)) if target else name
            known = html.get(file)
            if file not in files or (anchor and known is not None and anchor not in known.ids):
                gone.append(f"{name}: {link}")
    assert not gone


@pytest.mark.slow
def test_nothing_is_loaded_from_elsewhere(html: dict[str, Page], site: Path) -> None:
    outside = re.compile(r"^(\w+:)?//")
    assert [f"{name}: {load}" for name, page in html.items() for load in page.loads if outside.match(load)] == []
    for sheet in site.rglob("*.css"):
        assert not re.search(r"url\(\s*['\"]?(\w+:)?//|@import", sheet.read_text(encoding="utf-8")), sheet
    # Names of XML's vocabularies are no addresses.
    known = re.compile(r"https?://(www\.w3\.org/|zensical\.org/?$)")
    for script in site.rglob("*.js"):
        if script.name == "search.js":
            continue  # the text of the pages
        found = re.findall(r"https?://[\w.-]+\.[a-z]+[^\s\"'`)]*", script.read_text(encoding="utf-8"))
        assert [url for url in found if not known.match(url)] == [], script


@pytest.mark.slow
def test_every_command_has_its_place(html: dict[str, Page]) -> None:
    for words, _, _ in commands.every_command():
        if len(words) > 1:
            assert "-".join(words) in html[f"reference/commands/{words[1]}.html"].ids


def test_options_are_those_of_the_command() -> None:
    pages = commands.pages()
    assert "| `--tolerance DEGREES` |" in pages["reference/commands/move.md"]
    for words, command, context in commands.every_command():
        if len(words) > 1:
            text = pages[f"reference/commands/{words[1]}.md"]
            for option in command.params:
                record = option.get_help_record(context)
                names = [name for name in option.opts if name.startswith("--")]
                assert record is None or all(f"`{name}" in text for name in names), (words, names)


@pytest.mark.slow
def test_every_register_is_listed(site: Path) -> None:
    import tomllib

    table = tomllib.loads((ROOT / "schema" / "registers.toml").read_text(encoding="utf-8"))
    for name, series in table["series"].items():
        text = (site / f"reference/registers/{name}.html").read_text(encoding="utf-8")
        assert all(f"<code>{row['name']}</code>" in text for row in series["registers"])


@pytest.mark.slow
def test_a_link_that_leads_nowhere_ends_the_build(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pages = {"index.md": "# Home\n\n[gone](index.md#gone)\n"}
    monkeypatch.setattr(make, "generated", dict)
    monkeypatch.setattr(make.pages, "sources", dict)
    monkeypatch.setattr(make, "navigation", lambda nav, made: ["index.md"])
    monkeypatch.setattr(make, "generated", lambda: pages)
    with pytest.raises(SystemExit, match="anchor does not exist"):
        make.build(tmp_path)


# --- in a browser -------------------------------------------------------------------------------------------------


@pytest.fixture
def address(site: Path) -> Iterator[str]:
    """Of the site on a server of this machine."""

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            return

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(site))) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}"
        server.shutdown()
        thread.join()


@pytest.mark.slow
@pytest.mark.system
@pytest.mark.parametrize("opened", ["from a server", "as files"])
def test_search_finds_without_a_network(
    opened: str, site: Path, window: Browser, request: pytest.FixtureRequest
) -> None:
    base = f"file://{site}" if opened == "as files" else request.getfixturevalue("address")
    faults: list[str] = []
    asked: list[str] = []
    with window.new_context(viewport={"width": 1280, "height": 900}) as context:
        context.on("request", lambda one: asked.append(one.url))
        context.on("weberror", lambda one: faults.append(str(one.error)))
        context.on("console", lambda one: faults.append(one.text) if one.type == "error" else None)
        page = context.new_page()
        page.goto(f"{base}/index.html")
        page.locator(".md-search__button").click()
        # What is typed before the field has the focus goes elsewhere.
        page.locator("input:focus").wait_for()
        page.keyboard.type("backlash")
        page.get_by_role("option", name="Health").first.click()
        page.wait_for_url(f"{base}/bus.html*")
    assert not faults
    assert [url for url in asked if not url.startswith((base, "about:", "data:"))] == []


@pytest.mark.slow
@pytest.mark.system
def test_commands_are_copied_without_prompts(address: str, window: Browser) -> None:
    with window.new_context(permissions=["clipboard-read", "clipboard-write"]) as context:
        page = context.new_page()
        page.goto(f"{address}/tutorials/first-steps.html")
        block = page.locator(".highlight", has_text="hexwire move J1=10 --wait").first
        block.hover()
        block.locator("button[title*=Copy], button.md-code__button").first.click()
        page.wait_for_function("navigator.clipboard.readText().then((text) => text)")
        assert page.evaluate("navigator.clipboard.readText()") == "hexwire move J1=10 --wait"


@pytest.mark.slow
@pytest.mark.system
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_pages_fit_a_phone_and_have_its_colours(scheme: str, site: Path, window: Browser) -> None:
    """The widest kinds of page: nothing is wider than the screen but what is scrolled by itself."""
    wide = {
        "light": ("index", "bus", "protocol", "reference/commands/bus", "reference/registers/hls"),
        "dark": ("tutorials/first-steps", "reference/errors/ports", "reference/api/hexwire.control.motion.motions"),
    }[scheme]
    asked: list[str] = []
    with window.new_context(viewport={"width": 390, "height": 844}, color_scheme=scheme) as context:  # type: ignore[arg-type]
        context.on("request", lambda one: asked.append(one.url))
        page = context.new_page()
        for name in wide:
            page.goto(f"file://{site}/{name}.html", wait_until="domcontentloaded")
            width = page.evaluate("document.documentElement.scrollWidth")
            assert width <= 390, f"{name} is {width} wide"
        colours = page.evaluate("document.body.dataset.mdColorScheme")
        assert colours == {"light": "default", "dark": "slate"}[scheme]
    assert [url for url in asked if not url.startswith(f"file://{site}/")] == []
