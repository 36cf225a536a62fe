"""Each hard algorithm has a page that its modules name, and the pages name what exists."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest
from places import DOCS, ROOT

import metrocli

FOLDER = DOCS / "algorithms"
PAGES = sorted(path.stem for path in FOLDER.glob("*.md") if path.stem != "README")
MODULES = sorted(Path(metrocli.__file__).parent.rglob("*.py"))
PATH = re.compile(r"\b(?:metrocli|tests|docs|benchmarks)/[\w./-]*\w/?")
"""A file or folder of the project"""
PARTS = ("## Problem", "## Formulas", "## Source", "## Cost", "## What did not work", "## Modules")


def docstring(path: Path) -> str:
    return ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""


def pages_named_by(path: Path) -> set[str]:
    return set(re.findall(r"docs/algorithms/([\w-]+)\.md", docstring(path)))


NAMED = {path: pages for path in MODULES if (pages := pages_named_by(path))}


@pytest.mark.parametrize("page", PAGES)
def test_a_module_names_the_page(page: str) -> None:
    assert any(page in pages for pages in NAMED.values())


@pytest.mark.parametrize("path", NAMED, ids=lambda path: str(path.relative_to(ROOT)))
def test_pages_that_a_module_names_exist(path: Path) -> None:
    assert NAMED[path] <= set(PAGES)


@pytest.mark.parametrize("page", PAGES)
def test_the_page_is_listed(page: str) -> None:
    assert f"[{page}]({page}.md)" in (FOLDER / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("page", PAGES)
def test_the_page_is_complete(page: str) -> None:
    text = (FOLDER / f"{page}.md").read_text(encoding="utf-8")
    assert [part for part in PARTS if part not in text] == []


@pytest.mark.parametrize("page", [*(f"algorithms/{page}" for page in PAGES), "algorithms/README", "adding"])
def test_paths_in_the_page_exist(page: str) -> None:
    """Names in capitals, as in metrocli/tasks/KIND/task.py, stand for what is added."""
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    found = [path for path in PATH.findall(text) if not re.search(r"[A-Z]{3}", path.removesuffix("README.md"))]
    assert [path for path in found if not (ROOT / path).exists()] == []


@pytest.mark.parametrize("page", PAGES)
def test_links_of_the_page_lead_somewhere(page: str) -> None:
    links = re.findall(r"\]\(([^)#:]+)", (FOLDER / f"{page}.md").read_text(encoding="utf-8"))
    assert [link for link in links if not (FOLDER / link).exists()] == []
