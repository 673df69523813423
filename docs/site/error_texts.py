"""The error texts in the source: what a user can be told when something fails, read from the syntax trees.

Owns how a text is found: the message of every exception of hexwire that is made anywhere, of click's, and of the
few of Python that hexwire words itself. A part that is known only when it runs becomes a word in braces. A message
that comes from a variable, a constant, a function or a parameter is followed to where its words are; one that only
passes on what another error says has no words of its own. Must not know what the texts mean (``errors/*.toml``).
"""

from __future__ import annotations

import ast
import functools
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

__all__ = ["ErrorText", "error_texts", "silent"]

_FOREIGN = {
    "ClickException",
    "UsageError",
    "BadParameter",
    "ValueError",
    "TypeError",
    "ImportError",
    "PermissionError",
}
"""Exceptions of others whose words are hexwire's."""
_ADAPTS = {"format", "removeprefix", "removesuffix", "replace"}
_PREFIX = {"LeaseError": "not done: "}
_TEXT_AT = {"CommandRefusedError": 2, "StoppedError": 2, "kind": 2, "unsent": 2, "Ended": 2, "PathFault": 1}
_ENDS = {"Ended", "PathFault"}
"""No exceptions, but what a client is told in their place: the end of a goal, a violation on its path."""
_DEPTH = 4
_LETTERS = 4
"""A message with fewer letters of its own only joins others."""

Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass(slots=True)
class ErrorText:
    """A text with the places that say it.

    Attributes:
        text: The message; what differs from case to case is a word in braces.
        kinds: The exceptions that carry it.
        places: Modules, as in ``bus/setup.py``.
    """

    text: str
    kinds: set[str] = field(default_factory=set)
    places: set[str] = field(default_factory=set)


@dataclass(slots=True)
class _Module:
    name: str
    around: dict[ast.AST, ast.AST]
    functions: dict[str, list[Function]]
    calls: list[ast.Call]
    classes: list[ast.ClassDef]
    values: dict[str, list[ast.expr]]
    imported: dict[str, str]
    within: dict[ast.AST, dict[str, list[ast.expr]]]

    def function_of(self, node: ast.AST) -> Function | None:
        """The function that a node is in."""
        at: ast.AST | None = self.around.get(node)
        while at is not None and not isinstance(at, Function):
            at = self.around.get(at)
        return at


def _read(path: Path, source: Path) -> _Module:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    around: dict[ast.AST, ast.AST] = {}
    functions: dict[str, list[Function]] = {}
    imported: dict[str, str] = {}
    nodes = _walk(tree, around)
    for node in nodes:
        if isinstance(node, Function):
            functions.setdefault(node.name, []).append(node)
        elif isinstance(node, ast.ImportFrom):
            imported |= {one.asname or one.name: one.name for one in node.names}
    name = path.relative_to(source).as_posix()
    calls = [node for node in nodes if isinstance(node, ast.Call)]
    classes = [node for node in nodes if isinstance(node, ast.ClassDef)]
    return _Module(name, around, functions, calls, classes, _assignments(nodes), imported, {})


def _walk(tree: ast.AST, around: dict[ast.AST, ast.AST]) -> list[ast.AST]:
    """All nodes of a tree; notes for each the one that it is in."""
    nodes: list[ast.AST] = [tree]
    for node in nodes:  # grows meanwhile
        for name in node._fields:
            below = getattr(node, name, None)
            for child in below if isinstance(below, list) else (below,):
                if isinstance(child, ast.AST) and not isinstance(child, ast.expr_context | ast.operator):
                    around[child] = node
                    nodes.append(child)
    return nodes


def _assignments(nodes: Iterable[ast.AST]) -> dict[str, list[ast.expr]]:
    """The values that each variable, constant and attribute gets, and what is appended to it."""
    found: dict[str, list[ast.expr]] = {}

    def note(target: ast.expr, value: ast.expr) -> None:
        if isinstance(target, ast.Name | ast.Attribute):
            found.setdefault(_last(target), []).append(value)
        elif isinstance(target, ast.Tuple):
            for each in (value.body, value.orelse) if isinstance(value, ast.IfExp) else (value,):
                if isinstance(each, ast.Tuple) and len(each.elts) == len(target.elts):
                    for one, its in zip(target.elts, each.elts, strict=True):
                        note(one, its)

    for node in nodes:
        if isinstance(node, ast.Assign):
            for target in node.targets:
                note(target, node.value)
        elif isinstance(node, ast.AnnAssign | ast.NamedExpr | ast.AugAssign) and node.value is not None:
            note(node.target, node.value)
        elif isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr == "append":
            found.setdefault(_last(node.func.value), []).extend(node.args)
    return found


