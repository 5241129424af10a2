"""The small wrong changes that can be made to a piece of Python source."""

from __future__ import annotations

import ast
import copy
import re
from collections.abc import Iterator
from dataclasses import dataclass

Change = tuple[str, ast.AST]

OPPOSITE: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Gt: ast.LtE, ast.GtE: ast.Lt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.And: ast.Or,
    ast.Or: ast.And,
}  # fmt: skip
EDGE: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt,
}  # fmt: skip
OTHER_NAME = {
    "min": "max", "max": "min", "any": "all", "all": "any", "ceil": "floor", "floor": "ceil",
    "minimum": "maximum", "maximum": "minimum", "argmin": "argmax", "argmax": "argmin",
}  # fmt: skip
WORDS = re.compile(r"^(logger\.|warnings\.|print\(|parser\.add)")
"""Statements that only say something."""
TYPED = re.compile(r"(typing\.)?Protocol\b")
"""The base of classes that only name types: not one of asyncio's protocols."""
TYPES = ("annotation", "returns", "decorator_list", "bases")


@dataclass(frozen=True)
class Mutant:
    """One small wrong change: in `path`, from byte `start` to `end`, `old` becomes `new`.

    `function` is the qualified name of what it lies in, '' at the level of the module.
    """

    path: str
    function: str
    operator: str
    line: int
    start: int
    end: int
    old: str
    new: str

    @property
    def key(self) -> str:
        """What it changes, wherever the lines have moved to."""
        old, new = (" ".join(text.split()) for text in (self.old, self.new))
        return f"{self.path} :: {self.function} :: {old} => {new}"

    def applied(self, source: bytes) -> bytes:
        """The file with the change."""
        return source[: self.start] + self.new.encode() + source[self.end :]


def _with(node: ast.AST, **fields: object) -> ast.AST:
    made = copy.deepcopy(node)
    for name, value in fields.items():
        setattr(made, name, value)
    return made


def _without(things: list[ast.expr]) -> Iterator[list[ast.expr]]:
    for place in range(len(things)):
        yield things[:place] + things[place + 1 :]


def _of_value(node: ast.AST) -> Iterator[Change]:
    """Changes of comparisons, numbers, logic and sums."""
    if isinstance(node, ast.Compare):
        for place, op in enumerate(node.ops):
            for name, table in (("comparison swapped", OPPOSITE), ("edge moved", EDGE)):
                if type(op) in table:
                    ops = [*node.ops[:place], table[type(op)](), *node.ops[place + 1 :]]
                    yield name, _with(node, ops=ops)
    if isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        value = node.value
        if isinstance(value, bool):
            yield "constant changed", ast.Constant(not value)
        else:
            more = value + 1 if isinstance(value, int) else value * 2.0 or 1.0
            yield "constant changed", ast.Constant(more)
    if isinstance(node, ast.BoolOp):
        yield "and/or", _with(node, op=OPPOSITE[type(node.op)]())
    if isinstance(node, ast.BinOp) and type(node.op) in OPPOSITE:
        yield "sign flipped", _with(node, op=OPPOSITE[type(node.op)]())
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        name = "not dropped" if isinstance(node.op, ast.Not) else "sign flipped"
        yield name, node.operand
    if isinstance(node, ast.Slice):
        for end in ("lower", "upper"):
            bound = getattr(node, end)
            if bound is not None and not isinstance(bound, ast.Constant):
                later = ast.BinOp(bound, ast.Add(), ast.Constant(1))
                yield "off by one", _with(node, **{end: later})


def _only_sure(call: ast.Call, given: ast.keyword) -> bool:
    """Whether an argument only makes sure of what holds: that zipped lists are of equal length."""
    return given.arg == "strict" and ast.unparse(call.func) == "zip"


