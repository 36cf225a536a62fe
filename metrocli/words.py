"""Parts of messages: lists of names, and suggestions for unknown words."""

from __future__ import annotations

import re
import unicodedata
from collections.abc import Iterable, Sequence
from difflib import get_close_matches

_MOST_ALLOWED = 40
"""Words of a list of what is allowed: more than any key has, fewer than the points of a file"""
_SHORT = 2
"""Letters and digits of a name up to which each letter counts"""
_OF_ONE = {"are": "is", "have": "has"}
"""Verbs of many, and of one where no s is added"""


def composed(text: str) -> str:
    """Return text in Unicode's form NFC: on some systems (macOS) an accent is a letter of its own."""
    return text if text.isascii() else unicodedata.normalize("NFC", text)


def listed(names: Sequence[str], most: int = 8) -> str:
    """Return names as a text "a, b and 3 more", with at most `most` names."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def lines_in_words(lines: Sequence[int]) -> str:
    """Return lines of a file as a text "line 3", "lines 3 to 9" or "lines 3, 7 and 2 more"."""
    if len(lines) > 2 and lines[-1] - lines[0] == len(lines) - 1:
        return f"lines {lines[0]} to {lines[-1]}"
    return f"line{'s' * (len(lines) > 1)} {listed(list(map(str, lines)))}"


def in_a_row(names: Sequence[str]) -> str:
    """Return names as a text "a, b and c"."""
    return f"{', '.join(names[:-1])} and {names[-1]}" if len(names) > 1 else "".join(names)


def counted(number: int, noun: str, verb: str = "") -> str:
    """Return a number with its noun, and with the verb that follows: "1 point is", "3 points are"."""
    if number == 1:
        return f"1 {noun} {_OF_ONE.get(verb, f'{verb}s')}" if verb else f"1 {noun}"
    return f"{number} {noun}s {verb}".rstrip()


def shortened(text: str, letters: int) -> str:
    """Return a text of at most so many letters: of a longer one the begin and the end, where names differ most."""
    if len(text) <= letters:
        return text
    end = letters // 2
    return f"{text[: letters - end - 1]}…{text[-end:]}"


def nearest(word: str, known: Iterable[str]) -> str | None:
    """Return the known word that is most similar, or None if none is similar enough.

    Names with other numbers, and short ones with other letters, name other things: P9 is not a slip of P8, nor az of z.
    """
    own, numbers = _folded(word), _numbers(word)
    folded = {_folded(name): name for name in known if not numbers or _numbers(name) == numbers}
    if len(own) <= _SHORT:
        return folded.get(own)
    meant = get_close_matches(own, [name for name in folded if len(name) > _SHORT], 1, 0.6)
    return folded[meant[0]] if meant else None


def _folded(word: str) -> str:
    return re.sub("[-_ ]|(?<![0-9.])0+(?=[0-9])", "", word.lower())


def _numbers(word: str) -> list[int]:
    return [int(number) for number in re.findall("[0-9]+", word)]


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return "did you mean 'x'?", or nothing if no known word is similar."""
    meant = nearest(word, known)
    return f"did you mean '{meant}'?" if meant else ""


def suggestion(word: str, known: Iterable[str]) -> str:
    """Return "did you mean 'x'?", or the list of allowed words if none is similar."""
    known = list(known)
    return did_you_mean(word, known) or f"allowed: {listed(known, _MOST_ALLOWED)}"
