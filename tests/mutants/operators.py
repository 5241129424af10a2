"""The small wrong changes that can be made to a piece of Python source."""

from __future__ import annotations

import ast
import copy
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass


@dataclass(frozen=True)
class Mutant:
    """One small wrong change of one file."""

    path: str
    """From the root of the tree."""
    function: str
    """Qualified name of the function around it; '' at the level of the module."""
    operator: str
    line: int
    """Of its begin, from 1."""
    start: int
    """Of the text that is replaced, in bytes from the begin of the file."""
    end: int
    old: str
    new: str

    @property
    def key(self) -> str:
        """What it changes, wherever the lines have moved to."""
        one_line = re.compile(r"\s+")
        old, new = (one_line.sub(" ", text).strip() for text in (self.old, self.new))
        return f"{self.path} :: {self.function} :: {old} => {new}"

    def applied(self, source: bytes) -> bytes:
        """The file with the change."""
        return source[: self.start] + self.new.encode() + source[self.end :]


Change = tuple[str, ast.AST]
Operator = Callable[[ast.AST], Iterator[Change]]

OPPOSITE: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Gt: ast.LtE, ast.GtE: ast.Lt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip
EDGE: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt,
}  # fmt: skip
SIGN: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult,
}  # fmt: skip
OTHER_NAME = {
    "min": "max", "max": "min", "any": "all", "all": "any", "ceil": "floor", "floor": "ceil",
    "minimum": "maximum", "maximum": "minimum", "argmin": "argmax", "argmax": "argmin",
}  # fmt: skip


def changed(node: ast.AST, **fields: object) -> ast.AST:
    """A copy with other fields."""
    made = copy.deepcopy(node)
    for name, value in fields.items():
        setattr(made, name, value)
    return made


def comparison(node: ast.AST) -> Iterator[Change]:
    """Turned round, or moved by its edge."""
    if isinstance(node, ast.Compare):
        for place, op in enumerate(node.ops):
            for name, table in (("comparison swapped", OPPOSITE), ("edge moved", EDGE)):
                if type(op) in table:
                    ops = [*node.ops[:place], table[type(op)](), *node.ops[place + 1 :]]
                    yield name, changed(node, ops=ops)


def constant(node: ast.AST) -> Iterator[Change]:
    """Another number, or the other truth value."""
    if isinstance(node, ast.Constant):
        value = node.value
        if isinstance(value, bool):
            yield "constant changed", ast.Constant(not value)
        elif isinstance(value, int):
            yield "constant changed", ast.Constant(value + 1)
            if value > 1:
                yield "constant changed", ast.Constant(value - 1)
        elif isinstance(value, float):
            yield "constant changed", ast.Constant(value * 2.0 if value else 1.0)


def logic(node: ast.AST) -> Iterator[Change]:
    """And for or, or for and; a not dropped."""
    if isinstance(node, ast.BoolOp):
        yield "and/or", changed(node, op=ast.Or() if isinstance(node.op, ast.And) else ast.And())
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield "not dropped", node.operand


def arithmetic(node: ast.AST) -> Iterator[Change]:
    """Another sign, the inverse, or the other extreme."""
    if isinstance(node, ast.BinOp) and type(node.op) in SIGN:
        yield "sign flipped", changed(node, op=SIGN[type(node.op)]())
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        yield "sign flipped", node.operand
    if isinstance(node, ast.Call):
        name = node.func
        if isinstance(name, ast.Name) and name.id in OTHER_NAME:
            yield "other extreme", changed(node, func=ast.Name(OTHER_NAME[name.id]))
        if isinstance(name, ast.Attribute) and name.attr in OTHER_NAME:
            func = changed(name, attr=OTHER_NAME[name.attr])
            yield "other extreme", changed(node, func=func)


def boundary(node: ast.AST) -> Iterator[Change]:
    """A slice or a range that ends one later."""
    if isinstance(node, ast.Slice):
        for end in ("lower", "upper"):
            bound = getattr(node, end)
            if bound is not None and not isinstance(bound, ast.Constant):
                later = ast.BinOp(bound, ast.Add(), ast.Constant(1))
                yield "off by one", changed(node, **{end: later})
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "range":
        sooner = ast.BinOp(node.args[-1], ast.Sub(), ast.Constant(1))
        yield "off by one", changed(node, args=[*node.args[:-1], sooner])


