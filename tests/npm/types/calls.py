"""Print the calls that pages may make, as TypeScript: names, arguments and answers as Python declares them.

What an answer holds that is a table to Python is declared in ``messages.d.ts``, as one of ``Values``; a call
without an entry there fails the check.
"""

import importlib
import pkgutil
from typing import Any

import msgspec

import hexwire.studio
from hexwire.studio.calls import all_calls

_PLAIN = {
    msgspec.inspect.NoneType: "null",
    msgspec.inspect.BoolType: "boolean",
    msgspec.inspect.IntType: "number",
    msgspec.inspect.FloatType: "number",
    msgspec.inspect.StrType: "string",
}


def typescript(kind: msgspec.inspect.Type) -> str:
    """A type in TypeScript; ``unknown`` where Python leaves it open."""
    match kind:
        case msgspec.inspect.UnionType(types=types):
            return " | ".join(typescript(one) for one in types)
        case msgspec.inspect.ListType(item_type=item) | msgspec.inspect.VarTupleType(item_type=item):
            return f"Array<{typescript(item)}>"
        case msgspec.inspect.TupleType(item_types=items):
            return f"[{', '.join(typescript(one) for one in items)}]"
        case msgspec.inspect.DictType():
            return "Record<string, unknown>"
        case msgspec.inspect.StructType(fields=fields):
            rows = (f"{row.name}{'' if row.required else '?'}: {typescript(row.type)}" for row in fields)
            return f"{{ {'; '.join(rows)} }}"
        case _:
            return _PLAIN.get(type(kind), "unknown")


def answer(name: str, act: Any) -> str:
    """What a call answers, if its annotation says all of it."""
    try:
        told = typescript(msgspec.inspect.type_info(eval(act.__annotations__["return"], {"Any": Any})))
    except NameError:
        told = "unknown"
    return f'Values["{name}"]' if "unknown" in told else told


# A module adds its calls to the table when it is imported.
for module in pkgutil.walk_packages(hexwire.studio.__path__, "hexwire.studio."):
    importlib.import_module(module.name)
print("interface Calls {")
for row in all_calls():
    args = typescript(msgspec.inspect.type_info(row.kind))
    print(f'    "{row.name}": {{ args: {args}; answer: {answer(row.name, row.act)} }};')
print("}")
