"""Find and place small planted errors (mutants) in Python source."""

import ast
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass

__all__ = ["OPERATORS", "Mutant", "mutants_of"]

OPERATORS = ("sign", "comparator", "constant", "term", "off by one")
NEGATED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.GtE,
    ast.LtE: ast.Gt,
    ast.Gt: ast.LtE,
    ast.GtE: ast.Lt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
BOUNDARY: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
}
FACTOR = 1.1
"""Factor of a changed constant."""
SKIPPED_CALLS = (
    "require_",
    "_require",
    "InputError",
    "set_module_options",
    "warn",
    "register_at_fork",
)
"""Calls that check or report instead of compute, by the start of their name."""
SKIPPED_NAMES = ("__all__", "__slots__")


@dataclass(frozen=True)
class Mutant:
    """One planted error.

    Attributes
    ----------
    module
        Dotted name of the module.
    scope
        Qualified name of the function, or ``<module>``.
    operator
        One of `OPERATORS`.
    change
        Normalised text of the smallest expression that holds the error, before and after.
    ordinal
        Number of the same change within the scope, from 0.
    span
        Start and end of the replaced text [bytes].
    text
        Replacement.
    """

    module: str
    scope: str
    operator: str
    change: str
    ordinal: int
    span: tuple[int, int]
    text: str

    @property
    def place(self) -> str:
        """Address within any module."""
        return f"{self.scope} | {self.operator} | {self.change} | {self.ordinal}"

    @property
    def address(self) -> str:
        """Address that survives edits elsewhere in the module."""
        return f"{self.module} | {self.place}"

    def applied(self, source: str) -> str:
        """Return the source with this error."""
        data = source.encode()
        start, end = self.span
        return (data[:start] + self.text.encode() + data[end:]).decode()


def mutants_of(module: str, source: str) -> list[Mutant]:
    """List all mutants of a module in the order of its text."""
    walk = _Walk(module, source)
    walk.body(ast.parse(source), "<module>")
    return walk.found


class _Walk:
    """Walk through a syntax tree with the qualified name of the scope."""

    def __init__(self, module: str, source: str) -> None:
        self.module = module
        self.found: list[Mutant] = []
        self._counts: Counter[str] = Counter()
        self._starts = [0]
        for line in source.encode().splitlines(keepends=True):
            self._starts.append(self._starts[-1] + len(line))

    def body(self, node: ast.AST, scope: str) -> None:
        """Visit the statements of a module, class or function."""
        for statement in node.body:
            self._statement(statement, scope)

    def _statement(self, node: ast.stmt, scope: str) -> None:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            self.body(node, node.name if scope == "<module>" else f"{scope}.{node.name}")
            return
        if _is_skipped(node):
            return
        if isinstance(node, ast.AugAssign | ast.Expr) and scope != "<module>":
            self._add(scope, "term", node, node, "pass")
        if isinstance(node, ast.AugAssign) and isinstance(node.op, ast.Add | ast.Sub):
            other = ast.Sub() if isinstance(node.op, ast.Add) else ast.Add()
            changed = ast.AugAssign(node.target, other, node.value)
            self._add(scope, "sign", node, node, ast.unparse(changed))
        for child in _parts(node):
            if isinstance(child, ast.stmt):
                self._statement(child, scope)
            else:
                self._expression(child, node, scope)

    def _expression(self, node: ast.AST, parent: ast.AST, scope: str) -> None:
        if isinstance(node, ast.JoinedStr):
            return
        if isinstance(node, ast.Call) and _name(node.func).startswith(SKIPPED_CALLS):
            return
        for operator, changed in _changes(node, parent):
            self._add(scope, operator, node, parent, changed)
        for child in _parts(node):
            self._expression(child, node, scope)

    def _add(
        self, scope: str, operator: str, node: ast.AST, parent: ast.AST, changed: ast.AST | str
    ) -> None:
        """Book a mutant; a constant is shown within the expression around it."""
        shown = parent if isinstance(node, ast.Constant) else node
        before = ast.unparse(shown)
        if isinstance(changed, str):
            after = text = changed
        else:
            after = _with(shown, node, changed)
            text = ast.unparse(changed)
            if not isinstance(changed, ast.Constant):
                text = f"({text})"
        change = f"{before}  ->  {after}".replace("\n", " ")
        key = f"{scope} | {operator} | {change}"
        start = self._starts[node.lineno - 1] + node.col_offset
        end = self._starts[node.end_lineno - 1] + node.end_col_offset
        self.found.append(
            Mutant(self.module, scope, operator, change, self._counts[key], (start, end), text)
        )
        self._counts[key] += 1


