"""Small changes to a module's source, each of which a test should notice.

A mutant replaces one piece of the text, an expression or a statement, and leaves the rest as it is, so that its difference
to the source is as short as the change.  Annotations, decorators, messages of errors and text stay unchanged.
"""

from __future__ import annotations

import ast
import difflib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

_COMPARISONS = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
_OPERATORS = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
_PAIRS = (
    ("min", "max"),
    ("minimum", "maximum"),
    ("argmin", "argmax"),
    ("any", "all"),
    ("floor", "ceil"),
    ("sin", "cos"),
    ("zeros", "ones"),
    ("zeros_like", "ones_like"),
)
_SWAPPED_CALLS = {**dict(_PAIRS), **{second: first for first, second in _PAIRS}}
# Calls replaced by their first argument, and methods replaced by their object.
_PASSED_THROUGH = {"abs", "clip", "sort"}
_PASSED_THROUGH_METHODS = {"copy"}
# Arguments that only guard against errors in the program itself, or change the time and nothing else.
_NOT_SEEN = {"strict", "balanced_tree", "skip_materials", "workers"}


@dataclass(frozen=True)
class Mutant:
    """One change of one module."""

    path: Path
    """Of the module, relative to the project."""
    function: str
    """Qualified name of the function changed, empty at the module's level."""
    lines: tuple[int, int]
    """First and last line of the statement: a test that runs none of the lines from the first to the last can't notice."""
    names: tuple[str, ...]
    """Names that the statement assigns, if it stands at the module's level."""
    start: int
    """Byte of the source at which the replaced text starts."""
    end: int
    new: str
    source: bytes
    number: int = 1
    """Of the changes with the same label: a line may hold the same text twice."""

    @property
    def old(self) -> str:
        return self.source[self.start : self.end].decode()

    @property
    def text(self) -> str:
        """The changed module."""
        return (self.source[: self.start] + self.new.encode() + self.source[self.end :]).decode()

    @property
    def label(self) -> str:
        """The change in one line, which stays the same when the module moves or code around the function changes."""
        first = self.source.rfind(b"\n", 0, self.start) + 1
        line = self.source[first : self.source.find(b"\n", self.start)].decode().strip()
        change = f"`{_on_one_line(self.old)}` → `{_on_one_line(self.new)}`"
        which = f" ({self.number})" if self.number > 1 else ""
        return f"`{self.function or 'module'}`: `{line}`: {change}{which}"

    @property
    def diff(self) -> str:
        before, after = self.source.decode().splitlines(True), self.text.splitlines(True)
        return "".join(difflib.unified_diff(before, after, f"a/{self.path}", f"b/{self.path}", n=2))


def mutants(root: Path, path: Path) -> list[Mutant]:
    """All mutants of the module at `path` relative to `root`, in the order of the source."""
    source = (root / path).read_bytes()
    tree = ast.parse(source)
    line_starts = [0]
    for line in source.splitlines(True):
        line_starts.append(line_starts[-1] + len(line))
    found = {}
    for place in _places(tree):
        for node, new in _changes(place):
            start = line_starts[node.lineno - 1] + node.col_offset
            assert node.end_lineno is not None
            assert node.end_col_offset is not None
            end = line_starts[node.end_lineno - 1] + node.end_col_offset
            if source[start:end].decode() != new:
                mutant = Mutant(path, place.function, place.lines, place.names, start, end, new, source)
                found[start, end, new] = mutant
    numbers: Counter[str] = Counter()
    numbered = []
    for key in sorted(found):
        numbers[found[key].label] += 1
        numbered.append(replace(found[key], number=numbers[found[key].label]))
    return numbered


@dataclass(frozen=True)
class _Place:
    """A node, and where it stands."""

    node: ast.AST
    parent: ast.AST
    function: str
    lines: tuple[int, int]
    names: tuple[str, ...]
    assigned: frozenset[str]
    """Names that the function has assigned before this statement."""


def _places(tree: ast.Module) -> Iterator[_Place]:
    def statements(body: list[ast.stmt], parent: ast.AST, function: str, assigned: set[str]) -> Iterator[_Place]:
        for position, statement in enumerate(body):
            docstring = isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
            if docstring or isinstance(statement, (ast.Import, ast.ImportFrom, ast.Assert)):
                continue
            if isinstance(statement, ast.If) and ast.unparse(statement.test) == "TYPE_CHECKING":
                continue
            yield from one(statement, parent, function, assigned, alone=len(body) == 1 and position == 0)

    def one(statement: ast.stmt, parent: ast.AST, function: str, assigned: set[str], alone: bool) -> Iterator[_Place]:
        blocks = [getattr(statement, name, []) for name in ("body", "orelse", "finalbody")]
        blocks += [handler.body for handler in getattr(statement, "handlers", [])]
        inner = [block for block in blocks if block]
        last = inner[0][0].lineno - 1 if inner else statement.end_lineno
        lines = statement.lineno, max(statement.lineno, last or 0)
        names = () if function else tuple(sorted(_assigned(statement)))
        if isinstance(statement, (ast.FunctionDef, ast.ClassDef)):
            name = f"{function}.{statement.name}" if function else statement.name
            if isinstance(statement, ast.FunctionDef):
                # a default is computed when the module is loaded; what depends on it is the function
                whole = statement.lineno, statement.end_lineno or statement.lineno
                for default in [*statement.args.defaults, *filter(None, statement.args.kw_defaults)]:
                    yield from expressions(default, statement.args, name, whole, (), frozenset())
                arguments = {a.arg for a in [*statement.args.args, *statement.args.kwonlyargs]}
                yield from statements(statement.body, statement, name, arguments)
            else:
                yield from statements(statement.body, statement, name, set())
            return
        before = frozenset(assigned)
        yield _Place(statement, parent, function, lines, names, before)
        if isinstance(statement, ast.Raise):
            return
        for name, value in ast.iter_fields(statement):
            if name in ("body", "orelse", "finalbody", "handlers", "annotation"):
                continue
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from expressions(child, statement, function, lines, names, before)
        assigned |= _assigned(statement)
        for block in inner:
            yield from statements(block, statement, function, assigned)

    def expressions(
        node: ast.AST, parent: ast.AST, function: str, lines: tuple[int, int], names: tuple[str, ...],
        assigned: frozenset[str],
    ) -> Iterator[_Place]:  # fmt: skip
        if isinstance(node, ast.JoinedStr) or (isinstance(node, ast.keyword) and node.arg in _NOT_SEEN):
            return
        yield _Place(node, parent, function, lines, names, assigned)
        for child in ast.iter_child_nodes(node):
            yield from expressions(child, node, function, lines, names, assigned)

    return statements(tree.body, tree, "", set())


