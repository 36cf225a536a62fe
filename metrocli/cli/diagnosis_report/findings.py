"""The report of a diagnosis: the verdict, the table of findings, short lines on each, the table of candidates."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from metrocli import units
from metrocli.adjust.clusters.robust import STRUCTURED
from metrocli.cli.columns import text_table
from metrocli.cli.diagnosis_report.advice import (
    DESCRIBED,
    SHOWN,
    extension,
    mistake_lines,
    shared_errors,
    wrong_readings,
)
from metrocli.cli.diagnosis_report.candidates import candidate_lines, count_of_candidates
from metrocli.cli.diagnosis_report.headline import beyond_usual, headline, noise_lines, smooth, summary
from metrocli.cli.diagnosis_report.laws import law_lines
from metrocli.diagnosis.adjusted_job import REPORTED, AdjustedJob, MemberSubset
from metrocli.diagnosis.detectability import Detectability
from metrocli.diagnosis.evidence.gain import LEAST_CHANGE, Gain
from metrocli.diagnosis.evidence.refined import STARTS
from metrocli.diagnosis.extended_fit import EffectSize
from metrocli.diagnosis.findings import Diagnosis, Finding, RandomEffect
from metrocli.project.diagnosed import Extended
from metrocli.words import in_a_row, listed

_HEAD = ("effect", "size (± u)", "chance", "or instead", "held-out error", "log score (± std)", "changes result by")


def of_diagnosis(diagnosis: Diagnosis, extended: Extended | None, full: bool = False) -> str:
    """Return the report of a diagnosis, `full` with all candidates; `extended` is the extended job that was written."""
    job, findings = diagnosis.job, diagnosis.findings
    noticed = [f"noticed: {line}" for line in job.noticed]
    parts = [[f"verdict: {headline(diagnosis)}", *summary(diagnosis), *beyond_usual(diagnosis), *noticed]]
    if diagnosis.mistaken is not None:
        parts.append(list(mistake_lines(diagnosis.mistaken)))
    if findings or diagnosis.scatters:
        rows = [
            _row(effect, job) if isinstance(effect, Finding) else _row_of_scatter(effect, job)
            for effect in diagnosis.identified
        ]
        together = [_together(diagnosis.together, job)] if diagnosis.together is not None else []
        parts.append(text_table(_HEAD, [*rows, *together]))
    if diagnosis.outliers:
        parts.append(list(wrong_readings(diagnosis.outliers, job.outliers)))
    if not diagnosis.quick:
        remedy = "" if extended is None else in_a_row(shared_errors(diagnosis))
        parts.append([*_structure(diagnosis, remedy), *_processes(diagnosis, remedy), *noise_lines(diagnosis)])
    if diagnosis.laws:
        parts.append(list(law_lines(diagnosis, None if extended is None else extended.law)))
    parts += [list(_about_scatter(scatter)) for scatter in diagnosis.scatters]
    parts += [list(_about(finding)) for finding in findings[:DESCRIBED]]
    if diagnosis.unconfirmed:
        lost = ", ".join(f"{rejection.name} ({rejection.against})" for rejection in diagnosis.unconfirmed)
        parts.append([f"not confirmed by held-out readings, and not in the model: {lost}"])
    if diagnosis.separate_by:
        parts.append(["to distinguish them, measure:", *(f"  {words}" for words in diagnosis.separate_by)])
    if job.part is not None:
        parts.append([_of_part(job.part)])
    if diagnosis.limited is not None:
        parts.append(
            [
                f"The search ended at the limit of {diagnosis.limited:g} s; `--limit` gives it more time.",
                *_early(diagnosis),
            ]
        )
    if diagnosis.interrupted:
        parts.append(["The search for laws was interrupted; the report has the best that it had found."])
    if not diagnosis.adjusts:
        parts.append(
            ["The job cannot be adjusted with the named effects; their sizes are one-step (linear) estimates."]
        )
    # no advice to run a job that would be refused
    if extended is not None and diagnosis.adjusts:
        parts.append([f"next: `metrocli {job.kind} {extended.path}`, {extension(diagnosis, extended.law)}"])
    if diagnosis.quick:
        parts.append(["This is the first answer: what explains most. Without `--quick` the search goes on."])
    elif full:
        parts.append(candidate_lines(job, diagnosis.design, diagnosis.conclusions))
    else:
        parts.append([count_of_candidates(diagnosis)])
    return "\n\n".join("\n".join(lines) for lines in parts)


def _early(diagnosis: Diagnosis) -> Iterator[str]:
    """Yield what a search that ended early may not have done: smooth errors are raced after the names."""
    if diagnosis.findings and not diagnosis.correlated_errors:
        yield "Smooth random errors are tested last: some of the effects found may be spurious."


def _of_part(part: MemberSubset) -> str:
    """Return in words that a part of a measurement is diagnosed."""
    return (
        f"The diagnosis is that of {part}, drawn evenly, with all their readings: more take more memory than there is. "
        "What can be detected is stated for these."
    )


def of_design(adjusted: AdjustedJob, design: Detectability) -> str:
    """Return the report of what a measurement can detect."""
    lines = [_of_part(adjusted.part), ""] if adjusted.part else []
    lines += ["what this measurement can detect (80 % power, counting everything that is tried):", ""]
    lines += candidate_lines(adjusted, design, None)
    alike = [
        f"  {pair.one} and {pair.other}: "
        + (
            "indistinguishable"
            if pair.alias
            else f"distinguished from {units.sized(pair.separable, pair.dimension)} on"
        )
        for pair in design.pairs
    ]
    return "\n".join([*lines, *(["", "hard to distinguish:", *alike] if alike else [])])


def _structure(diagnosis: Diagnosis, remedy: str) -> Iterator[str]:
    left = diagnosis.left
    if diagnosis.findings or diagnosis.scatters:
        yield f"structure before: {units.chance(diagnosis.before)}"
    if left is None:
        yield f"structure left: none beyond noise ({units.chance(diagnosis.after)} for the strongest)"
        return
    where = f" in the readings of {', '.join(left.where)}" if left.where else ""
    _, dimension = REPORTED.get(left.unit, diagnosis.job.reading)
    size = f", {units.sized(left.size, dimension)} (root mean square)" if left.size else ""
    size += "" if left.share is None else f", {100 * left.share:.{3 if left.share >= 0.995 else 2}g} % of the misfit"
    along = f", varies with {' and '.join(left.depends_on)}" if left.depends_on else "," * bool(where)
    yield f"structure left: {units.chance(left.p_value)}{along}{where}{size}"
    yield f"  No known effect explains it. {_included(diagnosis, remedy)}"


def _included(diagnosis: Diagnosis, remedy: str) -> str:
    """Return whether the uncertainties of the result include structure, or a smooth error, and what would.

    `remedy` is what the extended job has for it, if one was written.
    """
    include = "include it" if diagnosis.job.noise_model == STRUCTURED else "do not include it"
    would = f"; those of the extended job, with {remedy}, include it" if remedy else ""
    return f"The standard uncertainties of the result {include}{would}."


def _processes(diagnosis: Diagnosis, remedy: str) -> Iterator[str]:
    for error in diagnosis.correlated_errors:
        size, chance = error.sized(diagnosis.job.reading[1]), units.chance(float(np.exp(error.log_level)))
        # two errors over the same covariate differ in it
        length = f"correlated over {100 * error.length:.2g} % of the range"
        yield f"{smooth(error)}: {size} (standard deviation, {chance}; {length})"
        if error.instead_of:
            yield f"  Without it these would be named: {listed([str(each) for each in error.instead_of], SHOWN)}."
    if diagnosis.correlated_errors:
        allowing = "the named effects and the detectable sizes" if diagnosis.findings else "the detectable sizes"
        yield f"  Chance explains it as well as any cause. It counts as noise: {allowing} allow for it."
        if diagnosis.left is None:
            yield f"  {_included(diagnosis, remedy)}"


def _about(finding: Finding) -> Iterator[str]:
    """Yield what the table does not hold of one effect: cause, limits of its name, and what would show more."""
    name = finding.effect
    yield f"{name.alternative}: {name.alternative.effect.cause}"
    if name.forms:
        forms = ", ".join(f"`by: {form.alternative.effect.by}` (odds {form.odds:.2g})" for form in name.forms)
        yield f"  its size is that of `by: {name.alternative.effect.by}`; {forms} fits as well"
    for scanned in name.alternative.effect.scanned:
        if others := sorted(alias[1:] for alias in name.aliases if alias[0] == scanned.name):
            values = ", ".join(f"{value:.6g}" for value, _ in others) + (", ..." if len(others) >= STARTS - 1 else "")
            odds = f"(odds from {min(odds for _, odds in others):.2g})"
            yield f"  {scanned.name} {values} {scanned.unit} fits as well {odds}: the readings are spaced too evenly"
    if name.taken_as_zero:
        yield f"  not determined separately, taken as 0: {', '.join(name.taken_as_zero)}"
        yield f"  to determine them: {name.alternative.effect.reveal}"
    if finding.other_shape_from < 1:
        share = units.two_digits(100 * finding.other_shape_from)
        checked = f" whose signature differs from this one by less than {share} % (80 % power)"
    else:
        checked = "; the effect is too small for its shape to be checked"
    yield f"  not excluded: an unlisted cause{checked}"


def _about_scatter(scatter: RandomEffect) -> Iterator[str]:
    effect = scatter.effect
    places = "" if effect.is_smooth else f" ({scatter.places})"
    yield f"{effect.name} {effect.everywhere}{places}: {effect.of_all or effect.cause}"


def _row_of_scatter(scatter: RandomEffect, adjusted: AdjustedJob) -> tuple[str, ...]:
    effect = scatter.effect
    std = EffectSize(effect.common or effect.parameters[0], scatter.std, scatter.spread)
    return (
        f"{effect.name} {effect.everywhere}",
        _parameter(std),
        units.chance(float(np.exp(scatter.log_level))),
        ", ".join(map(str, scatter.rivals)),
        _reduction(scatter.gain),
        _score(scatter.gain),
        units.changed_by(scatter.shift, adjusted.delivered.dimension),
    )


def _together(gain: Gain, adjusted: AdjustedJob) -> tuple[str, ...]:
    before, after = (_error(size, adjusted) for size in (gain.before, gain.after))
    shown = "" if gain.shown else " (not shown)"
    return "all together", "", "", "", f"{before} to {after}{shown}", _score(gain), ""


def _row(finding: Finding, adjusted: AdjustedJob) -> tuple[str, ...]:
    name, gain = finding.effect, finding.gain
    return (
        str(name.alternative),
        ", ".join(map(_parameter, finding.sizes)),
        units.chance(float(np.exp(name.log_level))),
        listed(finding.instead, SHOWN),
        _reduction(gain),
        _score(gain),
        units.changed_by(finding.shift, adjusted.delivered.dimension),
    )


def _reduction(gain: Gain) -> str:
    """Return the change of held-out errors; the log score may gain where it is too small to be stated in percent."""
    change = "unchanged" if abs(gain.reduction) < LEAST_CHANGE else f"{-100 * gain.reduction:+.0f} %"
    return change if gain.shown else f"{change} (not shown)"


def _error(size: float, adjusted: AdjustedJob) -> str:
    value, unit = units.readable(size, adjusted.reading[1])
    return f"{value:.3g} {unit}"


def _score(gain: Gain) -> str:
    spread = f"± {gain.log_score_std:.1f}" if np.isfinite(gain.log_score_std) else f"({units.NOT_DETERMINED})"
    return f"{gain.log_score:+.1f} {spread}"


def _parameter(size: EffectSize) -> str:
    key, dimension = size.parameter.name, size.parameter.dimension
    if size.std is None:
        digits, partly = ("6g", "") if size.seen else ("2g", " (not seen)")
        return f"{key} {size.value:.{digits}} {size.parameter.unit}{partly}"
    # to the unit in which a person reads the value, from the one in which the parameter is given; a value of nearly 0
    # has the unit of its uncertainty: 0 ± 27 mm, not 0 ± 27000 um
    _, symbol = size.parameter.readable(max(abs(size.value), size.std or 0.0))
    of_unit = units.find_unit(symbol, dimension).outside(1.0) if dimension and symbol != "1" else 1.0
    factor = of_unit / size.parameter.given
    return f"{key} = {units.format_quantity(size.value * factor, symbol, size.std * factor)}"
