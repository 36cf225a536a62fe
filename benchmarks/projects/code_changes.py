"""Changes of single expressions and statements of a module, each of which somebody could have written by mistake.

None is made only to fail at once, such as a function that returns nothing or arguments of two types that change places.
"""

from __future__ import annotations

import ast
import copy
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

COMPARED: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
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
COMPUTED: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.FloorDiv,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
NAMES = {"min": "max", "max": "min", "any": "all", "all": "any", "minimum": "maximum", "maximum": "minimum"}
Node = ast.expr | ast.stmt


@dataclass(frozen=True)
class Change:
    """Another text in place of a node."""

    path: Path
    node: Node
    text: str

    @property
    def line(self) -> int:
        return self.node.lineno

    @property
    def words(self) -> str:
        return f"{' '.join(ast.unparse(self.node).split())[:80]}  ->  {' '.join(self.text.split())[:80]}"

    def applied(self) -> str:
        """Return the text of the module with the change; columns of nodes count bytes."""
        lines = self.path.read_bytes().splitlines(keepends=True)
        first, last = self.node.lineno - 1, (self.node.end_lineno or self.node.lineno) - 1
        before = b"".join(lines[:first]) + lines[first][: self.node.col_offset]
        after = lines[last][self.node.end_col_offset :] + b"".join(lines[last + 1 :])
        return (before + self.text.encode() + after).decode()


def changes_of(path: Path) -> list[Change]:
    """Return all changes of a module."""
    module = ast.parse(path.read_text(encoding="utf-8"))
    return [Change(path, node, text) for node in _inside(module) for text in _others(node)]


def _inside(node: ast.AST) -> Iterator[Node]:
    """Yield the expressions and statements below a node that run when the program does."""
    left_out = ("annotation", "returns", "decorator_list", "bases")
    for name, value in ast.iter_fields(node):
        for below in value if isinstance(value, list) else [value]:
            if name in left_out or not isinstance(below, ast.AST) or isinstance(below, ast.JoinedStr):
                continue
            if isinstance(below, Node):
                yield below
            yield from _inside(below)


def _others(node: Node) -> Iterator[str]:
    for other in (*_expressions(node), *_statements(node)):
        text = ast.unparse(other)
        yield f"({text})" if isinstance(other, ast.expr) and not isinstance(other, ast.Constant) else text


def _expressions(node: Node) -> Iterator[ast.expr]:
    if isinstance(node, ast.Compare):
        for at, operator in enumerate(node.ops):
            for other in COMPARED[type(operator)]:
                yield _with(node, ops=[*node.ops[:at], other(), *node.ops[at + 1 :]])
    elif isinstance(node, ast.BinOp) and type(node.op) in COMPUTED:
        if not _is_text(node.left) and not _is_text(node.right):
            yield _with(node, op=COMPUTED[type(node.op)]())
    elif isinstance(node, ast.BoolOp):
        yield _with(node, op=ast.Or() if isinstance(node.op, ast.And) else ast.And())
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not | ast.Invert):
        yield node.operand
    elif isinstance(node, ast.IfExp):
        yield _with(node, body=node.orelse, orelse=node.body)
    elif isinstance(node, ast.Constant):
        yield from _constants(node)
    elif isinstance(node, ast.Attribute) and node.attr == "T":
        yield node.value
    elif isinstance(node, ast.Attribute) and node.attr in NAMES:
        yield _with(node, attr=NAMES[node.attr])
    elif isinstance(node, ast.Name) and node.id in NAMES:
        yield _with(node, id=NAMES[node.id])
    elif isinstance(node, ast.Call):
        yield from _calls(node)


def _constants(node: ast.Constant) -> Iterator[ast.expr]:
    if isinstance(node.value, bool):
        yield ast.Constant(not node.value)
    elif isinstance(node.value, int):
        yield ast.Constant(node.value + 1)
    elif isinstance(node.value, float):
        yield ast.Constant(2 * node.value or 1.0)


def _calls(node: ast.Call) -> Iterator[ast.expr]:
    """Without each named argument."""
    for keyword in node.keywords:
        yield _with(node, keywords=[other for other in node.keywords if other is not keyword])


def _statements(node: Node) -> Iterator[ast.stmt]:
    """Return what stands in place of a statement."""
    if isinstance(node, ast.AugAssign) and type(node.op) in COMPUTED:
        yield _with(node, op=COMPUTED[type(node.op)]())
    elif isinstance(node, ast.Raise | ast.Assert) or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)):
        yield ast.Pass()
    elif isinstance(node, ast.Break):
        yield ast.Continue()
    elif isinstance(node, ast.Continue):
        yield ast.Break()


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


def _with(node: Any, **fields: object) -> Any:
    made = copy.copy(node)
    for name, value in fields.items():
        setattr(made, name, value)
    return made