def _assigned(statement: ast.stmt) -> set[str]:
    return {n.id for n in ast.walk(statement) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}


def _changes(place: _Place) -> Iterator[tuple[ast.expr | ast.stmt, str]]:
    """Nodes to replace, and the text that replaces them."""
    node = place.node
    if isinstance(node, ast.stmt):
        yield from _statement_changes(node, place)
    elif isinstance(node, ast.Compare):
        for i, operator in enumerate(node.ops):
            for other in _COMPARISONS[type(operator)]:
                operators = [*node.ops[:i], other(), *node.ops[i + 1 :]]
                yield node, _unparsed(ast.Compare(node.left, operators, node.comparators))
    elif isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        yield node, _unparsed(ast.BinOp(node.left, _OPERATORS[type(node.op)](), node.right))
    elif isinstance(node, ast.BoolOp):
        yield node, _unparsed(ast.BoolOp(ast.And() if isinstance(node.op, ast.Or) else ast.Or(), node.values))
    elif isinstance(node, ast.UnaryOp):
        if not isinstance(node.op, ast.UAdd):
            yield node, _unparsed(node.operand)
    elif isinstance(node, ast.Constant):
        yield from _constant_changes(node)
    elif isinstance(node, ast.IfExp):
        yield node.test, _negated(node.test)
    elif isinstance(node, ast.Call):
        yield from _call_changes(node)


def _statement_changes(node: ast.stmt, place: _Place) -> Iterator[tuple[ast.expr | ast.stmt, str]]:
    if isinstance(node, (ast.If, ast.While)):
        if not isinstance(node.test, (ast.Compare, ast.Constant)):
            yield node.test, _negated(node.test)
    elif isinstance(node, ast.Return):
        if node.value is not None and ast.unparse(node.value) != "None":
            yield node, "return None"
    elif isinstance(node, (ast.Break, ast.Continue)):
        yield node, "continue" if isinstance(node, ast.Break) else "break"
    elif isinstance(node, (ast.AugAssign, ast.Raise)):
        yield node, "pass"
    elif isinstance(node, ast.Expr):
        if isinstance(node.value, ast.Call):
            yield node, "pass"
    elif isinstance(node, ast.Assign):
        stored = _assigned(node)
        if not stored or stored <= place.assigned:
            yield node, "pass"


def _constant_changes(node: ast.Constant) -> Iterator[tuple[ast.expr, str]]:
    value = node.value
    if isinstance(value, bool):
        yield node, repr(not value)
    elif isinstance(value, int):
        # one more of a large number is as good as the number
        yield node, repr(value + 1 if abs(value) < 100 else 10 * value)
    elif isinstance(value, float):
        yield node, repr(10 * value if value else 1.0)


def _call_changes(node: ast.Call) -> Iterator[tuple[ast.expr, str]]:
    function = node.func
    name = function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")
    if name in _SWAPPED_CALLS:
        swapped = _SWAPPED_CALLS[name]
        yield function, f"{_unparsed(function.value)}.{swapped}" if isinstance(function, ast.Attribute) else swapped
    if name in _PASSED_THROUGH and node.args:
        yield node, _unparsed(node.args[0])
    if name in _PASSED_THROUGH_METHODS and isinstance(function, ast.Attribute) and not node.args:
        yield node, _unparsed(function.value)
    if name == "where" and len(node.args) == 3:
        condition, first, second = node.args
        yield node, _unparsed(ast.Call(function, [condition, second, first], []))


def _negated(node: ast.expr) -> str:
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        return _unparsed(node.operand)
    return f"not {_unparsed(node)}"


def _unparsed(node: ast.expr) -> str:
    """The text of an expression, in parentheses where what stands around it could take it apart."""
    text = ast.unparse(node)
    simple = (ast.Name, ast.Constant, ast.Attribute, ast.Subscript, ast.Call, ast.Tuple, ast.List)
    return text if isinstance(node, simple) else f"({text})"


def _on_one_line(text: str) -> str:
    return " ".join(text.split())
