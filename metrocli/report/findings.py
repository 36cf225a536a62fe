"""The findings of a diagnosis on a page."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from metrocli import units
from metrocli.plots import overstock, volume_map
from metrocli.plots.budgets import contributors
from metrocli.plots.context import chosen_law, law_in_words, sizes_in_words
from metrocli.plots.magnify import length_in_words, micro
from metrocli.plots.noise_bands import largest_of
from metrocli.plots.places import places_of
from metrocli.plots.readings import residuals_of
from metrocli.record import DOUBTFUL, FAIL, GUARD_BAND, USABLE
from metrocli.report.html import Content, Html, code, compound_unit
from metrocli.result import SCALE, Estimate, K, Result
from metrocli.units import two_digits
from metrocli.words import in_a_row, listed

_CLEAN = ("clean", "explained", "not-decided")
_MEASURANDS, _SHOWN = 3, 5
_EQUAL = 1e-4
"""Readings whose |w| differ by this share are checked by the same readings: any of them may be the wrong one"""


def row_of(result: Result, estimate: Estimate, text: str = "") -> tuple[str, str, str, str]:
    """Return name, value, U and unit of an estimate: U to two digits, the value to the same decimals.

    Angles share the unit that suits the largest of them. A unit that no dimension has is the one in the text of the
    job and its definitions.
    """
    spread, _ = result.expanded(estimate)
    size, unit = 1.0, "" if estimate.unit == "1" else estimate.unit
    if estimate.dimension and estimate.dimension != SCALE and np.isfinite(spread) and spread > 0:
        _, unit = units.readable(spread, estimate.dimension)
        size = units.find_unit(unit, estimate.dimension).inside(1.0)
    elif estimate.unit == "rad":
        size, unit = units.column_unit(
            max(abs(estimate.value) for estimate in result.estimates if estimate.unit == "rad"), "rad"
        )
    elif unit and not estimate.dimension:
        size, unit = compound_unit(estimate, text)
    value, uncertainty = units.rounded(estimate.value / size, spread / size)
    stated = value != units.NOT_DETERMINED and spread != 0
    return estimate.name, value, uncertainty if stated else "", micro(unit)


GOOD, WARNED, BAD = "good", "warned", "bad"
"""Use the result, read its warnings before, do not use it as it is"""


_INCOMPLETE = "its model is not complete: the diagnosis"
_WRONG = {
    "explained": f"{_INCOMPLETE} names what is missing",
    "indistinct": f"{_INCOMPLETE} has several causes that fit alike",
    "unexplained": f"{_INCOMPLETE} finds structure, or noise, without a known cause",
    "mistaken": "one of its files is wrong, by the diagnosis",
    "not-decided": "its diagnosis is a quick one, the first answer",
}
"""What verdicts mean for the result"""


def _limits(data: Mapping[str, Any]) -> str:
    """Return what a diagnosis has against a result whose model is complete; empty if nothing."""
    count, noise = len(data.get("outliers", ())), data.get("noise") or {}
    wrong = f"the diagnosis lists {count} wrong reading{'s' if count > 1 else ''}" if count else ""
    other = f"the noise is {noise['ratio']:.2g} times what was declared" if noise.get("as_declared") is False else ""
    return " and ".join(filter(None, [wrong, other, _ended(data) and f"the diagnosis {_ended(data)}"]))


def _ended(data: Mapping[str, Any]) -> str:
    """Return how a diagnosis ended before all was tried; empty if it did not."""
    limited = f"ended at its limit of {data['limited']:g} s" if data.get("limited") is not None else ""
    return "was a quick one" if data.get("quick") else "was interrupted" if data.get("interrupted") else limited


def verdict(content: Content) -> tuple[str, str]:
    """Return GOOD, WARNED or BAD, and whether the result may be used in one sentence."""
    record = content.record
    if record.status == DOUBTFUL:
        return BAD, "Doubtful: do not use this result."
    if record.status not in USABLE:
        return BAD, "The result does not meet its requirements."
    out = [decision.name for decision in record.verdicts if decision.decision == FAIL]
    if out:
        return BAD, f"Fail: {listed(out)} {'is' if len(out) == 1 else 'are'} out of tolerance."
    diagnosis = content.diagnosis
    data = diagnosis.data if diagnosis is not None and diagnosis.is_current else {"verdict": "clean"}
    if data["verdict"] != "clean":
        return BAD, f"Done, but {_WRONG.get(data['verdict'], data['verdict'])}."
    limits = _limits(data)
    if limits:
        return WARNED, f"Done, but {limits}."
    near = [decision.name for decision in record.verdicts if decision.decision == GUARD_BAND]
    if near:
        return WARNED, f"Done; neither conformity nor non-conformity is shown, in the guard band: {listed(near)}."
    count, done = len(content.result.warnings), "Pass: all tolerances are met" if record.conformity else "Done"
    if count:
        return WARNED, f"{done}, with {count} warning{'s' if count > 1 else ''}."
    return GOOD, f"{done}."


def worst(result: Result) -> Iterator[str]:
    """Yield the worst reading, and the places with the largest deviation and the largest uncertainty."""
    sets = [residual for residual in residuals_of(result) if residual.checked.any()]
    if sets:
        sizes = [np.nan_to_num(np.abs(residuals.w)) for residuals in sets]
        which = max(range(len(sets)), key=lambda k: sizes[k].max())
        w = float(sizes[which].max())
        critical = result.statistics.get("critical_w")
        count = sum(int(residuals.checked.sum()) for residuals in sets)
        bound = critical if isinstance(critical, float) else largest_of(count)
        alike = [sets[which].name(int(row)) for row in np.flatnonzero(sizes[which] >= (1 - _EQUAL) * w)]
        several, each = ("s", " each, so none can be singled out") if len(alike) > 1 else ("", "")
        w = _largest_suspect(result) or w / _noise_of_others(result, w)
        chance = "more than noise reaches in 5 % of measurements" if w > bound else "as noise may be"
        size = f"|w| = {w:.2f} standard deviations{each}"
        yield f"Reading{several} {listed(alike, 4)}: {size}; {chance} (bound {bound:.2f})."
    elif _largest_suspect(result):
        table = result.tables["suspects"]
        k = int(np.argmax(table.numbers("w")))
        named = "/".join(str(column[k]) for column in table.columns.values() if column.dtype.kind in "US")
        yield f"Worst: {named}, |w| = {_largest_suspect(result):.2f} standard deviations, beyond the outlier bound."
    for place in places_of(result):
        if place.vectors is not None:
            sizes_of = np.linalg.norm(place.vectors, axis=1)
            k = int(np.argmax(sizes_of))
            yield f"Largest {place.vector_name}: {length_in_words(float(sizes_of[k]))} at {place.names[k]}."
        if place.covariance is not None and len(place.at) > 1:
            spread = np.sqrt(np.trace(place.covariance, axis1=1, axis2=2))
            known = np.where(np.isfinite(spread), spread, -1.0)
            k = int(np.argmax(known))
            size = length_in_words(K * float(known[k]))
            yield f"Least known of the {place.kind}: {place.names[k]}, {size} in space (k = 2)."
    yield from _largest_shares(result)
    stock = overstock.data(result)
    if stock is not None:
        size, spread = units.rounded(float(stock.least[0]), float(stock.spread[0]))
        where = f"at {stock.least_at[0]} of {stock.surfaces[0]}"
        yield f"Least overstock: ({size} ± {spread}) mm (k = 2) {where}; the minimum is {stock.minimum:g} mm."


def _largest_suspect(result: Result) -> float:
    """Return the largest test of the readings that the terminal lists beyond the outlier bound, 0 without any."""
    suspects = result.tables.get("suspects")
    return float(suspects.numbers("w").max()) if suspects is not None and len(suspects) and "w" in suspects else 0.0


def _noise_of_others(result: Result, w: float) -> float:
    """Return the noise of all readings but the worst, relative to the declared one, at least 1 where it is declared.

    The tests of a result, and those on the terminal, are divided by it: external studentisation.
    """
    chi2, dof = (result.statistics.get(name) for name in ("chi2", "dof"))
    if not isinstance(chi2, int | float) or not isinstance(dof, int | float) or dof <= 1:
        return 1.0
    if "noise" in result.statistics:  # w is relative to the estimated noise
        chi2 = dof
    others = float(np.sqrt(max(chi2 - w**2, 0.0) / (dof - 1)))
    return others or 1.0 if result.statistics.get("noise_estimated") else max(others, 1.0)


def _largest_shares(result: Result) -> Iterator[str]:
    """Yield the place of a volume that is known least, and the largest contributor to each of the first measurands."""
    volume = volume_map.data(result, volume_map.UNCERTAINTY) if "map" in result.tables else None
    if volume is not None:
        x, y, z = volume.largest_at
        size = length_in_words(K * volume.largest)
        yield f"Least known of the volume: ({x:g}, {y:g}, {z:g}) mm, {size} in space (k = 2)."
    for chart in (contributors.data(result, "") or ())[:_MEASURANDS]:
        yield f"Largest contributor to {chart.measurand}: {chart.names[0]}, {chart.shares[0]:.0f} % of the variance."


def next_step(content: Content) -> str | Html:
    """Return what to do next with the result."""
    record, diagnosis = content.record, content.diagnosis
    diagnosis = diagnosis if diagnosis is not None and diagnosis.is_current else None
    diagnose = code(f"metrocli diagnose {content.job}")
    if diagnosis is not None:
        if diagnosis.data.get("mistake"):
            return "Correct the mistake that the diagnosis found, and run the job again."
        extended = diagnosis.data.get("extended_job")
        if extended:
            command = code(f"metrocli {content.result.kind} {extended}")
            return Html(f"Run the job with what was found in its model: {command}.")
        if diagnosis.data.get("outliers"):
            return "Check the wrong readings, measure them again or leave them out, and run the job again."
        if diagnosis.data.get("verdict") not in _CLEAN:
            return "The residuals have structure that no known effect explains: measure what would separate causes."
        if _ended(diagnosis.data):
            return Html(f"Diagnose with more time: {code(f'metrocli diagnose {content.job} --limit 600s')}.")
        if _limits(diagnosis.data):
            return "Declare the noise that the readings have, or let the job estimate it, and run the job again."
    if record.status == DOUBTFUL:
        return Html(f"Find the cause by {diagnose}.")
    if record.status not in USABLE:
        return "See which requirement is not met: measure more, or better, where the uncertainty is largest."
    if diagnosis is None and content.result.statistics.get("dof") and residuals_of(content.result):
        return Html(f"Check the model by {diagnose}, then use or export the result.")
    if record.conformity == FAIL:
        return "Decide on what is out of tolerance: reject, rework, or a concession."
    if record.conformity == GUARD_BAND:
        return "Measure with a smaller uncertainty, or decide by another rule (`tolerance:` states it)."
    if content.result.warnings:
        return "Read the warnings; then use or export the result."
    return "Use or export the result."


_MEANING = {
    "clean": "the residuals are what noise produces",
    "explained": "with what is named here in the model, the residuals are what noise produces",
    "indistinct": "a cause is present, and others explain the readings as well",
    "unexplained": "structure, or noise, is left that no known cause explains",
    "mistaken": "a file is wrong; all else is for the corrected file",
    "not-decided": "what explains most; the search for the rest was left out",
}


def diagnosed(content: Content) -> Iterator[str | Html]:
    """Yield what the diagnosis at hand found, or how to make one."""
    diagnosis = content.diagnosis
    if diagnosis is not None and diagnosis.is_current:
        yield from _lines(diagnosis.data)
    elif diagnosis is not None:
        yield f"{diagnosis.path} is the diagnosis of another job, or of other inputs: diagnose again."
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
    if _ended(data):
        yield f"The search {_ended(data)}; it may have missed causes."


def _first(lines: Sequence[str], what: str) -> Iterator[str]:
    """Yield the first of many lines, and how many there are."""
    yield from lines[:_SHOWN]
    if len(lines) > _SHOWN:
        yield f"... and {len(lines) - _SHOWN} more {what}: `metrocli diagnose` lists them."


def _effect(effect: Mapping[str, Any]) -> str:
    sizes = sizes_in_words(effect.get("parameters", {}))
    shift = (effect.get("gain") or {}).get("result_shift") or {}
    changes = micro(f"changes the result by {two_digits(shift['value'])} {shift['unit']}") if shift.get("value") else ""
    rivals = listed([*map(_named, effect.get("alternatives", ()))], _SHOWN)
    return f"{_named(effect)}: {'; '.join(filter(None, [sizes, changes, rivals and f'or instead {rivals}']))}"


def _named(effect: Mapping[str, Any]) -> str:
    name = effect.get("words") or " ".join(map(str, [effect["name"], *dict(effect.get("where") or {}).values()]))
    return " with ".join(filter(None, [name, in_a_row([*map(_named, effect.get("with", ()))])]))


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
    for process in data.get("processes", ()):
        each = f" of each {process['of_each']} by itself" if process.get("of_each") else ""
        each = f" of {process['of_each']} {process['of']}" if process.get("of") else each
        size = micro(f"{two_digits(process['std']['value'])} {process['std']['unit']}")
        counts = f"counts as noise, and is{'' if process.get('in_uncertainties') else ' not'} in the uncertainties here"
        yield f"Error that varies smoothly with {process['depends_on']}{each}: {size} (standard deviation); {counts}"
    if noise.get("as_declared") is False:
        yield f"Noise: {noise['ratio']:.2g} times what was declared, for which the uncertainties here are"
