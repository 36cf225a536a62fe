"""Messages, docstrings and documents are plain: no program that tells, and no sentence that is too long to read."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest
from places import DOCS, ROOT

import metrocli

MODULES = sorted(Path(metrocli.__file__).parent.rglob("*.py"))
BENCHMARKS = sorted((ROOT / "benchmarks").rglob("*.py"))
PAGES = sorted(
    [*DOCS.rglob("*.md"), ROOT / "README.md", ROOT / "CHANGELOG.md", *(ROOT / "sample_projects").rglob("*.md")]
)
MOST_WORDS = 40
ODD = re.compile(r"\b(told|tells|says|told of|is none|say of|says of)\b", re.IGNORECASE)
"""Programs and numbers do not speak; somebody who does would be named"""
NOT_PROSE = re.compile(r"```.*?```|^( {4}|\t|\|).*?$|`[^`]*`|https?://\S+", re.DOTALL | re.MULTILINE)


def shown(path: Path) -> str:
    return str(path.relative_to(ROOT))


def texts_of_module(path: Path) -> Iterator[str]:
    """Docstrings, messages and comments."""
    source = path.read_text(encoding="utf-8")
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.JoinedStr):
            yield "".join(str(part.value) if isinstance(part, ast.Constant) else "x" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield token.string.lstrip("# ")


def paragraphs(text: str) -> Iterator[str]:
    """Running text: paragraphs, and each item of a list and cell of a table on its own."""
    for part in re.split(r"\n\s*\n|\n\s*(?=[-*] |\d+\. |#)", text):
        yield " ".join(part.split())


def sentences(text: str) -> Iterator[str]:
    for paragraph in paragraphs(text):
        yield from re.split(r"(?<=[.!?])\s+", paragraph)


def prose(path: Path) -> str:
    """A page without code and tables."""
    return NOT_PROSE.sub("x", path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("path", [*MODULES, *BENCHMARKS], ids=shown)
def test_modules_speak_plainly(path: Path) -> None:
    odd = [text for text in texts_of_module(path) if ODD.search(text)]
    assert not odd, odd


@pytest.mark.parametrize("path", MODULES, ids=shown)
def test_sentences_of_modules_are_short(path: Path) -> None:
    found = [one for text in texts_of_module(path) for one in sentences(text) if len(one.split()) > MOST_WORDS]
    assert not found, found


@pytest.mark.parametrize("path", PAGES, ids=shown)
def test_pages_speak_plainly(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    odd = [text[max(hit.start() - 40, 0) : hit.end() + 20] for hit in ODD.finditer(text)]
    assert not odd, odd


@pytest.mark.parametrize("path", PAGES, ids=shown)
def test_sentences_of_pages_are_short(path: Path) -> None:
    found = [one for one in sentences(prose(path)) if len(one.split()) > MOST_WORDS]
    assert not found, found
