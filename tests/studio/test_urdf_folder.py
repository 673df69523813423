"""A robot's URDF and its meshes, as pages get them: what is read of a folder, and what hostile files come to."""

from __future__ import annotations

import base64
import json
import os
import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from tests.studio.running import Visitor

from hexwire.drivers.arm_file import load_profile
from hexwire.errors import ConfigError, UsageError
from hexwire.studio.mesh_files import LARGEST_FILE, MOST_TRIANGLES, read_mesh
from hexwire.studio.urdf_folder import UrdfFolder

if TYPE_CHECKING:
    from playwright.sync_api import Page
    from tests.studio.running import RunningStudio

SO101 = load_profile("so101").model
CORNERS = ((0.0, 0.0, 0.0), (0.05, 0.0, 0.0), (0.0, 0.05, 0.0), (0.0, 0.0, 0.05))
FACES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))


def stl(count: int | None = None) -> bytes:
    """A tetrahedron, or what says that it has so many triangles."""
    rows = b"".join(struct.pack("<12fH", 0, 0, 1, *(x for i in face for x in CORNERS[i]), 0) for face in FACES)
    return bytes(80) + struct.pack("<I", len(FACES) if count is None else count) + rows


def stl_text(triangles: str = "") -> bytes:
    row = "facet normal 0 0 1 outer loop vertex 0 0 0 vertex 1 0 0 vertex 0 1 0 endloop endfacet"
    return f"solid a {triangles or row} endsolid a".encode()


def document(**changed: Any) -> dict[str, Any]:
    """A glTF of the same tetrahedron, changed."""
    made: dict[str, Any] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "children": [1]}, {"mesh": 0, "translation": [0, 0, 0.1]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [
            {"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1], "baseColorTexture": {"index": 0}}}
        ],
        "images": [{"uri": "https://evil.example/x.png"}],
        "textures": [{"source": 0}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 12, "type": "SCALAR"},
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 24}],
        "buffers": [{"byteLength": 72}],
    }
    return made | changed


BLOB = b"".join(struct.pack("<3f", *corner) for corner in CORNERS) + b"".join(
    struct.pack("<3H", *face) for face in FACES
)


def glb(**changed: Any) -> bytes:
    text = json.dumps(document(**changed)).encode()
    text += b" " * (-len(text) % 4)
    parts = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(BLOB), b"BIN\0") + BLOB
    return struct.pack("<4sII", b"glTF", 2, 12 + len(parts)) + parts


def opened(body: bytes) -> dict[str, Any]:
    size = struct.unpack_from("<I", body, 12)[0]
    found: dict[str, Any] = json.loads(body[20 : 20 + size])
    return found


