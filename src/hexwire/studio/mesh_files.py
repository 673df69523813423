"""Meshes for pages: a file of anybody's becomes bytes that a browser can load without harm.

Owns what is accepted of STL and glTF, and its bounds. A page gets binary STL whose length fits its count, or binary
glTF that is written anew from what was understood: triangles with a colour, and nodes in a tree. So nothing reaches
a loader that asks for other files, for decoders or for more memory than the file has.
"""

from __future__ import annotations

import base64
import binascii
import json
import struct
from collections.abc import Mapping
from typing import Any, NamedTuple

from hexwire.errors import ConfigError, UsageError
from hexwire.inputs import Item

__all__ = ["KINDS", "LARGEST_FILE", "MOST_TRIANGLES", "Mesh", "read_mesh"]

LARGEST_FILE = 16 << 20
"""Bytes of one file."""
MOST_TRIANGLES = 200_000
"""Of one file."""
KINDS = {".stl": "stl", ".glb": "glb", ".gltf": "glb"}
"""What a page gets, by the ending of a file."""
_LARGEST_TEXT = 4 << 20
"""Bytes of an STL that is text, and of the JSON of a glTF."""
_FACET = struct.Struct("<12fH")
_SIZES = {5121: 1, 5123: 2, 5125: 4, 5126: 4}
"""Bytes of a number by glTF's component type: unsigned ones, and float."""
_PARTS = {"SCALAR": 1, "VEC3": 3}
_MOST_ROWS, _DEEPEST = 2000, 32
"""Rows of each table of a glTF, and nodes from its root to a leaf."""
_MOST_VALUES = 300_000
"""Values in the JSON of a glTF: each takes much more memory than its letters."""
_FAR = 1e6


class Mesh(NamedTuple):
    """A mesh for a page.

    Attributes:
        kind: ``stl`` or ``glb``.
        body: The bytes.
        triangles: How many it draws.
    """

    kind: str
    body: bytes
    triangles: int


def read_mesh(data: bytes, suffix: str) -> Mesh:
    """Check a mesh, and write what a page may load.

    Args:
        data: What is in the file.
        suffix: The ending of its name, such as ``.stl``.

    Raises:
        ConfigError: It is no such mesh, or beyond the bounds; the text says why.
    """
    kind = KINDS.get(suffix.lower())
    if kind is None:
        raise ConfigError(f"is a {suffix or 'file without ending'}, not .stl, .glb or .gltf")
    if len(data) > LARGEST_FILE:
        raise ConfigError(f"is larger than {LARGEST_FILE >> 20} MiB")
    try:
        return _stl(data) if kind == "stl" else _gltf(data)
    except ConfigError:
        raise
    except (UsageError, ValueError, LookupError, TypeError, ArithmeticError, RecursionError, struct.error):
        raise ConfigError("is damaged, or not what its name says") from None


def _bounded(triangles: int) -> int:
    if not 0 < triangles <= MOST_TRIANGLES:
        raise ConfigError(f"has {triangles} triangles; 1 to {MOST_TRIANGLES} are shown")
    return triangles


# -- STL ------------------------------------------------------------------------------------------------------


def _stl(data: bytes) -> Mesh:
    count = struct.unpack_from("<I", data, 80)[0] if len(data) >= 84 else -1
    if count >= 0 and len(data) == 84 + 50 * count:
        return Mesh("stl", data, _bounded(count))
    if data.lstrip()[:5].lower() != b"solid":
        if count < 0:
            raise ConfigError("is damaged, or not what its name says")
        raise ConfigError(f"says that it has {count} triangles, but has {len(data)} bytes")
    # A loader's search in a hostile text could last for hours.
    if len(data) > _LARGEST_TEXT:
        raise ConfigError(f"is text, and larger than {_LARGEST_TEXT >> 20} MiB; save it as binary STL")
    words = data.decode("ascii").lower().split()
    rows, at = list[bytes](), words.index("facet")
    while words[at] == "facet":
        shape = (
            *words[at : at + 2],
            *words[at + 5 : at + 7],
            *words[at + 7 : at + 19 : 4],
            *words[at + 19 : at + 21],
        )
        if shape != ("facet", "normal", "outer", "loop", "vertex", "vertex", "vertex", "endloop", "endfacet"):
            raise ConfigError(f"triangle {len(rows) + 1} is damaged")
        places = (2, 3, 4, 8, 9, 10, 12, 13, 14, 16, 17, 18)
        rows.append(_FACET.pack(*(float(words[at + place]) for place in places), 0))
        at += 21
    return Mesh("stl", bytes(80) + struct.pack("<I", len(rows)) + b"".join(rows), _bounded(len(rows)))


