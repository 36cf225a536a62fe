"""Numbers in messages have nouns and verbs of their own number."""

from __future__ import annotations

import pytest

from metrocli.words import counted


@pytest.mark.parametrize(
    ("number", "noun", "verb", "text"),
    [
        (1, "point", "are", "1 point is"),
        (2, "point", "are", "2 points are"),
        (0, "point", "are", "0 points are"),
        (1, "pose", "have", "1 pose has"),
        (1, "length", "exceed", "1 length exceeds"),
        (1, "reading", "", "1 reading"),
        (3, "reading", "", "3 readings"),
    ],
)
def test_counted(number: int, noun: str, verb: str, text: str) -> None:
    assert counted(number, noun, verb) == text