def _changes(node: ast.AST, parent: ast.AST) -> Iterator[tuple[str, ast.expr]]:
    """Yield the changes of one expression."""
    if isinstance(node, ast.BinOp) and not _is_text(node.left) and not _is_text(node.right):
        left, right = node.left, node.right
        if isinstance(node.op, ast.Add | ast.Sub):
            other = ast.Sub() if isinstance(node.op, ast.Add) else ast.Add()
            yield "sign", ast.BinOp(left, other, right)
            yield "term", left
            yield "term", right if isinstance(node.op, ast.Add) else ast.UnaryOp(ast.USub(), right)
        elif isinstance(node.op, ast.Mult):
            yield "term", left
            yield "term", right
        elif isinstance(node.op, ast.Div | ast.Pow):
            yield "term", left
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        if not (
            isinstance(node.operand, ast.Constant) and isinstance(parent, ast.Subscript | ast.Slice)
        ):
            yield "sign", node.operand
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        yield "comparator", node.operand
    elif isinstance(node, ast.Compare) and len(node.ops) == 1:
        kind = type(node.ops[0])
        yield "comparator", ast.Compare(node.left, [NEGATED[kind]()], node.comparators)
        counts = any(
            isinstance(side, ast.Constant) and type(side.value) is int
            for side in (node.left, *node.comparators)
        )
        if kind in BOUNDARY and (counts or isinstance(parent, ast.While)):
            yield "off by one", ast.Compare(node.left, [BOUNDARY[kind]()], node.comparators)
    elif isinstance(node, ast.BoolOp):
        for values in (node.values[1:], node.values[:-1]):
            yield "term", values[0] if len(values) == 1 else ast.BoolOp(node.op, values)
    elif isinstance(node, ast.Constant) and type(node.value) is float and node.value != 0.0:
        yield "constant", ast.Constant(node.value * FACTOR)
    elif isinstance(node, ast.Constant) and type(node.value) is int and _is_counted(node, parent):
        yield "off by one", ast.Constant(node.value + 1)


def _is_counted(node: ast.Constant, parent: ast.AST) -> bool:
    """Return True if an integer is an index, a bound, a count or a term."""
    if isinstance(parent, ast.Call):
        return _name(parent.func) == "range"
    return isinstance(parent, ast.Subscript | ast.Slice | ast.BinOp)


def _parts(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the parts of a node in which errors may be planted."""
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns", "decorator_list", "type_params", "ctx", "op", "ops"):
            continue
        if isinstance(node, ast.Lambda) and name == "args":
            continue
        for part in value if isinstance(value, list) else [value]:
            if isinstance(part, ast.AST):
                yield part


def _is_skipped(node: ast.stmt) -> bool:
    """Return True if a statement only documents, imports, checks or raises."""
    if isinstance(
        node, ast.Raise | ast.Assert | ast.Import | ast.ImportFrom | ast.AsyncFunctionDef
    ):
        return True
    if isinstance(node, ast.If) and isinstance(node.body[-1], ast.Raise) and not node.orelse:
        return True
    if isinstance(node, ast.If) and _name(node.test) == "TYPE_CHECKING":
        return True
    if isinstance(node, ast.Expr):
        value = node.value
        return not isinstance(value, ast.Call) or _name(value.func).startswith(SKIPPED_CALLS)
    return isinstance(node, ast.Assign) and any(
        _name(target) in SKIPPED_NAMES for target in node.targets
    )


def _is_text(node: ast.AST) -> bool:
    """Return True if an operand is text or a sequence."""
    if isinstance(node, ast.JoinedStr | ast.List | ast.Tuple | ast.Dict | ast.ListComp):
        return True
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def _name(node: ast.AST) -> str:
    """Last part of a name."""
    if isinstance(node, ast.Attribute):
        return node.attr
    return node.id if isinstance(node, ast.Name) else ""


def _with(parent: ast.AST, node: ast.AST, changed: ast.AST) -> str:
    """Text of a parent in which a node is replaced."""
    if parent is node:
        return ast.unparse(changed)
    set_back: list[Callable[[], None]] = []
    for name, value in ast.iter_fields(parent):
        if value is node:
            setattr(parent, name, changed)
            set_back.append(lambda name=name: setattr(parent, name, node))
        elif isinstance(value, list):
            for at, each in enumerate(value):
                if each is node:
                    value[at] = changed
                    set_back.append(lambda value=value, at=at: value.__setitem__(at, node))
    text = ast.unparse(parent)
    for undo in set_back:
        undo()
    return text
