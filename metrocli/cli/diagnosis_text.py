"""The report of a diagnosis: the verdict, a paragraph, the table of findings, the table of candidates."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from textwrap import fill

import numpy as np

from metrocli import units
from metrocli.diagnosis import verdict
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.cross_validation import Gain
from metrocli.diagnosis.detectability import Candidate, Design
from metrocli.diagnosis.findings import Diagnosis, Finding
from metrocli.diagnosis.noise import DECLARED_SIGMA
from metrocli.diagnosis.selection.confidence_set import NamedEffect

_WIDTH = 110
_SHOWN = 5
_IN_SENTENCES = 4
"""Most effects that the paragraph describes; the table lists all"""
_HIGH_NOISE, _FEW_DOF = 2.0, 30
"""Noise ratio above which, with fewer degrees of freedom than this, several wrong readings may pass as noise"""
_USUAL = "a machine or mover that does not return to the same place, a wrong sigma, vibration or turbulence of the air"
_LEAST_P = 1e-12
_LEAST_REDUCTION = 0.005
"""Least fall of the held-out errors that is stated in percent; the log score may gain where the fall is smaller"""


def of_diagnosis(diagnosis: Diagnosis, extended: Path | None) -> str:
    """Return the report of a diagnosis."""
    paragraph = " ".join(_sentences(diagnosis, extended))
    lines = [f"verdict: {_headline(diagnosis)}", "", fill(paragraph, _WIDTH)]
    if diagnosis.findings:
        lines += ["", *_table(_HEAD, [_row(finding, diagnosis.job) for finding in diagnosis.findings])]
    if diagnosis.separate_by:
        lines += ["", "to distinguish them, measure:", *(f"  {words}" for words in diagnosis.separate_by)]
    names = [finding.effect for finding in diagnosis.findings]
    return "\n".join([*lines, "", *_candidates(diagnosis.job, diagnosis.design, names)])


def _headline(diagnosis: Diagnosis) -> str:
    """Return the verdict, with the noise where it is not as declared."""
    noise = diagnosis.noise
    if noise.as_declared or diagnosis.job.declared == "estimated":
        return str(diagnosis.verdict)
    return f"{diagnosis.verdict}, but the noise is {noise.ratio:.2g} times what was declared"


def of_design(adjusted: AdjustedJob, design: Design) -> str:
    """Return the report of what a measurement can detect."""
    lines = ["what this measurement can detect (80 % power, counting everything that is tried):", ""]
    lines += _candidates(adjusted, design, None)
    alike = [
        f"  {pair.one} and {pair.other}: "
        + ("indistinguishable" if pair.alias else f"distinguished from {_size(pair.separable, pair.dimension)} on")
        for pair in design.pairs
    ]
    return "\n".join([*lines, *(["", "hard to distinguish:", *alike] if alike else [])])


def _sentences(diagnosis: Diagnosis, extended: Path | None) -> Iterator[str]:
    if diagnosis.mistaken is not None:
        likely = " or ".join(map(str, diagnosis.mistaken.mistakes[:_SHOWN]))
        write = f"Write {diagnosis.mistaken.mistakes[0].write}."
        yield f"A file of this job is wrong: {likely}. {write} All that follows is for the corrected job."
    if diagnosis.findings:
        yield f"The residuals contain structure beyond noise ({_chance(diagnosis.before)})."
    elif diagnosis.left is None:
        strongest = f"{_chance(diagnosis.after)} for the strongest structure"
        yield f"The residuals are consistent with noise ({strongest})."
    for finding in diagnosis.findings[:_IN_SENTENCES]:
        yield from _about(finding, diagnosis.job)
    if len(diagnosis.findings) > _IN_SENTENCES:
        yield f"The table lists {len(diagnosis.findings) - _IN_SENTENCES} more."
    yield from _together(diagnosis)
    if diagnosis.left is not None:
        yield from _left(diagnosis)
    elif diagnosis.findings:
        yield f"With the named effects in the model no structure is left ({_chance(diagnosis.after)})."
    yield from _noise(diagnosis)
    if diagnosis.outliers:
        wrong = [f"{'/'.join(one.keys.values())} ({one.test:.0f} sigma)" for one in diagnosis.outliers[:_SHOWN]]
        more = f" and {len(diagnosis.outliers) - _SHOWN} more" if len(diagnosis.outliers) > _SHOWN else ""
        yield f"Wrong readings: {', '.join(wrong)}{more}. `outliers: remove` leaves them out; or measure them again."
    if not diagnosis.adjusts:
        yield "The job cannot be adjusted with the named effects in it; their sizes are one-step (linear) estimates."
    if extended is not None:
        yield f"The job extended by the named effects is {extended}: run it, and diagnose it again."


def _left(diagnosis: Diagnosis) -> Iterator[str]:
    left = diagnosis.left
    if left is None:
        return
    on, where = " and ".join(left.depends_on), f" in the readings of {', '.join(left.where)}" if left.where else ""
    size, unit = units.readable(left.size, diagnosis.job.reading[1])
    yield f"Structure is left that no known effect explains ({_chance(left.p_value)}). It varies with {on}{where}."
    if left.size:
        yield f"Its visible part is {units.two_digits(size)} {unit} (root mean square)."
    yield "The standard uncertainties of the result do not include it."


def _about(finding: Finding, adjusted: AdjustedJob) -> Iterator[str]:
    name, gain = finding.effect, finding.gain
    cause, reveal = name.alternative.effect.cause, name.alternative.effect.reveal
    yield f"{name.alternative} explains it: {cause}; {', '.join(_parameters(finding))}."
    if name.held:
        yield f"The readings do not determine {' and '.join(name.held)} separately (taken as 0). What would: {reveal}."
    yield f"Noise alone would give as much with {_chance(float(np.exp(name.log_level)))}, counting everything tried."
    if name.rivals:
        others = " or ".join(str(rival.alternative) for rival in name.rivals[:_SHOWN])
        yield f"With this measurement {others} explains the readings about as well."
    if finding.other_shape_from < 1:
        share = f"{units.two_digits(100 * finding.other_shape_from)} %"
        yield f"A cause whose signature differs from it by more than {share} would have been detected."
    else:
        yield "The effect is too small for its shape to be checked."
    shift, unit = units.readable(finding.shift, adjusted.delivered.dimension)
    yield f"The effect changes the {adjusted.delivered.what} by up to {units.two_digits(shift)} {unit}."
    if gain.shown and gain.reduction >= _LEAST_REDUCTION:
        yield f"Held-out readings are predicted {100 * gain.reduction:.0f} % better ({_score(gain)})."
    elif gain.shown:
        yield f"Held-out readings are predicted better ({_score(gain)}), but other errors still dominate."
    else:
        yield f"No gain on held-out readings is shown ({_score(gain)})."


def _together(diagnosis: Diagnosis) -> Iterator[str]:
    gain = diagnosis.together
    if gain is None:
        return
    before, after = (_error(size, diagnosis.job) for size in (gain.before, gain.after))
    what = f"the error of held-out readings goes from {before} to {after}"
    yield f"With all named effects {what} (root mean square; {_score(gain)})."
    if not gain.shown:
        yield "This is not shown to be a gain."


def _error(size: float, adjusted: AdjustedJob) -> str:
    value, unit = units.readable(size, adjusted.reading[1])
    return f"{value:.3g} {unit}"


def _score(gain: Gain) -> str:
    return f"log score {gain.log_score:+.1f} ± {gain.log_score_std:.1f}"


def _parameters(finding: Finding) -> Iterator[str]:
    for size in finding.sizes:
        key, dimension = size.parameter.name, size.parameter.dimension
        if size.std is None:
            digits, partly = ("6g", "") if size.seen else ("2g", " (not seen)")
            yield f"{key} {size.value:.{digits}} {size.parameter.unit}{partly}"
            continue
        _, symbol = units.readable(size.value, dimension)
        factor = units.find_unit(symbol, dimension).outside(1.0) if dimension and symbol != "1" else 1.0
        yield f"{key} = {units.format_quantity(size.value * factor, symbol, size.std * factor)}"


def _noise(diagnosis: Diagnosis) -> Iterator[str]:
    noise, declared = diagnosis.noise, diagnosis.job.declared
    interval = f"{noise.ratio:.2f} [{noise.low:.2f}, {noise.high:.2f}]"
    if declared == "estimated":
        yield f"The noise is {interval} times the noise that the job estimates."
    elif not noise.as_declared:
        yield f"The noise is {interval} times the declared noise ({declared})."
        yield "The standard uncertainties of the result are for the declared noise (`noise: estimated`: for the real)."
        if noise.low > 1:
            yield f"Usual reasons: {_USUAL}."
        if noise.low > _HIGH_NOISE and noise.dof < _FEW_DOF:
            yield f"With {noise.dof:.0f} degrees of freedom, several wrong readings may pass as noise: measure more."
    else:
        yield f"The noise is as declared ({interval} times {declared})."
    for unit in diagnosis.noisier_units:
        if unit.key == DECLARED_SIGMA:
            found = unit.ratio * noise.ratio
            what = unit.name.removeprefix("prior of ")
            yield f"The given values of each {what} are off by {found:.2g} times their stated sigma: correct the sigma."
            continue
        yield f"{unit.key} {unit.name} is {unit.ratio:.2g} times as noisy as the others."


def _chance(p: float) -> str:
    return "p < 1e-12" if p < _LEAST_P else f"p = {p:.2g}"


_HEAD = ("effect", "size", "chance", "or instead", "held-out error", "changes result by")


def _row(finding: Finding, adjusted: AdjustedJob) -> tuple[str, ...]:
    name, gain = finding.effect, finding.gain
    shift, unit = units.readable(finding.shift, adjusted.delivered.dimension)
    return (
        str(name.alternative),
        ", ".join(_parameters(finding)),
        _chance(float(np.exp(name.log_level))),
        ", ".join(str(rival.alternative) for rival in name.rivals) or "-",
        f"{-100 * gain.reduction:+.0f} %" + ("" if gain.shown else " (not shown)"),
        f"{units.two_digits(shift)} {unit}",
    )


def _candidates(adjusted: AdjustedJob, design: Design, named: Sequence[NamedEffect] | None) -> list[str]:
    """Return the table of candidates, with one line for all places of a cause that have the same status.

    Without `named` nothing was looked for yet: what residuals would exclude is `detectable`.
    """
    not_found = "detectable" if named is None else str(verdict.Status.EXCLUDED)
    rows: dict[tuple[str, str], list[Candidate]] = {}
    for candidate in design.candidates:
        word = str(verdict.status(candidate, named or ()))
        word = not_found if word == verdict.Status.EXCLUDED else word
        rows.setdefault((candidate.alternative.effect.name, word), []).append(candidate)
    lines = [_line(adjusted, name, word, found) for (name, word), found in rows.items()]
    for wrong in design.readings:
        if not wrong.testable:
            lines.append((wrong.effect.name, "one reading", verdict.Status.NOT_TESTABLE, "-", "-", verdict.UNCHECKED))
            continue
        size, unit = units.readable(wrong.detectable, wrong.effect.parameters[0].dimension)
        hides, at = units.readable(wrong.hides, adjusted.delivered.dimension)
        cells = (
            "one reading",
            not_found,
            f"{units.two_digits(size)} {unit}",
            f"{units.two_digits(hides)} {at}",
        )
        lines.append((wrong.effect.name, *cells, "larger ones are listed as outliers"))
    lines += [
        (one.effect.name, " ".join(one.where.values()), verdict.Status.NOT_TESTED, "-", "-", one.reason)
        for one in design.not_tested
    ]
    return _table(("effect", "where", "status", "detected from", "result off by up to", ""), lines)


def _line(adjusted: AdjustedJob, name: str, word: str, found: Sequence[Candidate]) -> tuple[str, ...]:
    places = ["/".join(one.alternative.instance) for one in found if one.alternative.instance]
    where = ", ".join(places[:_SHOWN]) + (f" and {len(places) - _SHOWN} more" if len(places) > _SHOWN else "")
    dimension = found[0].alternative.effect.parameters[0].dimension
    sizes = [one.detectable for one in found if one.testable]
    most = max(one.hides for one in found)
    hides, unit = units.readable(most, adjusted.delivered.dimension)
    why = ""
    if word == verdict.Status.NOT_TESTABLE:
        plausible, at = units.readable(found[0].plausible, dimension)
        size = f"{units.two_digits(plausible)} {at}".rstrip()
        why = f"absorbed by {', '.join(found[0].absorbed_by)}; the result is off by this if its size is {size}"
    seen = _span(min(sizes), max(sizes), dimension) if sizes else "-"
    return name, where, word, seen, f"{units.two_digits(hides)} {unit}", why


def _span(least: float, most: float, dimension: str) -> str:
    low, unit = units.readable(least, dimension)
    factor = most / least
    both = [units.two_digits(size) for size in ((low,) if factor < 1.05 else (low, low * factor))]
    return f"{' to '.join(both)} {unit}"


def _size(value: float, dimension: str) -> str:
    size, symbol = units.readable(value, dimension)
    return f"{units.two_digits(size)} {symbol}".strip()


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    lines = [tuple(head), *map(tuple, rows)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(head))]
    return ["  ".join(f"{cell:{width}}" for cell, width in zip(line, widths, strict=True)).rstrip() for line in lines]