def test_meshes_come_out_as_what_a_loader_reads_without_harm() -> None:
    assert read_mesh(stl(), ".STL") == ("stl", stl(), 4)
    # A text becomes binary: a loader's search in it could take for ever.
    kind, body, triangles = read_mesh(stl_text(), ".stl")
    assert (kind, len(body), triangles) == ("stl", 84 + 50, 1)
    assert struct.unpack_from("<9f", body, 96) == (0, 0, 0, 1, 0, 0, 0, 1, 0)
    made = read_mesh(glb(), ".glb")
    assert (made.kind, made.triangles) == ("glb", 8)
    assert struct.unpack_from("<I", made.body, 8)[0] == len(made.body)
    found = opened(made.body)
    # Nothing is left that asks for something else.
    assert set(found) == set(document()) - {"images", "textures"}
    assert found["materials"] == [{"pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}}]
    assert b"evil" not in made.body
    inside = document(buffers=[{"byteLength": 72, "uri": "data:x;base64," + base64.b64encode(BLOB).decode()}])
    assert read_mesh(json.dumps(inside).encode(), ".gltf") == made
    # It is read again as it was written.
    assert read_mesh(made.body, ".glb") == made


def _accessor(at: int, **changed: Any) -> dict[str, Any]:
    rows = document()["accessors"]
    rows[at] |= changed
    return {"accessors": rows}


HOSTILE: dict[str, tuple[bytes, str]] = {
    "a count beyond the file": (stl(0xFFFFFFFF), ".stl"),
    "a count below it": (stl(1), ".stl"),
    "too many triangles": (
        bytes(80) + struct.pack("<I", MOST_TRIANGLES + 1) + bytes(50 * (MOST_TRIANGLES + 1)),
        ".stl",
    ),
    "no triangles": (bytes(84), ".stl"),
    "an empty file": (b"", ".stl"),
    "a text without an end": (b"solid " * 100_000, ".stl"),
    "a text cut off": (stl_text()[:-30], ".stl"),
    "a text that is no number": (stl_text().replace(b"1 0 0", b"1 x 0"), ".stl"),
    "a text with a number too large": (stl_text().replace(b"1 0 0", b"1e99 0 0"), ".stl"),
    "a huge text": (b"solid " + b" " * (5 << 20), ".stl"),
    "a huge file": (bytes(LARGEST_FILE + 1), ".stl"),
    "another kind": (b"<COLLADA/>", ".dae"),
    "a file cut off": (glb()[:-4], ".glb"),
    "no JSON": (glb()[:20], ".glb"),
    "a deep JSON": (b"[" * 100_000, ".gltf"),
    "a JSON that is a list": (b"[]", ".gltf"),
    "a JSON of much more memory than letters": (b'{"x":[' + b"{}," * 200_000 + b"{}]}", ".gltf"),
    "no buffer": (json.dumps(document()).encode(), ".gltf"),
    "a file elsewhere": (
        json.dumps(document(buffers=[{"byteLength": 72, "uri": "../secret.bin"}])).encode(),
        ".gltf",
    ),
    "an address": (glb(buffers=[{"byteLength": 72, "uri": "https://evil.example/x"}]), ".glb"),
    "two buffers": (glb(buffers=[{"byteLength": 72}] * 2), ".glb"),
    "a huge buffer": (glb(buffers=[{"byteLength": 2**40}]), ".glb"),
    "a view beyond it": (
        glb(bufferViews=[{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteLength": 2**31}]),
        ".glb",
    ),
    "views one over the other": (glb(bufferViews=[{"buffer": 0, "byteLength": 72}] * 50), ".glb"),
    "a huge accessor": (glb(**_accessor(0, count=2**31)), ".glb"),
    "an accessor beyond its view": (glb(**_accessor(0, count=5)), ".glb"),
    "an accessor of nothing": (glb(accessors=[{"componentType": 5126, "count": 9, "type": "VEC3"}] * 2), ".glb"),
    "a sparse accessor": (glb(**_accessor(0, sparse={"count": 4})), ".glb"),
    "negative places": (glb(**_accessor(1, byteOffset=-8)), ".glb"),
    "a circle of nodes": (glb(nodes=[{"mesh": 0, "children": [1]}, {"children": [0]}]), ".glb"),
    "a node that is its own child": (glb(nodes=[{"mesh": 0, "children": [0]}]), ".glb"),
    "a deep tree": (glb(nodes=[{"mesh": 0, "children": [i + 1]} for i in range(99)] + [{"mesh": 0}]), ".glb"),
    "many nodes": (glb(nodes=[{"mesh": 0}] * 3000), ".glb"),
    "an extension": (glb(extensionsRequired=["KHR_draco_mesh_compression"]), ".glb"),
    "a place that is no number": (glb(nodes=[{"mesh": 0, "translation": [0, 0, 1e300]}]), ".glb"),
    "an unknown mesh": (glb(nodes=[{"mesh": 7}]), ".glb"),
    "tables that are none": (glb(meshes={"0": 1}), ".glb"),
    "primitives that are none": (glb(meshes=[{"primitives": "x"}]), ".glb"),
    "nothing to see": (glb(nodes=[{}]), ".glb"),
}


def test_a_hostile_or_damaged_mesh_is_refused_in_one_line() -> None:
    for what, (data, suffix) in HOSTILE.items():
        with pytest.raises(ConfigError, match=r"\A[^\n]+\Z"):
            pytest.fail(f"{what} became {read_mesh(data, suffix)[::2]}")
    # Each byte of a small file, changed: whatever comes of it, it is a mesh or an error in words.
    for good, suffix in ((stl(), ".stl"), (glb(), ".glb")):
        for at in range(len(good)):
            for value in (0, 0xFF):
                try:
                    made = read_mesh(good[:at] + bytes([value]) + good[at + 1 :], suffix)
                except ConfigError:
                    continue
                assert made.triangles <= MOST_TRIANGLES


LINKS = ("base", "shoulder", "upper", "lower", "wrist", "hand", "jaw")


def urdf(*visuals: str, joints: str = "") -> str:
    """A robot with the joints of an SO-101, and these visuals on its links."""
    geometry = [*visuals, *['<box size="0.02 0.02 0.05"/>'] * (7 - len(visuals))]
    rows = [
        f'<link name="{name}"><visual><geometry>{shape}</geometry></visual></link>'
        for name, shape in zip(LINKS, geometry, strict=True)
    ]
    chain = zip(SO101.names, LINKS, LINKS[1:], strict=False)
    rows += [
        f'<joint name="{name}" type="revolute"><parent link="{a}"/><child link="{b}"/>'
        '<origin xyz="0 0 0.06"/><axis xyz="0 1 0"/></joint>'
        for name, a, b in chain
    ]
    return f'<robot name="r">{"".join(rows)}{joints}</robot>'


def mesh(file: str) -> str:
    return f'<mesh filename="{file}"/>'


def folder(tmp_path: Path, *visuals: str) -> Path:
    made = tmp_path / "robot"
    (made / "urdf").mkdir(parents=True)
    (made / "meshes").mkdir()
    (made / "meshes/a.stl").write_bytes(stl())
    (made / "meshes/b.glb").write_bytes(glb())
    (made / "urdf/r.urdf").write_text(urdf(*visuals))
    return made


def test_what_a_urdf_names_is_found_in_its_folder_and_nowhere_else(tmp_path: Path) -> None:
    secret = tmp_path / "secret.stl"
    secret.write_bytes(stl())
    made = folder(
        tmp_path,
        mesh("package://robot/meshes/a.stl"),
        mesh("../meshes/b.glb"),
        mesh("../../secret.stl"),
        mesh("../meshes/link.stl"),
        mesh(f"file://{secret}"),
        mesh("package://robot/../secret.stl"),
        mesh(str(secret)),
    )
    (made / "meshes/link.stl").symlink_to(secret)
    found = UrdfFolder(made)
    assert [row.kind for row in found.meshes] == ["stl", "glb"]
    assert found.faults == [
        "secret.stl is outside the folder",
        "link.stl is outside the folder",
        "secret.stl is at an address; only files of the folder are shown",
        "secret.stl is outside the folder",
        "secret.stl is outside the folder",
    ]
    shown = found.geometry(SO101)
    assert shown is not None
    links = {link["name"]: link for link in shown["links"]}
    assert links["base"]["meshes"][0] | {"place": 0, "turn": 0} == {
        "kind": "stl",
        "mesh": 0,
        "size": [1.0, 1.0, 1.0],
        "place": 0,
        "turn": 0,
        "rgb": "#b0b7c0",
    }
    # What is not there is a rod to the next joint.
    assert not links["upper"]["meshes"]
    assert [shape["kind"] for shape in links["upper"]["shapes"]] == ["cylinder"]
    assert [link["parent"] for link in shown["links"]] == [-1, 0, 1, 2, 3, 4, 5]
    assert shown["tip"] == 6
    assert UrdfFolder(made / "urdf/r.urdf").faults[0].startswith("a.stl is")
    # An arm with other joints has its own picture.
    assert found.geometry(load_profile("chain").model) is None


def test_a_fifo_a_folder_and_a_missing_file_do_not_keep_it_waiting(tmp_path: Path) -> None:
    made = folder(tmp_path, *map(mesh, ("../meshes/pipe.stl", "../meshes", "../meshes/none.stl", "\\\\a\\b.stl")))
    os.mkfifo(made / "meshes/pipe.stl")
    found = UrdfFolder(made)
    assert len(found.faults) == 4
    assert not found.meshes
    (tmp_path / "round.urdf").symlink_to("round.urdf")
    for path in (tmp_path / "round.urdf", tmp_path / ("a" * 300), "a\0.urdf"):
        with pytest.raises((UsageError, ConfigError)):
            UrdfFolder(path)
    # What a terminal would obey does not get there.
    assert UrdfFolder(folder(tmp_path / "b", mesh("&#155;31m.stl"))).faults == ["?31m.stl is not there"]


def test_a_folder_without_a_urdf_or_with_what_is_none_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="has 0 URDF files"):
        UrdfFolder(tmp_path)
    (tmp_path / "r.urdf").write_text("<sdf/>")
    with pytest.raises(ConfigError, match=r"r\.urdf: has no <robot>"):
        UrdfFolder(tmp_path)


def test_a_gripper_that_mimics_and_a_joint_that_slides(tmp_path: Path) -> None:
    more = (
        '<link name="finger"/><joint name="finger" type="prismatic"><parent link="hand"/><child link="finger"/>'
        '<axis xyz="0 0 2"/><mimic joint="gripper" multiplier="-0.5" offset="0.1"/></joint>'
    )
    made = folder(tmp_path)
    (made / "urdf/r.urdf").write_text(urdf(joints=more))
    shown = UrdfFolder(made).geometry(SO101)
    assert shown is not None
    row = next(link for link in shown["links"] if link["name"] == "finger")
    assert (row["joint"], row["multiplier"], row["offset"], row["slides"]) == (5, -0.5, 0.1, True)
    assert row["axis"] == [0.0, 0.0, 1.0]


def test_pages_get_the_meshes_and_only_with_a_session(served: RunningStudio, tmp_path: Path) -> None:
    served.studio.urdf = UrdfFolder(folder(tmp_path, mesh("../meshes/a.stl")))
    try:
        visitor = Visitor(served, served.studio.access.watch_token)
        status, headers, body = visitor.ask("/meshes/0")
        assert (status, body) == (200, stl())
        assert headers["content-type"] == "application/octet-stream"
        assert headers["x-content-type-options"] == "nosniff"
        for path in ("/meshes/1", "/meshes/-1", "/meshes/..%2f0", "/meshes/99999999999999999999"):
            assert visitor.ask(path)[0] == 404, path
        assert Visitor(served).ask("/meshes/0")[0] == 401
    finally:
        served.studio.urdf = None


@pytest.mark.slow
def test_the_page_draws_meshes_and_says_what_is_drawn_plainly(
    served: RunningStudio, blank: Page, tmp_path: Path
) -> None:
    visuals = (mesh("../meshes/a.stl"), mesh("../meshes/b.glb"), mesh("../meshes/none.stl"))
    served.studio.urdf = UrdfFolder(folder(tmp_path, *visuals))
    asked: list[str] = []
    blank.on("request", lambda request: asked.append(request.url))
    try:
        served.open("so101")
        blank.goto(served.operate_url.replace("/?", "/move?"))
        blank.get_by_text("Drawn plainly: none.stl is not there").wait_for()
        for wanted in ("/meshes/1", "/GLTFLoader.js"):
            # Of the page: `asked` grows only while Playwright is waited for.
            blank.wait_for_function(
                "(wanted) => performance.getEntriesByType('resource').some(({ name }) => name.endsWith(wanted))",
                arg=wanted,
            )
    finally:
        served.studio.urdf = None
        served.studio.source.close()
    # `context` fails if the page wrote an error or asked for anything outside.
    assert {url.rpartition("/")[2] for url in asked if "/meshes/" in url} == {"0", "1"}