# -- glTF -----------------------------------------------------------------------------------------------------


def _gltf(data: bytes) -> Mesh:
    document, blob = _opened(data)
    if document.get("extensionsRequired"):
        raise ConfigError("needs an extension of glTF, such as compressed triangles; export it without")
    views = [_view(row, len(blob)) for row in _table(document, "bufferViews")]
    # Each is copied by a loader.
    if sum(int(row["byteLength"]) for row in views) > len(blob):
        raise ConfigError("has parts that overlap")
    accessors = [_accessor(row, views) for row in _table(document, "accessors")]
    materials = [_material(row) for row in _table(document, "materials")]
    meshes = [_primitives(row, accessors, len(materials)) for row in _table(document, "meshes")]
    counts = [sum(count for _, count in mesh) for mesh in meshes]
    nodes = [_node(row, len(meshes)) for row in _table(document, "nodes")]
    scenes = _table(document, "scenes")
    roots = _indices(scenes[document.get("scene", 0)].get("nodes", []), len(nodes))
    triangles = _walk(nodes, roots, counts)
    used = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": roots}],
        "nodes": nodes,
        # A mesh without triangles is a node without one.
        "meshes": [{"primitives": [row for row, _ in mesh]} for mesh in meshes],
        "materials": materials,
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(blob)}],
    }
    return Mesh(
        "glb", _packed({key: value for key, value in used.items() if value != []}, blob), _bounded(triangles)
    )


def _opened(data: bytes) -> tuple[dict[str, Any], bytes]:
    """The JSON of a glTF and its only buffer."""
    blob: bytes | None = None
    text = data
    if data[:4] == b"glTF":
        version, length = struct.unpack_from("<II", data, 4)
        if version != 2 or length != len(data):
            raise ConfigError("is not a whole file of glTF 2.0")
        size, kind = struct.unpack_from("<I4s", data, 12)
        if kind != b"JSON":
            raise ConfigError("does not begin with its JSON")
        text = data[20 : 20 + size]
        if len(data) > 20 + size:
            more, kind = struct.unpack_from("<I4s", data, 20 + size)
            blob = data[28 + size : 28 + size + more]
            if kind != b"BIN\0" or len(blob) != more:
                raise ConfigError("is not a whole file of glTF 2.0")
    if len(text) > _LARGEST_TEXT and blob is not None:
        raise ConfigError("describes too much")
    if sum(map(text.count, (b",", b"[", b"{"))) > _MOST_VALUES:
        raise ConfigError("describes too much")
    document = json.loads(text)
    if not isinstance(document, dict):
        raise ConfigError("is damaged, or not what its name says")
    buffers = _table(document, "buffers")
    if len(buffers) != 1:
        raise ConfigError(f"has {len(buffers)} buffers; one is shown")
    address = buffers[0].get("uri")
    if address is not None:
        head, _, coded = str(address).partition(",")
        if not head.startswith("data:") or not head.endswith(";base64"):
            raise ConfigError("asks for another file; save it as .glb")
        try:
            blob = base64.b64decode(coded, validate=True)
        except binascii.Error:
            raise ConfigError("has a buffer that is damaged") from None
    if blob is None or not 0 < buffers[0]["byteLength"] <= len(blob):
        raise ConfigError("has less in its buffer than it says")
    return document, blob[: buffers[0]["byteLength"]]


def _table(document: Mapping[str, Any], name: str) -> list[dict[str, Any]]:
    rows = document.get(name, [])
    if not isinstance(rows, list) or len(rows) > _MOST_ROWS or not all(isinstance(row, dict) for row in rows):
        raise ConfigError(f"has no list of at most {_MOST_ROWS} {name}")
    return rows


def _index(value: object, size: int) -> int:
    return Item(value).integer(0, size - 1)


def _indices(value: object, size: int) -> list[int]:
    if not isinstance(value, list) or len(value) > _MOST_ROWS:
        raise ConfigError("has a node with too many children")
    return [_index(each, size) for each in value]


def _view(row: Mapping[str, Any], size: int) -> dict[str, int]:
    _index(row.get("buffer", 0), 1)
    begin = Item(row.get("byteOffset", 0)).integer(0, size)
    made = {"buffer": 0, "byteOffset": begin, "byteLength": Item(row["byteLength"]).integer(1, size - begin)}
    if "byteStride" in row:
        made["byteStride"] = Item(row["byteStride"]).integer(4, 252)
    return made


