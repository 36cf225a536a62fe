"""What a diagnosis found, in the words of a page: the verdict, its causes, and what is left."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from metrocli.plots.beside import chosen_law, law_in_words, sizes_in_words
from metrocli.plots.magnify import micro
from metrocli.plots.readings import residuals_of
from metrocli.report.content import Content
from metrocli.report.html import Html, code
from metrocli.units import two_digits
from metrocli.words import in_a_row, listed

_MEANING = {
    "clean": "the residuals are what noise produces",
    "explained": "with what is named here in the model, the residuals are what noise produces",
    "indistinct": "a cause is present, and others explain the readings as well",
    "unexplained": "structure is left that no known cause explains",
    "mistaken": "a file is wrong; all else is for the corrected file",
}
_SHOWN = 5


def diagnosed(content: Content) -> Iterator[str | Html]:
    """Yield what the diagnosis at hand found, or how to make one."""
    held = content.diagnosis
    if held is not None and held.of_this:
        yield from _lines(held.data)
    elif held is not None:
        yield f"{held.path} is the diagnosis of another job, or of other inputs: diagnose again."
    elif residuals_of(content.result):
        yield Html(f"Not diagnosed yet: {code(f'metrocli diagnose {content.job}')}, then make this page again.")
    else:
        yield "Nothing to diagnose: no readings are adjusted."


def _lines(data: Mapping[str, Any]) -> Iterator[str]:
    verdict = str(data.get("verdict", ""))
    yield f"Verdict: {': '.join(filter(None, [verdict, _MEANING.get(verdict)]))}."
    mistake = data.get("mistake")
    if mistake:
        correct = f"; write: {mistake['write']}" if mistake.get("write") else ""
        yield f"Mistake in {mistake.get('file')}: {mistake.get('what')}{correct}"
    yield from _first(list(map(_effect, data.get("effects", ()))), "effects")
    law = chosen_law(data)
    if law is not None:
        yield f"Law without a known cause: {law_in_words(law)}; {sizes_in_words(law.get('parameters', {}))}"
    yield from _first(list(map(_wrong, data.get("outliers", ()))), "wrong readings")
    yield from _left(data)
    if data.get("separate_by"):
        yield f"To tell the causes apart, measure: {'; '.join(data['separate_by'])}"
    if data.get("limited") is not None:
        yield f"The search ended at its limit of {data['limited']:g} s; it may have missed causes."


def _first(lines: Sequence[str], what: str) -> Iterator[str]:
    """Yield the first of many lines, and how many there are."""
    yield from lines[:_SHOWN]
    if len(lines) > _SHOWN:
        yield f"... and {len(lines) - _SHOWN} more {what}: `metrocli diagnose` lists them."


def _effect(effect: Mapping[str, Any]) -> str:
    sizes = sizes_in_words(effect.get("parameters", {}))
    shift = (effect.get("gain") or {}).get("result_shift") or {}
    changes = micro(f"changes the result by {two_digits(shift['value'])} {shift['unit']}") if shift.get("value") else ""
    rivals = [_named(one) for one in effect.get("alternatives", ())]
    instead = f"or instead {listed(rivals, _SHOWN)}" if rivals else ""
    return f"{_named(effect)}: {'; '.join(filter(None, [sizes, changes, instead]))}"


def _named(effect: Mapping[str, Any]) -> str:
    return " ".join([str(effect.get("name", "")), *map(str, dict(effect.get("where") or {}).values())])


def _wrong(outlier: Mapping[str, Any]) -> str:
    keys, others = _keys(outlier.get("observation", {})), list(map(_keys, outlier.get("or", ())))
    instead = f"; or instead {listed(others, _SHOWN)}" if others else ""
    return f"Wrong reading: {keys} (w = {float(outlier.get('w') or 0):.1f}{instead})"


def _keys(observation: Mapping[str, Any]) -> str:
    return "/".join(map(str, dict(observation).values()))


def _left(data: Mapping[str, Any]) -> Iterator[str]:
    """Yield the structure that is left, smooth errors that count as noise, and noise that is not as declared."""
    left, noise = data.get("unexplained"), data.get("noise") or {}
    if left:
        where = f" in the readings of {listed(left['where'], _SHOWN)}" if left.get("where") else ""
        size = left.get("size") or {}
        much = micro(f", {two_digits(size['value'])} {size['unit']} (root mean square)") if size.get("value") else ""
        yield f"Structure left: varies with {in_a_row(left['depends_on'])}{where}{much}"
    for one in data.get("processes", ()):
        each = f" of each {one['of_each']} by itself" if one.get("of_each") else ""
        size = micro(f"{two_digits(one['std']['value'])} {one['std']['unit']}")
        counts = "is in the uncertainties here" if one.get("in_uncertainties") else "is not in the uncertainties here"
        counted = f"{size} (standard deviation); counts as noise, and {counts}"
        yield f"Error that varies smoothly with {one['depends_on']}{each}: {counted}"
    if noise.get("as_declared") is False:
        yield f"Noise: {noise['ratio']:.2g} times what was declared, for which the uncertainties here are"