class _Source:
    """All modules of some packages."""

    def __init__(self, *sources: Path) -> None:
        self.modules = [_read(path, source) for source in sources for path in sorted(source.rglob("*.py"))]
        self.kinds = self._kinds()
        self.calls: dict[str, list[tuple[_Module, ast.Call]]] = {}
        for module in self.modules:
            for call in module.calls:
                self.calls.setdefault(_last(call.func), []).append((module, call))

    def _kinds(self) -> set[str]:
        """Names of the exceptions whose words are hexwire's."""
        kinds = _FOREIGN | _ENDS | {"HexwireError", "RosError"}
        classes = [one for module in self.modules for one in module.classes]
        grown = -1
        while grown != len(kinds):
            grown = len(kinds)
            kinds |= {one.name for one in classes if kinds & {_last(base) for base in one.bases}}
        return kinds

    def sites(self) -> Iterator[tuple[_Module, ast.Call, str]]:
        """Each call that makes such an exception, with its kind."""
        for name, calls in self.calls.items():
            for module, call in calls:
                kind = name if name in self.kinds else ""
                if name == "unsent":
                    kind = "StoppedError"
                if isinstance(call.func, ast.IfExp) and _last(call.func.body) in self.kinds:
                    kind = _last(call.func.body)
                elif isinstance(call.func, ast.Name) and call.func.id not in self.kinds:
                    # kind = StoppedError if ... else CommandRefusedError
                    for value in self._assigned(module, call.func.id, module.function_of(call)):
                        if isinstance(value, ast.IfExp) and _last(value.body) in self.kinds:
                            kind = _last(value.body)
                if kind and module.name != "errors.py":
                    yield module, call, kind

    def all(self) -> Iterator[tuple[ast.Call, str, _Module, str]]:
        """Each text with the call that says it, its kind, and the module that words it."""
        for module, call, kind in self.sites():
            at = _TEXT_AT.get(_last(call.func), 0)
            given = list(call.args[at : at + 1])
            given += [one.value for one in call.keywords if one.arg in ("advice", "instead", "text", "message")]
            for node in given:
                for there, text in self.texts(module, node):
                    yield call, kind, there, text

    def texts(self, module: _Module, node: ast.expr, depth: int = 0) -> Iterator[tuple[_Module, str]]:
        """The messages that an expression may be, each with the module that words it."""
        if isinstance(node, ast.Constant):
            if isinstance(node.value, str):
                yield module, node.value
        elif isinstance(node, ast.JoinedStr):
            yield from self._joined(module, node, depth)
        elif isinstance(node, ast.IfExp):
            yield from self.texts(module, node.body, depth)
            yield from self.texts(module, node.orelse, depth)
        elif isinstance(node, ast.BoolOp):
            for value in node.values:
                yield from self.texts(module, value, depth)
        elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
            for _, left in list(self.texts(module, node.left, depth)) or [(module, f"{{{_label(node.left)}}}")]:
                rights = list(self.texts(module, node.right, depth)) or [(module, f"{{{_label(node.right)}}}")]
                yield from ((module, left + right) for _, right in rights)
        elif depth < _DEPTH:
            yield from self._followed(module, node, depth + 1)

    def _joined(self, module: _Module, node: ast.JoinedStr, depth: int) -> Iterator[tuple[_Module, str]]:
        text = "".join(
            part.value if isinstance(part, ast.Constant) else f"{{{_label(part.value)}}}"
            for part in node.values
            if isinstance(part, ast.Constant | ast.FormattedValue)
        )
        own = sum(
            len(p.value) for p in node.values if isinstance(p, ast.Constant) and any(map(str.isalpha, p.value))
        )
        if own >= _LETTERS:
            yield module, text
            return
        for part in node.values:
            if isinstance(part, ast.FormattedValue):
                yield from self.texts(module, part.value, depth + 1)

    def _followed(self, module: _Module, node: ast.expr, depth: int) -> Iterator[tuple[_Module, str]]:
        """Words that are elsewhere: of a name, an attribute, a function, a joined or adapted text."""
        if isinstance(node, ast.Name):
            yield from self._of_name(module, node, depth)
        elif isinstance(node, ast.Attribute):
            for value in self._assigned(module, node.attr, None):
                yield from self.texts(module, value, depth)
        elif isinstance(node, ast.Subscript):
            for value in self._assigned(module, _last(node.value), None):
                if isinstance(value, ast.Dict):
                    for one in value.values:
                        yield from self.texts(module, one, depth)
        elif isinstance(node, ast.List | ast.Tuple | ast.Set):
            for one in node.elts:
                yield from self.texts(module, one.value if isinstance(one, ast.Starred) else one, depth)
        elif isinstance(node, ast.GeneratorExp | ast.ListComp):
            yield from self.texts(module, node.elt, depth)
        elif isinstance(node, ast.Call):
            name = _last(node.func)
            if name == "join" and node.args:
                yield from self.texts(module, node.args[0], depth)
            elif name == "get" and isinstance(node.func, ast.Attribute):
                yield from self._followed(module, ast.Subscript(node.func.value, ast.Constant(0)), depth)
            elif name in ("format", "removeprefix", "removesuffix", "replace") and isinstance(
                node.func, ast.Attribute
            ):
                yield from self.texts(module, node.func.value, depth)
            else:
                for home in [module] if name in module.functions else self._home(module, name):
                    for function in home.functions.get(name, ()):
                        yield from self._returned(home, function, depth)

    def _returned(self, module: _Module, function: Function, depth: int) -> Iterator[tuple[_Module, str]]:
        for node in ast.walk(function):
            if isinstance(node, ast.Return | ast.Yield) and node.value is not None:
                yield from self.texts(module, node.value, depth)

    def _of_name(self, module: _Module, node: ast.Name, depth: int) -> Iterator[tuple[_Module, str]]:
        function = module.function_of(node)
        values = list(self._assigned(module, node.id, function)) if function is not None else []
        parameters = [one.arg for one in function.args.args] if function is not None else []
        keywords = [one.arg for one in function.args.kwonlyargs] if function is not None else []
        if function is not None and node.id in parameters + keywords and not values:
            at = parameters.index(node.id) - (parameters[0] in ("self", "cls")) if node.id in parameters else None
            yield from self._passed(module, function, node.id, at, depth)
            return
        for value in values or self._assigned(module, node.id, None):
            yield from self.texts(module, value, depth)
        if not values:
            for home in self._home(module, node.id):
                for value in self._assigned(home, node.id, None):
                    yield from self.texts(home, value, depth)

    def _passed(
        self, module: _Module, function: Function, name: str, at: int | None, depth: int
    ) -> Iterator[tuple[_Module, str]]:
        """What callers give as a parameter."""
        own = function.name.startswith("_")
        called = function.name
        owner = module.around.get(function)
        if called == "__init__" and isinstance(owner, ast.ClassDef):
            called, own = owner.name, owner.name.startswith("_")
        for there, call in self.calls.get(called, ()):
            if own and there is not module:
                continue
            given = [one.value for one in call.keywords if one.arg == name]
            if not given and at is not None and at < len(call.args):
                given = [call.args[at]]
            for value in given:
                yield from self.texts(there, value, depth)

    def _assigned(self, module: _Module, name: str, within: Function | None) -> list[ast.expr]:
        """The values that a variable, a constant or an attribute of the module's classes gets."""
        if within is None:
            return module.values.get(name, [])
        if within not in module.within:
            module.within[within] = _assignments(ast.walk(within))
        return module.within[within].get(name, [])

    def _home(self, module: _Module, name: str) -> Iterator[_Module]:
        """The modules from which a name may come that a module imports."""
        wanted = module.imported.get(name)
        if wanted is not None:
            yield from (one for one in self.modules if wanted in one.functions or wanted in one.values)