def _accessor(row: Mapping[str, Any], views: list[dict[str, int]]) -> dict[str, Any]:
    """An accessor of numbers that are all there; one of no use here reads its view's first byte."""
    kind, parts = row.get("componentType"), _PARTS.get(row.get("type", ""))
    if kind not in _SIZES or parts is None or "sparse" in row or "bufferView" not in row:
        return {}
    view = views[_index(row["bufferView"], len(views))]
    size = _SIZES[kind] * parts
    begin = Item(row.get("byteOffset", 0)).integer(0, view["byteLength"])
    count = Item(row["count"]).integer(1, 3 * MOST_TRIANGLES)
    if begin + view.get("byteStride", size) * (count - 1) + size > view["byteLength"]:
        raise ConfigError("has less in its buffer than it says")
    kept = {"bufferView": row["bufferView"], "byteOffset": begin, "componentType": kind, "count": count}
    return {**kept, "type": row["type"]}


def _material(row: Mapping[str, Any]) -> dict[str, Any]:
    rough = row.get("pbrMetallicRoughness", {})
    colour = rough.get("baseColorFactor", [1.0] * 4) if isinstance(rough, dict) else [1.0] * 4
    return {"pbrMetallicRoughness": {"baseColorFactor": Item(colour).numbers(4, 0.0, 1.0)}}


def _primitives(
    row: Mapping[str, Any], accessors: list[dict[str, Any]], materials: int
) -> list[tuple[dict[str, Any], int]]:
    """The triangles of a mesh; lines and points are left out."""
    found = []
    for one in _table(row, "primitives"):
        if one.get("mode", 4) != 4:
            continue
        named = one["attributes"]
        position = _index(named["POSITION"], len(accessors))
        made: dict[str, Any] = {"attributes": {"POSITION": position}}
        places = accessors[position]
        if places.get("type") != "VEC3" or places["componentType"] != 5126:
            raise ConfigError("has places that are no numbers")
        normal = accessors[_index(named["NORMAL"], len(accessors))] if "NORMAL" in named else {}
        if normal.get("type") == "VEC3" and normal["componentType"] == 5126 and normal["count"] == places["count"]:
            made["attributes"]["NORMAL"] = named["NORMAL"]
        count = places["count"]
        if "indices" in one:
            made["indices"] = _index(one["indices"], len(accessors))
            corners = accessors[made["indices"]]
            if corners.get("type") != "SCALAR" or corners["componentType"] == 5126:
                raise ConfigError("has corners that are no numbers")
            count = corners["count"]
        if "material" in one:
            made["material"] = _index(one["material"], materials)
        found.append((made, count // 3))
    return found


def _node(row: Mapping[str, Any], meshes: int) -> dict[str, Any]:
    made: dict[str, Any] = {}
    for key, size in (("matrix", 16), ("translation", 3), ("rotation", 4), ("scale", 3)):
        if key in row:
            made[key] = Item(row[key]).numbers(size, -_FAR, _FAR)
    if "matrix" in made:
        made = {"matrix": made["matrix"]}
    if "mesh" in row:
        made["mesh"] = _index(row["mesh"], meshes)
    if row.get("children"):
        made["children"] = row["children"]
    return made


def _walk(nodes: list[dict[str, Any]], roots: list[int], counts: list[int]) -> int:
    """Check that the nodes are a tree; how many triangles they draw."""
    seen, triangles = set[int](), 0
    level, depth = roots, 0
    while level:
        depth += 1
        below = list[int]()
        for at in level:
            if at in seen or depth > _DEEPEST:
                raise ConfigError("has nodes that are no tree")
            seen.add(at)
            node = nodes[at]
            if "mesh" in node and not counts[node["mesh"]]:
                del node["mesh"]
            triangles += counts[node["mesh"]] if "mesh" in node else 0
            node["children"] = _indices(node.get("children", []), len(nodes))
            below += node["children"]
            if not node["children"]:
                del node["children"]
        level = below
    # What no scene shows is of no use, and was not looked at.
    for at in set(range(len(nodes))) - seen:
        nodes[at] = {}
    return triangles


def _packed(document: Mapping[str, Any], blob: bytes) -> bytes:
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    blob += bytes(-len(blob) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(blob))
    return b"".join(
        (head, struct.pack("<I4s", len(text), b"JSON"), text, struct.pack("<I4s", len(blob), b"BIN\0"), blob)
    )
