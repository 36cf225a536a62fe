"""Parts of messages: lists of names, and suggestions for unknown words."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable, Sequence
from difflib import get_close_matches

_MOST_ALLOWED = 40
"""Words of a list of what is allowed: more than any key has, fewer than the points of a file"""


def composed(text: str) -> str:
    """Return text in Unicode's form NFC: on some systems (macOS) an accent is a letter of its own."""
    return text if text.isascii() else unicodedata.normalize("NFC", text)


def listed(names: Sequence[str], most: int = 8) -> str:
    """Return names as a text "a, b and 3 more", with at most `most` names."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def in_a_row(names: Sequence[str]) -> str:
    """Return names as a text "a, b and c"."""
    return f"{', '.join(names[:-1])} and {names[-1]}" if len(names) > 1 else "".join(names)


def shortened(text: str, letters: int) -> str:
    """Return a text of at most so many letters: of a longer one the begin and the end, where names differ most."""
    if len(text) <= letters:
        return text
    end = letters // 2
    return f"{text[: letters - end - 1]}…{text[-end:]}"


def nearest(word: str, known: Iterable[str]) -> str | None:
    """Return the known word that is most similar, or None if none is similar enough."""
    known = list(known)
    folded = {name.lower().replace("-", "_"): name for name in known}
    meant = get_close_matches(word.lower().replace("-", "_"), folded, 1, 0.6)
    return folded[meant[0]] if meant else None


def suggestion(word: str, known: Iterable[str]) -> str:
    """Return "did you mean 'x'?", or the list of allowed words if none is similar."""
    known = list(known)
    meant = nearest(word, known)
    return f"did you mean '{meant}'?" if meant else f"allowed: {listed(known, _MOST_ALLOWED)}"
