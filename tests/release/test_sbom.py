"""What is added to the list of ingredients; the list as a whole is in test_build.py."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from tests.release.scripts import script

sbom: Any = script("sbom")


def test_what_the_wheel_contains_besides_python(tmp_path: Path) -> None:
    static = tmp_path / "src/hexwire/studio/static"
    share = tmp_path / "src/hexwire/share/firmware"
    (static / "vendor").mkdir(parents=True)
    share.mkdir(parents=True)
    (static / "uPlot.iife.min.js").write_text("/*! https://github.com/leeoniya/uPlot (v9.8.7) */")
    (static / "vendor/OrbitControls.js").write_text("// Of three.js 0.999.1 (MIT, see three.LICENSE)")
    (static / "vendor/three.core.min.js").write_text("a")
    (static / "vendor/three.module.min.js").write_text("b")
    row = {"file": "a.hex", "board": "mega2560", "host_baud": 1, "sha256": "abc"}
    compiler = {"arduino-core-avr": "1.8", "avr-libc": "2.0"}
    listed = {"version": "3.2.1", "compiler": compiler, "images": [row]}
    (share / "firmware.json").write_text(json.dumps(listed))
    rows = {row["name"]: row for row in sbom.bundled(tmp_path)}
    assert rows["uPlot"]["purl"] == "pkg:npm/uplot@9.8.7"
    assert rows["three"]["purl"] == "pkg:npm/three@0.999.1"
    assert len(rows["three"]["hashes"][0]["content"]) == 64
    assert rows["a.hex"]["version"] == "3.2.1"
    assert rows["a.hex"]["hashes"] == [{"alg": "SHA-256", "content": "abc"}]
    assert rows["arduino-core-avr"]["licenses"] == [{"license": {"id": "LGPL-2.1-or-later"}}]
    with pytest.raises(FileNotFoundError):
        sbom.bundled(tmp_path / "src")
