"""Syntax trees of modules, whose nodes the laws look through."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path


def nodes(path: Path) -> Iterator[ast.AST]:
    """The nodes of a module that have parts; with `ast.walk` all modules take seconds more."""
    yield from below(ast.parse(path.read_text(encoding="utf-8")))


def below(node: ast.AST) -> Iterator[ast.AST]:
    """A node and all nodes in it, but for those without parts, as `Load` is one."""
    open_nodes = [node]
    while open_nodes:
        node = open_nodes.pop()
        yield node
        for value in vars(node).values():
            if isinstance(value, list):
                open_nodes += [one for one in value if isinstance(one, ast.AST)]
            elif isinstance(value, ast.AST) and value._fields:
                open_nodes.append(value)
