"""Names in the definition of an effect of one's own: those that are free, and what others may mean."""

from __future__ import annotations

import re
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence

from metrocli.expressions.expression import CONSTANTS, FUNCTIONS, ExpressionError
from metrocli.words import in_a_row, nearest

WORD = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_KEYS = ("name", "by", "std")
"""Keys of `effects:` that no parameter can have as its name"""
_OTHER = "choose another name"


def not_free(
    given: tuple[Iterable[str], Iterable[str]], known: Container[str], where: Sequence[str]
) -> Iterator[tuple[str, str, str]]:
    """Yield key, fault and hint for each parameter and scanned parameter (`given`) whose name is not free."""
    parameters, scan = given
    seen: set[str] = set()
    for key, name in [*(("parameters", name) for name in parameters), *(("scan", name) for name in scan)]:
        if not WORD.fullmatch(name):
            yield f"{key}.{name}", f"'{name}' is not a name", "write letters, digits and _"
        elif name in (*FUNCTIONS, *CONSTANTS, *_KEYS, *where):
            yield f"{key}.{name}", f"'{name}' has a meaning of its own", _OTHER
        elif name in known:
            yield f"{key}.{name}", f"'{name}' is a variable there", _OTHER
        elif name in seen:
            yield f"{key}.{name}", f"'{name}' is also under parameters", _OTHER
        seen.add(name)


def constants_of_data(expression: str, refused: Mapping[str, str]) -> Iterator[ExpressionError]:
    """Yield an error for each constant in an expression that is the name of a column too; `refused` has the remedy."""
    for name, value in CONSTANTS.items():
        found = re.search(rf"\b{name}\b", expression)
        if found is not None and name in refused:
            said = f"'{name}' is {value:.6g}, and a column of the data has this name"
            yield ExpressionError(said, found.start(), refused[name])


def near_name(name: str, known: Iterable[str]) -> str:
    """Return the question whether the nearest known name is meant; empty if none is near."""
    near = nearest(name, known)
    return f"did you mean '{near}'?" if near else ""


def lacking(unknown: Mapping[str, str], unclear: Iterable[ExpressionError]) -> str:
    """Return why the data do not have an effect: constants that are columns too, and unknown names with their hints."""
    names = [f"{name} ({hint})" if hint else name for name, hint in unknown.items()]
    found = dict.fromkeys(f"{one.message} ({one.hint})" for one in unclear)
    return "; ".join([*found, *([f"needs a column {in_a_row(names)}"] if names else [])])
