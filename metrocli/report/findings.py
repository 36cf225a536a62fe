"""What a reader looks for first: verdict, worst point, diagnosis, and what to do next."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from metrocli import units
from metrocli.plots import overstock
from metrocli.plots.beside import chosen_law, law_in_words, sizes_in_words
from metrocli.plots.magnify import length_in_words, micro
from metrocli.plots.noise_bands import largest_of
from metrocli.plots.places import places_of
from metrocli.plots.readings import residuals_of
from metrocli.record import DONE, DOUBTFUL
from metrocli.report.content import Content
from metrocli.report.html import Html, code
from metrocli.result import SCALE, Estimate, K, Result
from metrocli.words import listed

_CLEAN = ("clean", "explained")
_EQUAL = 1e-4
"""Readings whose |w| differ by this share are checked by the same readings: any of them may be the wrong one"""


def row_of(result: Result, estimate: Estimate) -> tuple[str, str, str, str]:
    """Return name, value, U and unit of an estimate: U to two digits, the value to the same decimals.

    Angles share the unit that suits the largest of them.
    """
    spread, _ = result.expanded(estimate)
    size, unit = 1.0, "" if estimate.unit == "1" else estimate.unit
    if estimate.dimension and estimate.dimension != SCALE and np.isfinite(spread) and spread > 0:
        _, unit = units.readable(spread, estimate.dimension)
        size = units.find_unit(unit, estimate.dimension).inside(1.0)
    elif estimate.unit == "rad":
        size, unit = units.column_unit(max(abs(one.value) for one in result.estimates if one.unit == "rad"), "rad")
    value, uncertainty = units.rounded(estimate.value / size, spread / size)
    return estimate.name, value, "" if value == uncertainty == units.NOT_DETERMINED else uncertainty, micro(unit)


GOOD, WARNED, BAD = "good", "warned", "bad"
"""Use the result, read its warnings before, do not use it as it is"""


def verdict(content: Content) -> tuple[str, str]:
    """Return GOOD, WARNED or BAD, and whether the result may be used in one sentence."""
    record = content.record
    if record.status == DOUBTFUL:
        return BAD, "Doubtful: do not use this result."
    if record.status != DONE:
        return BAD, "The result does not meet its requirements."
    held = content.diagnosis
    if held is not None and held.of_this and held.data.get("verdict") != "clean":
        return BAD, f"Done, but its model is not complete: the verdict of the diagnosis is {held.data['verdict']}."
    count = len(content.result.warnings)
    if count:
        return WARNED, f"Done, with {count} warning{'s' if count > 1 else ''}."
    return GOOD, "Done."


def worst(result: Result) -> Iterator[str]:
    """Yield the worst reading, and the places with the largest deviation and the largest uncertainty."""
    sets = [one for one in residuals_of(result) if one.checked.any()]
    if sets:
        sizes = [np.nan_to_num(np.abs(one.w)) for one in sets]
        which = max(range(len(sets)), key=lambda k: sizes[k].max())
        w, bound = float(sizes[which].max()), largest_of(sum(int(one.checked.sum()) for one in sets))
        alike = [sets[which].name(int(row)) for row in np.flatnonzero(sizes[which] >= (1 - _EQUAL) * w)]
        several, each = ("s", " each, so none can be singled out") if len(alike) > 1 else ("", "")
        chance = "more than noise reaches in 5 % of measurements" if w > bound else "as noise may be"
        size = f"|w| = {w:.2f} standard deviations{each}"
        yield f"Reading{several} {listed(alike, 4)}: {size}; {chance} (bound {bound:.2f})."
    for one in places_of(result):
        if one.vectors is not None:
            sizes_of = np.linalg.norm(one.vectors, axis=1)
            k = int(np.argmax(sizes_of))
            yield f"Largest {one.vector_name}: {length_in_words(float(sizes_of[k]))} at {one.names[k]}."
        if one.covariance is not None and len(one.at) > 1:
            spread = np.sqrt(np.trace(one.covariance, axis1=1, axis2=2))
            known = np.where(np.isfinite(spread), spread, -1.0)
            k = int(np.argmax(known))
            size = length_in_words(K * float(known[k]))
            yield f"Least known of the {one.kind}: {one.names[k]}, {size} in space (k = 2)."
    stock = overstock.data(result)
    if stock is not None:
        size, spread = units.rounded(float(stock.least[0]), float(stock.spread[0]))
        where = f"at {stock.least_at[0]} of {stock.surfaces[0]}"
        yield f"Least overstock: ({size} ± {spread}) mm (k = 2) {where}; the minimum is {stock.minimum:g} mm."


def diagnosed(content: Content) -> Iterator[str | Html]:
    """Yield what the diagnosis at hand found, or how to make one."""
    held = content.diagnosis
    if held is None and not residuals_of(content.result):
        yield "Nothing to diagnose: no readings are adjusted."
        return
    if held is None:
        yield Html(f"Not diagnosed yet: {code(f'metrocli diagnose {content.job}')}, then make this page again.")
        return
    if not held.of_this:
        yield f"{held.path} is the diagnosis of another job, or of other inputs: diagnose again."
        return
    data = held.data
    yield f"Verdict: {data.get('verdict', '')}."
    for effect in data.get("effects", ()):
        where = ", ".join(map(str, dict(effect.get("where", {})).values()))
        yield f"{effect.get('name', '')} {where}: {sizes_in_words(effect.get('parameters', {}))}".replace(" :", ":")
    law = chosen_law(data)
    if law is not None:
        yield f"Law without a known cause: {law_in_words(law)}; {sizes_in_words(law.get('parameters', {}))}"
    for one in list(data.get("outliers", ()))[:5]:
        keys = "/".join(map(str, dict(one.get("observation", {})).values()))
        yield f"Wrong reading: {keys} (w = {float(one.get('w') or 0):.1f})"
    if data.get("mistake"):
        yield f"Mistake in {data['mistake'].get('file')}: {data['mistake'].get('what')}"


def next_step(content: Content) -> str | Html:
    """Return what to do next with the result."""
    record, held = content.record, content.diagnosis
    held = held if held is not None and held.of_this else None
    diagnose = code(f"metrocli diagnose {content.job}")
    if held is not None:
        extended = held.data.get("extended_job")
        if extended:
            command = code(f"metrocli {content.result.kind} {extended}")
            return Html(f"Run the job with what was found in its model: {command}.")
        if held.data.get("mistake"):
            return "Correct the mistake that the diagnosis found, and run the job again."
        if held.data.get("outliers"):
            return "Check the wrong readings, measure them again or leave them out, and run the job again."
        if held.data.get("verdict") not in _CLEAN:
            return "The residuals have structure that no known effect explains: measure what would separate causes."
    if record.status == DOUBTFUL:
        return Html(f"Find the cause by {diagnose}.")
    if record.status != DONE:
        return "See which requirement is not met: measure more, or better, where the uncertainty is largest."
    if held is None and content.result.statistics.get("dof") and residuals_of(content.result):
        return Html(f"Check the model by {diagnose}, then use or export the result.")
    if content.result.warnings:
        return "Read the warnings; then use or export the result."
    return "Use or export the result."
