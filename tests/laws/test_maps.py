"""The docstring of a package is a map of it: each module that it names exists."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

import metrocli

ROOT = Path(metrocli.__file__).parent
PACKAGES = sorted(path.parent for path in ROOT.rglob("__init__.py"))
NAME = re.compile(r"`([a-z][a-z0-9_.]*)`|(?<![/\w])([a-z][a-z0-9_]*)\.py\b")
"""A name in backquotes, or of a file; keys, options and calls have other signs"""
MOST_WITHOUT_MAP = 5
"""Most modules of a package whose docstring names none of them"""


def doc(package: Path) -> str:
    return ast.get_docstring(ast.parse((package / "__init__.py").read_text(encoding="utf-8"))) or ""


@cache
def within(package: Path) -> frozenset[str]:
    """The modules and packages in a package, at any depth."""
    inside = [path for path in package.rglob("*") if path.suffix == ".py" or (path / "__init__.py").exists()]
    return frozenset(path.stem for path in inside)


def known(package: Path) -> set[str]:
    """What a map may name: what is in the package, at any depth, and what is beside it and beside its parents."""
    above = [parent for parent in package.parents if parent.is_relative_to(ROOT)]
    return {*within(package), *(path.stem for parent in above for path in parent.iterdir())}


def missing(package: Path, text: str) -> list[str]:
    names = [first or second for first, second in NAME.findall(text)]
    return [name for name in names if not {*name.split(".")} <= known(package)]


@pytest.mark.parametrize("package", PACKAGES, ids=lambda path: str(path.relative_to(ROOT.parent)))
def test_a_map_names_modules_that_exist(package: Path) -> None:
    assert not missing(package, doc(package))
    assert missing(package, "first `no_such` (no_file.py)") == ["no_such", "no_file"]


@pytest.mark.parametrize("package", PACKAGES, ids=lambda path: str(path.relative_to(ROOT.parent)))
def test_a_large_package_has_a_map(package: Path) -> None:
    modules = {path.stem for path in package.glob("*.py")} - {"__init__"}
    named = {name for names in NAME.findall(doc(package)) for name in names}
    assert len(modules) <= MOST_WITHOUT_MAP or modules & named, package