def _last(node: ast.AST) -> str:
    if isinstance(node, ast.Name):
        return node.id
    return node.attr if isinstance(node, ast.Attribute) else ""


def _label(node: ast.AST) -> str:
    """A word for a part that is known only when it runs."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.Name):
        return node.id.strip("_").lower()
    if isinstance(node, ast.Attribute):
        return node.attr.strip("_").lower()
    if isinstance(node, ast.IfExp):
        both = [one.value for one in (node.body, node.orelse) if isinstance(one, ast.Constant)]
        return "|".join(map(str, both)) if len(both) == 2 else _label(node.body)
    if isinstance(node, ast.Call):
        given = [one for one in node.args if not isinstance(one, ast.Constant)]
        if _last(node.func) in ("map", "sorted", "join") and given:
            return _label(given[-1])
        return _label(given[0]) if given else _label(node.func)
    if isinstance(node, ast.GeneratorExp | ast.ListComp):
        return _label(node.generators[0].iter)
    # Of a sum or product, what is not a mere number.
    parts = [child for child in ast.iter_child_nodes(node) if isinstance(child, ast.expr)]
    for child in sorted(parts, key=lambda part: isinstance(part, ast.Constant)):
        if found := _label(child):
            return found
    return ""


def error_texts(*sources: Path) -> dict[str, ErrorText]:
    """Every error text of some packages, in order.

    Args:
        sources: The folders of the packages.
    """
    return _found(*sources)[0]


def silent(*sources: Path) -> list[str]:
    """Places whose exceptions have no words that were found: they pass on those of others.

    Args:
        sources: The folders of the packages.
    """
    return _found(*sources)[1]


@functools.cache
def _found(*sources: Path) -> tuple[dict[str, ErrorText], list[str]]:
    """Both in one pass: reading a large package takes seconds, and its trees much memory."""
    every = _Source(*sources)
    found: dict[str, ErrorText] = {}
    with_words: set[ast.Call] = set()
    for call, kind, there, text in every.all():
        with_words.add(call)
        text = " ".join(text.split())
        if " " not in text or sum(map(str.isalpha, re.sub(r"\{[^}]*\}", "", text))) < _LETTERS:
            continue
        text = _PREFIX.get(kind, "") + text
        one = found.setdefault(text, ErrorText(text))
        one.kinds.add(kind)
        one.places.add(there.name)
    without = [(module, call) for module, call, _ in every.sites() if call not in with_words]
    return (
        dict(sorted(found.items())),
        [f"{module.name}:{call.lineno} {ast.unparse(call)[:150]}" for module, call in without],
    )
