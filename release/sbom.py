"""The list of ingredients (SBOM, CycloneDX) of what is published.

uv writes the Python packages, as locked, with hashes. This adds what the wheel contains besides, and takes out what
would make two builds of the same sources differ. Owns that; must not know how anything is built.
"""

from __future__ import annotations

import hashlib
import json
import re
import subprocess
import uuid
from pathlib import Path
from typing import Any


def make(uv: str, root: Path) -> str:
    """The list for the sources below `root`, which must hold the generated files, as JSON."""
    command = [uv, "export", "--quiet", "--no-config", "--frozen", "--all-extras", "--no-default-groups"]
    done = subprocess.run(
        [*command, "--format", "cyclonedx1.5"], cwd=root, capture_output=True, text=True, check=True
    )
    found: dict[str, Any] = json.loads(done.stdout)
    found["metadata"].pop("timestamp", None)
    found.pop("serialNumber", None)
    for part in found["components"]:
        # A distribution of this repository: uv knows where it is, and no more.
        for row in part.get("properties", ()):
            if row["name"] == "uv:workspace:path":
                part["licenses"] = [{"expression": _licence(root / row["value"])}]
                part["purl"] = f"pkg:pypi/{part['name']}@{part['version']}"
    found["components"] += bundled(root)
    found["metadata"]["component"]["licenses"] = [{"expression": _licence(root)}]
    content = json.dumps(found, sort_keys=True)
    # A number that belongs to the content: the same content has the same number.
    found["serialNumber"] = f"urn:uuid:{uuid.uuid5(uuid.NAMESPACE_URL, content)}"
    return json.dumps(found, indent=1, sort_keys=True) + "\n"


def _licence(project: Path) -> str:
    found = re.search(r'^license = "(.*)"$', (project / "pyproject.toml").read_text(encoding="utf-8"), re.MULTILINE)
    assert found is not None
    return found[1]


def bundled(root: Path) -> list[dict[str, Any]]:
    """What the wheel contains that is not Python of this project: libraries of pages, the firmware."""
    static = root / "src/hexwire/studio/static/uPlot.iife.min.js"
    plot = re.search(r"\(v([\d.]+)\)", static.read_text(encoding="utf-8")[:400])
    assert plot is not None
    share = root / "src/hexwire/share/firmware"
    firmware = json.loads((share / "firmware.json").read_text(encoding="utf-8"))
    vendor = static.parent / "vendor"
    three = re.search(r"three\.js ([\d.]+)", (vendor / "OrbitControls.js").read_text(encoding="utf-8")[:400])
    assert three is not None
    rows = [
        _row("library", "uPlot", plot[1], "MIT", f"pkg:npm/uplot@{plot[1]}", _digest(static)),
        _row(
            "library",
            "three",
            three[1],
            "MIT",
            f"pkg:npm/three@{three[1]}",
            _digest(*sorted(vendor.glob("*.js"))),
        ),
    ]
    version = firmware["version"]
    rows += [_row("firmware", r["file"], version, "Apache-2.0", None, r["sha256"]) for r in firmware["images"]]
    for name, licence in (("arduino-core-avr", "LGPL-2.1-or-later"), ("avr-libc", "BSD-3-Clause")):
        version = firmware["compiler"][name]
        rows.append(_row("library", name, version, licence, f"pkg:deb/debian/{name}@{version}", None))
    return rows


def _row(kind: str, name: str, version: str, licence: str, purl: str | None, digest: str | None) -> dict[str, Any]:
    row: dict[str, Any] = {"type": kind, "bom-ref": f"bundled:{name}@{version}", "name": name, "version": version}
    row["licenses"] = [{"license": {"id": licence}}]
    if purl is not None:
        row["purl"] = purl
    if digest is not None:
        row["hashes"] = [{"alg": "SHA-256", "content": digest}]
    return row


def _digest(*paths: Path) -> str:
    """Of these files, one after the other."""
    return hashlib.sha256(b"".join(path.read_bytes() for path in paths)).hexdigest()
