"""Messages, docstrings and documents are plain: no program that tells, and no sentence that is too long to read."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

from laws.trees import nodes
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


@cache
def texts_of_module(path: Path) -> list[str]:
    """Docstrings, messages and comments."""
    found = []
    for node in nodes(path):
        if isinstance(node, ast.JoinedStr):
            found.append("".join(str(part.value) if isinstance(part, ast.Constant) else "x" for part in node.values))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            found.append(node.value)
    lines = path.read_text(encoding="utf-8").splitlines()
    return found + [line.partition("# ")[2] for line in lines if "# " in line]


def texts(paths: Iterable[Path]) -> Iterator[tuple[Path, str]]:
    for path in paths:
        yield from ((path, text) for text in texts_of_module(path))


def paragraphs(text: str) -> Iterator[str]:
    """Running text: paragraphs, and each item of a list and cell of a table on its own."""
    for part in re.split(r"\n\s*\n|\n\s*(?=[-*] |\d+\. |#)", text):
        yield " ".join(part.split())


def sentences(text: str) -> Iterator[str]:
    for paragraph in paragraphs(text):
        yield from re.split(r"(?<=[.!?])\s+", paragraph)


def prose(path: Path) -> str:
    """A page without code and tables, of which any number of rows is one word."""
    return re.sub(r"^(?:x\n)+", "x\n", NOT_PROSE.sub("x", path.read_text(encoding="utf-8")), flags=re.MULTILINE)


def odd_words(text: str) -> list[str]:
    return [text[max(hit.start() - 40, 0) : hit.end() + 20] for hit in ODD.finditer(text)]


def long_sentences(text: str) -> list[str]:
    return [sentence for sentence in sentences(text) if len(sentence.split()) > MOST_WORDS]


def test_modules_speak_plainly() -> None:
    assert not [(shown(path), odd) for path, text in texts(MODULES + BENCHMARKS) if (odd := odd_words(text))]


def test_sentences_of_modules_are_short() -> None:
    assert not [(shown(path), long) for path, text in texts(MODULES) if (long := long_sentences(text))]


def test_pages_speak_plainly() -> None:
    assert not [(shown(path), odd) for path in PAGES if (odd := odd_words(path.read_text(encoding="utf-8")))]


def test_sentences_of_pages_are_short() -> None:
    assert not [(shown(path), long) for path in PAGES if (long := long_sentences(prose(path)))]


def test_odd_words_and_long_sentences_are_found(tmp_path: Path) -> None:
    module = tmp_path / "x.py"
    module.write_text(f'def f(x):\n    # it tells\n    return f"{{x}} is none"\n\n\n"""{"word " * 41}"""\n')
    found = [text for _, text in texts([module])]
    assert sorted(odd_words(text) for text in found if odd_words(text)) == [[" is none"], ["it tells"], ["x is none"]]
    assert [len(long_sentences(text)) for text in found if long_sentences(text)] == [1]