def _of_call(node: ast.Call) -> Iterator[Change]:
    """Changes of what is called, and with what."""
    func = node.func
    name = getattr(func, "id", getattr(func, "attr", ""))
    if name in OTHER_NAME:
        field = "id" if isinstance(func, ast.Name) else "attr"
        other = _with(func, **{field: OTHER_NAME[name]})
        yield "other extreme", _with(node, func=other)
    if name == "range":
        sooner = ast.BinOp(node.args[-1], ast.Sub(), ast.Constant(1))
        yield "off by one", _with(node, args=[*node.args[:-1], sooner])
    for given in node.keywords:
        if given.arg is not None and not _only_sure(node, given):
            rest = [other for other in node.keywords if other is not given]
            yield "argument dropped", _with(node, keywords=rest)
    if name == "suppress":
        for args in _without(node.args):
            yield "except narrowed", _with(node, args=args)


def _of_statement(node: ast.AST) -> Iterator[Change]:
    """Statements that do not happen, other answers, and other errors caught."""
    lasting = (ast.Attribute, ast.Subscript)
    if (
        isinstance(node, ast.Raise | ast.Continue | ast.Break | ast.Delete | ast.AugAssign)
        or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Call))
        or (isinstance(node, ast.Assign) and isinstance(node.targets[0], lasting))
    ):
        yield "statement dropped", ast.Pass()
    if isinstance(node, ast.Return) and node.value is not None:
        yield "return value changed", _with(node, value=ast.Constant(None))
    if getattr(node, "caught", False):
        if isinstance(node, ast.Tuple):
            for elts in _without(node.elts):
                yield "except narrowed", _with(node, elts=elts)
        else:
            yield "except narrowed", ast.Tuple([])
        if ast.unparse(node) not in ("Exception", "BaseException"):
            yield "except broadened", ast.Name("Exception")


def _changes(node: ast.AST) -> Iterator[Change]:
    yield from _of_value(node)
    yield from _of_statement(node)
    if isinstance(node, ast.Call):
        yield from _of_call(node)


def _worked(node: ast.AST) -> list[ast.AST]:
    """The children in which a change is one of what the program does, not of what it says
    (docstrings, log lines, messages of errors) or makes sure of, nor of its types."""
    if isinstance(node, ast.JoinedStr | ast.Raise):
        return []
    if isinstance(node, ast.ClassDef) and any(TYPED.match(ast.unparse(b)) for b in node.bases):
        return []
    if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
        return []
    found: list[ast.AST] = []
    for name, value in ast.iter_fields(node):
        if name not in TYPES:
            nodes = value if isinstance(value, list) else [value]
            found += [child for child in nodes if isinstance(child, ast.AST)]
    if isinstance(node, ast.Call):
        sure = [given.value for given in node.keywords if _only_sure(node, given)]
        found = [c for c in found if not (isinstance(c, ast.keyword) and c.value in sure)]
    return found


def mutants(path: str, source: bytes) -> list[Mutant]:
    """All small wrong changes of a file, in the order of their places."""
    lines = [0]
    for line in source.splitlines(keepends=True):
        lines.append(lines[-1] + len(line))
    found: list[Mutant] = []

    def walk(node: ast.AST, function: str) -> None:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            function = f"{function}.{node.name}".lstrip(".")
        if isinstance(node, ast.ExceptHandler) and node.type is not None:
            node.type.caught = True  # type: ignore[attr-defined]
        if isinstance(node, ast.Expr) and WORDS.match(ast.unparse(node)):
            return
        for name, made in _changes(node):
            at: ast.expr = node  # type: ignore[assignment]
            start = lines[at.lineno - 1] + at.col_offset
            end = lines[(at.end_lineno or 0) - 1] + (at.end_col_offset or 0)
            old, new = source[start:end].decode(), ast.unparse(ast.fix_missing_locations(made))
            if new != ast.unparse(node):
                found.append(Mutant(path, function, name, at.lineno, start, end, old, new))
        for child in _worked(node):
            walk(child, function)

    walk(ast.parse(source), "")
    return found
