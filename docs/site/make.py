"""Builds the documentation site: ``build/site``, from the repository's pages and from the source.

    python docs/site/make.py              build
    python docs/site/make.py --serve      build, and serve it on this machine

The pages are assembled in ``build/site-pages``, with ``build/mkdocs.yml``, and zensical builds them. A link that
leads nowhere, or a docstring that cannot be read, ends the build with status 1.
"""

from __future__ import annotations

import argparse
import functools
import http.server
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import api  # noqa: E402  # found by the line above
import commands  # noqa: E402
import error_pages  # noqa: E402
import pages  # noqa: E402
import registers  # noqa: E402

ROOT = pages.ROOT
_STRANGE = re.compile(r"https?://(?:unpkg\.com|cdn\.jsdelivr\.net|api\.github\.com|fonts\.\w+\.com)[^\s\"'`)]*")


def generated() -> dict[str, str]:
    """Page of the site -> text, of all that come from the source."""
    return {
        **commands.pages(),
        **api.pages(ROOT / "src"),
        **registers.pages(ROOT / "schema" / "registers.toml"),
        **error_pages.pages(),
    }


def navigation(nav: list[Any], made: Mapping[str, str]) -> list[Any]:
    """The navigation of mkdocs.yml, where the index of a generated folder stands for all of its pages."""
    filled: list[Any] = []
    for entry in nav:
        if isinstance(entry, str):
            filled.append(entry)
            continue
        ((title, target),) = entry.items()
        if isinstance(target, list):
            filled.append({title: navigation(target, made)})
        elif target in made and target.endswith("/index.md"):
            folder = target.removesuffix("index.md")
            filled.append({title: [page for page in made if page.startswith(folder)]})
        else:
            filled.append(entry)
    return filled


def assemble(out: Path) -> Path:
    """Write all pages and the configuration; returns the latter.

    Args:
        out: Folder for both.
    """
    folder = out / "site-pages"
    if folder.exists():
        shutil.rmtree(folder)
    written = pages.sources()
    made = generated()
    for page in written:
        _write(folder / page, pages.site_page(page, written, made=made))
    for page, text in made.items():
        _write(folder / page, text)
    shutil.copytree(ROOT / "docs" / "pictures", folder / "pictures")
    shutil.copytree(HERE / "static", folder / "static")
    config = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    config |= {"docs_dir": "site-pages", "site_dir": "site", "nav": navigation(config["nav"], made)}
    for plugin in config["plugins"]:
        if isinstance(plugin, dict) and "mkdocstrings" in plugin:
            plugin["mkdocstrings"]["handlers"]["python"]["paths"] = [str(ROOT / "src")]
    file = out / "mkdocs.yml"
    _write(file, yaml.safe_dump(config, sort_keys=False, allow_unicode=True))
    return file


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def build(out: Path) -> Path:
    """Build the site; returns its folder.

    Raises:
        SystemExit: zensical found a fault, which it has told.
    """
    config = assemble(out)
    site = out / "site"
    if site.exists():
        shutil.rmtree(site)
    done = subprocess.run(
        [Path(sys.executable).with_name("zensical"), "build", "--strict", "--clean", "-f", config.name],
        cwd=out,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    if done.returncode or "Warning" in done.stdout:
        sys.exit(f"{done.stdout}\nthe documentation was not built")
    finish(site)
    return site


def finish(site: Path) -> None:
    """Make the site one that asks nobody: neither for the index of its search, nor for programs of others.

    The theme's script has addresses from which it would load what no page here uses, such as diagrams and
    repository facts. They are taken out, so that no page can ask them by mistake.
    """
    # Its links are for a server's root, and the site may be anywhere.
    (site / "404.html").unlink()
    index = (site / "search.json").read_text(encoding="utf-8")
    # A page that was opened as a file may load scripts, but not read files.
    (site / "search.js").write_text(f"var __index = {json.dumps(json.loads(index))};\n", encoding="utf-8")
    for script in (site / "assets" / "javascripts").rglob("*.js"):
        text = script.read_text(encoding="utf-8")
        script.write_text(_STRANGE.sub("about:blank", text), encoding="utf-8")


def serve(site: Path, port: int) -> None:
    """Serve the site to this machine until Ctrl-C."""
    handler = functools.partial(http.server.SimpleHTTPRequestHandler, directory=str(site))
    with http.server.ThreadingHTTPServer(("127.0.0.1", port), handler) as server:
        sys.stdout.write(f"http://127.0.0.1:{server.server_port}/\n")
        sys.stdout.flush()
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            return


def main(arguments: list[str] | None = None) -> None:
    """Build, and serve if asked."""
    parser = argparse.ArgumentParser(description="build the documentation site")
    parser.add_argument("--out", type=Path, default=ROOT / "build", help="folder for the site (default: build)")
    parser.add_argument("--serve", action="store_true", help="serve it on this machine")
    parser.add_argument("--port", type=int, default=8000, help="port for --serve (default: 8000)")
    options = parser.parse_args(arguments)
    site = build(options.out.resolve())
    sys.stdout.write(f"{site / 'index.html'}\n")
    if options.serve:
        serve(site, options.port)


if __name__ == "__main__":
    main()
