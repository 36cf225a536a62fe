"""Each hard algorithm has a page that its modules name, and the pages name what exists."""

from __future__ import annotations

import re
from pathlib import Path

from places import DOCS, ROOT

import metrocli

FOLDER = DOCS / "algorithms"
PAGES = sorted(path.stem for path in FOLDER.glob("*.md") if path.stem != "README")
MODULES = sorted(Path(metrocli.__file__).parent.rglob("*.py"))
PATH = re.compile(r"\b(?:metrocli|tests|docs|benchmarks)/[\w./-]*\w/?")
"""A file or folder of the project"""
PARTS = ("## Problem", "## Formulas", "## Source", "## Cost", "## What did not work")


def docstring(path: Path) -> str:
    """The docstring of a module, with which it begins: to parse all modules takes seconds."""
    found = re.match(r'"""(.*?)"""', path.read_text(encoding="utf-8"), re.DOTALL)
    return found[1] if found else ""


def pages_named_by(path: Path) -> set[str]:
    return set(re.findall(r"docs/algorithms/([\w-]+)\.md", docstring(path)))


NAMED = {path: pages for path in MODULES if (pages := pages_named_by(path))}


def page_of(name: str) -> str:
    return (FOLDER / f"{name}.md").read_text(encoding="utf-8")


def absent_paths(text: str) -> list[str]:
    """Names in capitals, as in metrocli/tasks/KIND/task.py, stand for what is added."""
    named = [path for path in PATH.findall(text) if not re.search(r"[A-Z]{3}", path.removesuffix("README.md"))]
    return [path for path in named if not (ROOT / path).exists()]


def dead_links(text: str) -> list[str]:
    return [link for link in re.findall(r"\]\(([^)#:]+)", text) if not (FOLDER / link).exists()]


def test_modules_name_every_page_and_no_other() -> None:
    assert set().union(*NAMED.values()) == set(PAGES)


def test_each_page_is_listed() -> None:
    listed = page_of("README")
    assert not [page for page in PAGES if f"[{page}]({page}.md)" not in listed]


def test_each_page_is_complete() -> None:
    assert not [(page, part) for page in PAGES for part in PARTS if part not in page_of(page)]


def test_paths_in_pages_exist() -> None:
    assert not [(page, absent) for page in [*PAGES, "README", "../adding"] if (absent := absent_paths(page_of(page)))]
    assert absent_paths("metrocli/tasks/KIND/task.py and metrocli/table.py, metrocli/no.py") == ["metrocli/no.py"]


def test_links_of_pages_lead_somewhere() -> None:
    assert not [(page, dead) for page in PAGES if (dead := dead_links(page_of(page)))]
    assert dead_links(f"[a]({PAGES[0]}.md#x) and [b](no.md)") == ["no.md"]