def argument(node: ast.AST) -> Iterator[Change]:
    """A keyword argument dropped."""
    if isinstance(node, ast.Call):
        for place, given in enumerate(node.keywords):
            if given.arg is not None:
                rest = node.keywords[:place] + node.keywords[place + 1 :]
                yield "argument dropped", changed(node, keywords=rest)


def statement(node: ast.AST) -> Iterator[Change]:
    """A call, an assignment to a place, a raise or a jump that does not happen."""
    lasting = (ast.Attribute, ast.Subscript)
    if (
        isinstance(node, ast.Raise | ast.Continue | ast.Break | ast.Delete)
        or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Call))
        or (isinstance(node, ast.Assign) and isinstance(node.targets[0], lasting))
        or (isinstance(node, ast.AugAssign))
    ):
        yield "statement dropped", ast.Pass()
    if isinstance(node, ast.Return) and node.value is not None:
        if not (isinstance(node.value, ast.Constant) and node.value.value is None):
            yield "return value changed", changed(node, value=ast.Constant(None))


def caught(node: ast.AST) -> Iterator[Change]:
    """An except (or a suppress) that takes less, or more."""
    if isinstance(node, ast.Tuple) and getattr(node, "caught", False):
        for place in range(len(node.elts)):
            rest = node.elts[:place] + node.elts[place + 1 :]
            yield "except narrowed", changed(node, elts=rest)
    elif getattr(node, "caught", False):
        yield "except narrowed", ast.Tuple([])
    if getattr(node, "caught", False) and ast.unparse(node) not in ("Exception", "BaseException"):
        yield "except broadened", ast.Name("Exception")
    if isinstance(node, ast.Call) and ast.unparse(node.func) == "suppress":
        for place in range(len(node.args)):
            rest = node.args[:place] + node.args[place + 1 :]
            yield "except narrowed", changed(node, args=rest)


OPERATORS: tuple[Operator, ...] = (
    comparison, constant, logic, arithmetic, boundary, argument, statement, caught,
)  # fmt: skip

WORDS = re.compile(r"^(logger\.|log\.(debug|info|warn)|warnings\.|print\(|parser\.add|.*\.help)")


def worked(node: ast.AST) -> list[ast.AST]:
    """The children in which a change is one of what the program does.

    Not of what it says (docstrings, log lines, messages of errors) nor of its types.
    """
    if isinstance(node, ast.JoinedStr) or (
        isinstance(node, ast.ClassDef) and any("Protocol" in ast.unparse(b) for b in node.bases)
    ):
        return []
    if isinstance(node, ast.Raise):
        return []
    if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
        return []
    if isinstance(node, ast.Expr) and WORDS.match(ast.unparse(node)):
        return []
    types = ("annotation", "returns", "decorator_list", "type_params", "bases")
    found: list[ast.AST] = []
    for name, value in ast.iter_fields(node):
        if name not in types:
            nodes = value if isinstance(value, list) else [value]
            found += [child for child in nodes if isinstance(child, ast.AST)]
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
        words = isinstance(node, ast.Expr) and WORDS.match(ast.unparse(node))
        if hasattr(node, "end_col_offset") and not words:
            where: ast.expr = node  # type: ignore[assignment]
            start = lines[where.lineno - 1] + where.col_offset
            end = lines[(where.end_lineno or 0) - 1] + (where.end_col_offset or 0)
            for operator in OPERATORS:
                for name, made in operator(node):
                    old = source[start:end].decode()
                    new = ast.unparse(ast.fix_missing_locations(made))
                    found.append(Mutant(path, function, name, where.lineno, start, end, old, new))
        for child in worked(node):
            walk(child, function)

    walk(ast.parse(source), "")
    return [one for one in found if _compiles(one.applied(source))]


def _compiles(source: bytes) -> bool:
    try:
        ast.parse(source)
    except SyntaxError:
        return False
    return True
