"""Bytes of ROS 2 messages: CDR, version 1 of the encoding, as all ROS 2 middlewares send it.

Owns the format: a header of four bytes (``00 01 00 00`` for little-endian), then the fields, each aligned to its
size from the end of that header. For each message `make_serializer` and `make_parser` write a Python function and
compile it, since this runs for every joint state. Must not know what a message is used for.

The names in the compiled code are those of fields, checked by `definitions`; text from a peer is never compiled.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import Any

from .definitions import PRIMITIVES, Definition, Field, FieldType, Kind
from .errors import RemoteProtocolError

__all__ = ["LITTLE", "MOST_BYTES", "MOST_PADDING", "Lookup", "make_parser", "make_serializer"]

LITTLE = b"\x00\x01\x00\x00"
"""The header of a little-endian message."""

MOST_BYTES = 16 * 1024 * 1024
"""Size of the largest message that is parsed."""

MOST_PADDING = 3
"""Bytes that may follow a message: a peer may align its end to four bytes."""

Lookup = Callable[[str], tuple[Definition, type]]
"""Gives the definition and the class of a message by its full name."""

_CODES = {"?": 1, "b": 1, "B": 1, "h": 2, "H": 2, "i": 4, "I": 4, "q": 8, "Q": 8, "f": 4, "d": 8}
_BOOLEANS = {False: False, True: True}
_FEW = 64
"""Numbers in a sequence whose compiled format is kept."""
_SHORT = 4096
"""Bytes of a sequence of strings that is kept for the next message, which mostly has the same names."""
_MOST_KEPT = 64


def _smallest(definition: Definition, lookup: Lookup) -> int:
    """The fewest bytes that a message has, without padding."""
    return max(1, sum(_smallest_field(field.type, lookup) for field in definition.fields))


def _smallest_field(type_: FieldType, lookup: Lookup) -> int:
    if type_.kind in (Kind.BOUNDED, Kind.SEQUENCE):
        return 4
    if type_.is_message:
        each = _smallest(lookup(type_.base)[0], lookup)
    else:
        each = 4 if type_.base == "string" else PRIMITIVES[type_.base][1]
    return each * max(1, type_.size)


# --- alignment ---------------------------------------------------------------------------------------------------


class _Offset:
    """What is known of the offset when the code is written: it is ``rest`` modulo ``of``."""

    def __init__(self) -> None:
        self.of, self.rest = 8, 0

    def forget(self, of: int = 1) -> None:
        self.of, self.rest = of, 0

    def known(self, alignment: int) -> bool:
        return self.of >= alignment

    def after(self, codes: Sequence[tuple[str, int]]) -> None:
        largest = max(_CODES[code] for code, _ in codes)
        of = max(self.of, largest)
        self.of, self.rest = of, _layout(codes, self.rest)[1] % of


def _layout(codes: Sequence[tuple[str, int]], offset: int) -> tuple[str, int]:
    """The format of values from an offset on, with the padding before each, and the offset after them."""
    text = ""
    for code, count in codes:
        size = _CODES[code]
        padding = -offset % size
        text += f"{padding}x{count}{code}"
        offset += padding + size * count
    return text, offset


# --- serializing -------------------------------------------------------------------------------------------------


def _string_block(values: Sequence[str], bound: int, kept: dict[tuple[str, ...], bytes]) -> bytes:
    """A sequence of strings without its length; it begins at a multiple of four."""
    if isinstance(values, str):
        raise TypeError("a string is not a sequence of strings")
    key = tuple(values)
    block = kept.get(key)
    if block is None:
        out = bytearray()
        for value in key:
            data = value.encode()
            if bound and len(data) > bound:
                raise ValueError(f"longer than {bound} bytes")
            out += bytes(-len(out) & 3)
            out += struct.pack("<I", len(data) + 1)
            out += data
            out += b"\0"
        block = bytes(out)
        if len(block) <= _SHORT:
            if len(kept) >= _MOST_KEPT:
                kept.clear()
            kept[key] = block
    return block


def _octets(value: Any) -> bytes:
    return bytes(value) if isinstance(value, bytes | bytearray | memoryview) else bytes(list(value))


class _NumberPackers:
    """Packs a number of values of one type, with its length and padding, by (number, offset modulo 8)."""

    def __init__(self, code: str) -> None:
        self._code = code
        self._kept: dict[int, Callable[..., bytes]] = {}

    def __call__(self, count: int, offset: int) -> Callable[..., bytes]:
        key = count << 3 | offset
        pack = self._kept.get(key)
        if pack is None:
            codes = [("I", 1), (self._code, count)] if count else [("I", 1)]
            pack = struct.Struct("<" + _layout(codes, offset)[0]).pack
            if count <= _FEW:
                self._kept[key] = pack
        return pack


class _Code:
    """Lines of a function, and the names that they use."""

    def __init__(self, head: str) -> None:
        self.lines = [head]
        self.names: dict[str, Any] = {"booleans": _BOOLEANS}
        self.depth = 1
        self.offset = _Offset()
        self.group: list[tuple[str, int, str]] = []
        self._count = 0

    def add(self, line: str) -> None:
        self.lines.append("    " * self.depth + line)

    def new(self, prefix: str, value: Any = None) -> str:
        """A new name; of a constant if there is a value."""
        self._count += 1
        name = f"{prefix}{self._count}"
        if value is not None:
            self.names[name] = value
        return name

    def codes(self) -> list[tuple[str, int]]:
        return [(code, count) for code, count, _ in self.group]

    def compile(self) -> Callable[..., Any]:
        exec(compile("\n".join(self.lines), "<message>", "exec"), self.names)
        function: Callable[..., Any] = self.names["run"]
        return function


def make_serializer(definition: Definition, lookup: Lookup) -> Callable[[Any], bytes]:
    """Make the function that turns a message into bytes.

    It raises whatever Python raises for an unsuitable value; `faults.find_fault` names the field.
    """
    code = _Code("def run(m):")
    code.names["LITTLE"] = LITTLE
    code.names["octets"] = _octets
    code.names["strings"] = _string_block
    code.add("out = bytearray()")
    _serialize_fields(code, definition, "m", lookup)
    _flush_packs(code)
    code.add("return LITTLE + out")
    return code.compile()


def _flush_packs(code: _Code) -> None:
    if not code.group:
        return
    codes = code.codes()
    values = ", ".join(value for _, _, value in code.group)
    if code.offset.known(max(_CODES[each] for each, _ in codes)):
        pack = code.new("pack", struct.Struct("<" + _layout(codes, code.offset.rest)[0]).pack)
        code.add(f"out += {pack}({values})")
    else:
        table = tuple(struct.Struct("<" + _layout(codes, start)[0]).pack for start in range(8))
        code.add(f"out += {code.new('packs', table)}[len(out) & 7]({values})")
    code.offset.after(codes)
    code.group = []


def _serialize_fields(code: _Code, definition: Definition, owner: str, lookup: Lookup) -> None:
    if not definition.fields:
        code.group.append(("B", 1, "0"))
    for field in definition.fields:
        _serialize_field(code, field, f"{owner}.{field.name}", lookup)


def _serialize_field(code: _Code, field: Field, value: str, lookup: Lookup) -> None:
    type_ = field.type
    if type_.kind is Kind.ONE:
        _serialize_one(code, type_, value, lookup)
        return
    local = code.new("v")
    if type_.is_octets:
        code.add(f"{local} = octets({value})")
    else:
        code.add(f"{local} = {value}")
    if type_.kind is Kind.ARRAY:
        code.add(f"if len({local}) != {type_.size}: raise ValueError('must have {type_.size} values')")
    elif type_.kind is Kind.BOUNDED:
        code.add(f"if len({local}) > {type_.size}: raise ValueError('may have {type_.size} values')")
    counted = type_.kind is not Kind.ARRAY
    if type_.is_octets:
        if counted:
            code.group.append(("I", 1, f"len({local})"))
        _flush_packs(code)
        code.add(f"out += {local}")
        code.offset.forget()
    elif type_.is_message or (type_.base == "string" and not counted):
        if counted:
            code.group.append(("I", 1, f"len({local})"))
        _flush_packs(code)
        item = code.new("x")
        code.add(f"for {item} in {local}:")
        code.depth += 1
        code.offset.forget()
        _serialize_one(code, FieldType(type_.base, bound=type_.bound), item, lookup)
        _flush_packs(code)
        code.depth -= 1
        code.offset.forget()
    elif type_.base == "string":
        code.group.append(("I", 1, f"len({local})"))
        _flush_packs(code)
        code.add(f"out += strings({local}, {type_.bound}, {code.new('kept', {})})")
        code.offset.forget()
    else:
        _serialize_numbers(code, type_, local, counted)


def _serialize_numbers(code: _Code, type_: FieldType, local: str, counted: bool) -> None:
    letter, size = PRIMITIVES[type_.base]
    if letter == "?":
        code.add(f"{local} = [booleans[b] for b in {local}]")
    if counted:
        _flush_packs(code)
        packer = code.new("packer", _NumberPackers(letter))
        code.add(f"out += {packer}(len({local}), len(out) & 7)(len({local}), *{local})")
        code.offset.forget(min(size, 4))
    else:
        code.group.append((letter, type_.size, f"*{local}"))


def _serialize_one(code: _Code, type_: FieldType, value: str, lookup: Lookup) -> None:
    if type_.is_message:
        local = code.new("m")
        code.add(f"{local} = {value}")
        _serialize_fields(code, lookup(type_.base)[0], local, lookup)
    elif type_.base == "string":
        local = code.new("s")
        code.add(f"{local} = {value}.encode()")
        if type_.bound:
            code.add(f"if len({local}) > {type_.bound}: raise ValueError('longer than {type_.bound} bytes')")
        code.group.append(("I", 1, f"len({local}) + 1"))
        _flush_packs(code)
        code.add(f"out += {local}")
        code.add("out.append(0)")
        code.offset.forget()
    elif type_.base == "bool":
        code.group.append(("?", 1, f"booleans[{value}]"))
    else:
        code.group.append((PRIMITIVES[type_.base][0], 1, value))


# --- parsing -----------------------------------------------------------------------------------------------------


class _NumberParsers:
    """Unpacks a number of values of one type, by their number."""

    def __init__(self, order: str, code: str) -> None:
        self._order, self._code = order, code
        self._kept: dict[int, Callable[..., tuple[Any, ...]]] = {}

    def __call__(self, count: int) -> Callable[..., tuple[Any, ...]]:
        unpack = self._kept.get(count)
        if unpack is None:
            unpack = struct.Struct(f"{self._order}{count}{self._code}").unpack_from
            if count <= _FEW:
                self._kept[count] = unpack
        return unpack


class _StringParser:
    """Parses a sequence of strings; keeps the last, since the next message mostly has the same names."""

    def __init__(self, order: str, bound: int, path: str) -> None:
        self._length = struct.Struct(order + "I").unpack_from
        self._bound = bound
        self._path = path
        self._last: tuple[int, bytes, list[str]] = (-1, b"", [])

    def __call__(self, data: bytes, start: int, count: int) -> tuple[list[str], int]:
        """Parse strings from an offset, a multiple of four; return them and the offset after them."""
        kept, block, values = self._last
        if kept == count and data.startswith(block, start):
            return values.copy(), start + len(block)
        if count * 4 > len(data) - start:
            raise RemoteProtocolError(f"{self._path}: {count} strings do not fit into the message")
        values, offset = [], start
        for _ in range(count):
            offset = offset + 3 & -4
            (length,) = self._length(data, offset)
            offset += 4
            end = offset + length
            if length:
                if data[end - 1]:
                    raise RemoteProtocolError(f"{self._path}: a string without its end")
                if self._bound and length - 1 > self._bound:
                    raise RemoteProtocolError(f"{self._path}: a string is longer than {self._bound} bytes")
                values.append(data[offset : end - 1].decode("utf-8", "replace"))
                offset = end
            else:
                values.append("")
        if offset - start <= _SHORT:
            self._last = (count, data[start:offset], values.copy())
        return values, offset


def make_parser(definition: Definition, lookup: Lookup, cls: type, *, little: bool) -> Callable[[bytes], Any]:
    """Make the function that turns bytes into a message; it gets the whole message, with its header.

    The function raises `RemoteProtocolError` for anything that is not such a message. Lists that it makes are at
    most as long as the bytes allow, whatever a length in them says.
    """
    code = _Code("def run(d):")
    code.names["new"] = object.__new__
    code.names["Fault"] = RemoteProtocolError
    order = "<" if little else ">"
    code.add("o, end = 4, len(d)")
    code.add(f"m = new({code.new('C', cls)})")
    _parse_fields(code, definition, "m", lookup, order, definition.name.rpartition("/")[2])
    _flush_unpacks(code, order)
    code.add("return m, o")
    return code.compile()


def _flush_unpacks(code: _Code, order: str) -> None:
    if not code.group:
        return
    codes = code.codes()
    targets = ", ".join(target for _, _, target in code.group) + ","
    if code.offset.known(max(_CODES[each] for each, _ in codes)):
        text, after = _layout(codes, code.offset.rest)
        unpack = code.new("unpack", struct.Struct(order + text).unpack_from)
        code.add(f"{targets} = {unpack}(d, o)")
        code.add(f"o += {after - code.offset.rest}")
    else:
        # Offsets here count from the beginning of the header, which has four bytes.
        starts = [(offset - 4) % 8 for offset in range(8)]
        formats = [struct.Struct(order + _layout(codes, start)[0]) for start in starts]
        table = code.new("unpacks", tuple((each.unpack_from, each.size) for each in formats))
        code.add(f"u, z = {table}[o & 7]")
        code.add(f"{targets} = u(d, o)")
        code.add("o += z")
    code.offset.after(codes)
    code.group = []


def _parse_fields(code: _Code, definition: Definition, owner: str, lookup: Lookup, order: str, path: str) -> None:
    if not definition.fields:
        code.group.append(("B", 1, "_"))
    for field in definition.fields:
        _parse_field(code, field, f"{owner}.{field.name}", lookup, order, f"{path}.{field.name}")


def _parse_field(code: _Code, field: Field, target: str, lookup: Lookup, order: str, path: str) -> None:
    type_ = field.type
    if type_.kind is Kind.ONE:
        _parse_one(code, type_, target, lookup, order, path)
        return
    count = str(type_.size)
    if type_.kind is not Kind.ARRAY:
        count = code.new("n")
        code.group.append(("I", 1, count))
    _flush_unpacks(code, order)
    if type_.kind is Kind.BOUNDED:
        code.add(f"if {count} > {type_.size}: raise Fault(f'{path}: {{{count}}} values, at most {type_.size}')")
    too_many = f"raise Fault(f'{path}: {{{count}}} values do not fit into the message')"
    if type_.is_octets:
        code.add(f"if {count} > end - o: {too_many}")
        code.add(f"{target} = d[o:o + {count}]")
        code.add(f"o += {count}")
        code.offset.forget()
    elif type_.base == "string":
        if type_.kind is Kind.ARRAY:
            code.add("o = o + 3 & -4")
        parser = code.new("strings", _StringParser(order, type_.bound, path))
        code.add(f"{target}, o = {parser}(d, o, {count})")
        code.offset.forget()
    elif type_.is_message:
        least = _smallest(lookup(type_.base)[0], lookup)
        code.add(f"if {count} * {least} > end - o: {too_many}")
        items, item = code.new("xs"), code.new("x")
        code.add(f"{items} = {target} = []")
        code.add(f"for _ in range({count}):")
        code.depth += 1
        code.offset.forget()
        _parse_one(code, FieldType(type_.base), item, lookup, order, path)
        _flush_unpacks(code, order)
        code.add(f"{items}.append({item})")
        code.depth -= 1
        code.offset.forget()
    else:
        letter, size = PRIMITIVES[type_.base]
        parser = code.new("numbers", _NumberParsers(order, letter))
        code.add(f"if {count}:")
        code.depth += 1
        if size > 1:
            code.add("o = (o + 3 & -8) + 4" if size == 8 else f"o = o + {size - 1} & -{size}")
        code.add(f"if {count} * {size} > end - o: {too_many}")
        code.add(f"{target} = list({parser}({count})(d, o))")
        code.add(f"o += {count} * {size}")
        code.depth -= 1
        code.add(f"else: {target} = []")
        code.offset.forget(min(size, 4) if type_.kind is not Kind.ARRAY else size)


def _parse_one(code: _Code, type_: FieldType, target: str, lookup: Lookup, order: str, path: str) -> None:
    if type_.is_message:
        definition, cls = lookup(type_.base)
        local = code.new("m")
        code.add(f"{local} = {target} = new({code.new('C', cls)})")
        _parse_fields(code, definition, local, lookup, order, path)
    elif type_.base == "string":
        length = code.new("n")
        code.group.append(("I", 1, length))
        _flush_unpacks(code, order)
        code.add(f"if {length}:")
        code.depth += 1
        code.add(f"e = o + {length}")
        code.add(f"if d[e - 1]: raise Fault('{path}: a string without its end')")
        if type_.bound:
            code.add(f"if {length} > {type_.bound + 1}: raise Fault('{path}: longer than {type_.bound} bytes')")
        code.add(f"{target} = d[o:e - 1].decode('utf-8', 'replace')")
        code.add("o = e")
        code.depth -= 1
        code.add(f"else: {target} = ''")
        code.offset.forget()
    else:
        code.group.append((PRIMITIVES[type_.base][0], 1, target))
