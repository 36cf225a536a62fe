"""Each message that offers a correction or a guess has a row in the table of hints, with an input where it is wrong."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from hints.table import ELSEWHERE, ROWS
from laws.trees import below, nodes

import metrocli

ROOT, TESTS = Path(metrocli.__file__).parent, Path(__file__).parents[1]
GUESS = re.compile(
    r"\byou mean\b|\b(is|are|was|were|do|does|did) [^?;:,]*\?(?= |$)|\bmirrored\?"  # a question
    r"|\b(would|they) (fit|lie|if)\b|\bfits? if\b|\bread so\b|(?<!such as )\bexchanged\b|\bswapped\b"
    r"|\bcounts? the other way\b|\bother sign\b|\bwrong (sign|side)\b|\bthe mirror (image|solution)\b|\bmirror image of the\b"
    r"|\btimes as (large|far apart) as\b|\bturned by 180\b|\bin the order \{|\bare in \{\}(?! only)|\bnot the header\b"
    r"|\bis inverted\b|\buse fewer\b|\bfew degrees\b|\bperhaps\b|\bprobably\b|\bmaybe\b|\bfor such a lens\b"
    r"|\bthe lens is a\b",
    re.IGNORECASE,
)
"""Forms of sentences that offer a correction, or say what may be wrong"""
DESCRIBED = ("plots/", "report/", "exports/", "effects.py", "effects/links/", "tasks/calibrate_machine/effects/")
"""What describes results, files and effects, and offers nothing"""


@cache
def messages(path: Path) -> tuple[str, ...]:
    return tuple(_messages(path))


def _messages(path: Path) -> Iterator[str]:
    """Texts of a module but for docstrings, with {} for what is filled in."""
    found = list(nodes(path))
    silent = {id(node.value) for node in found if isinstance(node, ast.Expr)}
    silent |= {id(part) for node in found if isinstance(node, ast.JoinedStr) for part in below(node) if part != node}
    for node in found:
        if id(node) in silent:
            continue
        if isinstance(node, ast.JoinedStr):
            yield "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


@cache
def guesses() -> dict[str, str]:
    paths = (path for path in ROOT.rglob("*.py") if not any(part in str(path) for part in DESCRIBED))
    texts = ((str(path.relative_to(ROOT)), text) for path in paths for text in messages(path))
    return {text: name for name, text in texts if " " in text and GUESS.search(text)}


def test_each_guess_has_a_row_in_the_table() -> None:
    hints = {row.hint for row in ROWS} | set(ELSEWHERE)
    assert not {
        text: name for text, name in guesses().items() if not any(hint in text or text in hint for hint in hints)
    }


def test_each_row_is_of_a_message_and_each_test_elsewhere_exists() -> None:
    texts = {text for path in ROOT.rglob("*.py") for text in messages(path)}
    hints = {row.hint for row in ROWS} | set(ELSEWHERE)
    assert not {hint for hint in hints if not any(hint in text for text in texts)}
    tests = {test for pair in ELSEWHERE.values() for test in pair}
    assert not {
        (file, name) for file, name in tests if f"def {name}(" not in (TESTS / file).read_text(encoding="utf-8")
    }
