"""The first lines of a diagnosis: the verdict, what is wrong, and how much of the misfit that explains."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from metrocli import units
from metrocli.adjust.clusters.robust import ESTIMATED, STRUCTURED
from metrocli.diagnosis.correlated_error import CorrelatedError
from metrocli.diagnosis.evidence.gain import LEAST_CHANGE
from metrocli.diagnosis.evidence.prices import LEVEL
from metrocli.diagnosis.findings import Diagnosis, Verdict
from metrocli.diagnosis.linear.projection import READING
from metrocli.diagnosis.noise import AS_OTHERS, DECLARED_SIGMA, VarianceGroup
from metrocli.words import in_a_row, listed

_SHOWN, _MOST_GROUPS = 6, 2
_BEYOND_USUAL = 10.0
"""Times the largest usual size of an effect from which a mistake is likelier"""
_LOOK_FIRST = "look for a mistake in the files and settings first (units, signs, columns, order of rows)"


def headline(diagnosis: Diagnosis) -> str:
    """Return the verdict with what limits it: wrong readings, and noise that is not as declared."""
    noise, count = diagnosis.noise, len(diagnosis.outliers)
    wrong = f", with {count} wrong reading{'s' if count > 1 else ''}" if count else ""
    compared = diagnosis.job.declares_noise and not (noise.as_declared or diagnosis.quick)
    limits = [f"the noise is {_times(noise.ratio)} times what was declared"] if compared else []
    groups = [noisier(unit) for unit in diagnosis.variance_groups if unit.key != DECLARED_SIGMA]
    several = f"{len(groups)} groups of readings are noisier or quieter than the others (below)"
    limits += groups if len(groups) <= _MOST_GROUPS else [several]
    limits += _given_wrongly(diagnosis)
    if diagnosis.left is None and diagnosis.job.noise_model != STRUCTURED:
        # one that chance makes often is listed below, and no reason for alarm
        limits += [
            f"an {smooth(error)} is not in the uncertainties of the result"
            for error in diagnosis.correlated_errors
            if error.log_level < np.log(LEVEL)
        ]
    where = f" in {diagnosis.job.part}" if diagnosis.job.part else ""
    where += f" so far ({diagnosis.ended_early})" if diagnosis.ended_early else ""
    but = ", and " if diagnosis.verdict is Verdict.UNEXPLAINED else ", but "
    return f"{diagnosis.verdict}{where}{wrong}{but if limits else ''}{', and '.join(limits)}"


def _times(ratio: float) -> str:
    """Return a ratio to two digits, and to three where these are those of 1."""
    text = units.two_digits(ratio)
    return text if text != "1" else f"{ratio:.3g}"


def summary(diagnosis: Diagnosis) -> Iterator[str]:
    """Yield what is left out, what is wrong, how much of the misfit it explains, and what remains."""
    out = diagnosis.job.left_out
    if out:
        readings = f"{out} readings" if out > 1 else "the reading"
        yield f"  without {readings} that `outliers: remove` leaves out (table rejected of the result)"
    gain = diagnosis.gain
    if gain is None or not (gain.explains or diagnosis.verdict is Verdict.EXPLAINED):
        return
    # several may explain together what each alone does not
    names = [str(one) for one in diagnosis.identified if one.gain.explains] or list(map(str, diagnosis.identified))
    explained = f"{100 * gain.explained:.0f} %" if gain.explained > LEAST_CHANGE else "little"
    verb, remains = "explain" if len(names) > 1 else "explains", ""
    rest = [error for error in diagnosis.correlated_errors if error.is_in_unit_of(diagnosis.job.reading[1])]
    if rest:
        size = units.sized(
            float(np.sqrt(sum((error.std * error.visible) ** 2 for error in rest))), diagnosis.job.reading[1]
        )
        remains = (
            f"; {size} that vary with {listed(list(dict.fromkeys(error.covariate for error in rest)), _SHOWN)} remain"
        )
    yield f"  {listed(names, _SHOWN)} {verb} {explained} of the misfit (squares of held-out errors){remains}"


def beyond_usual(diagnosis: Diagnosis) -> Iterator[str]:
    """Yield what is larger than it is in practice: an effect can stand for a mistake in a file that is like it."""
    times = [(str(each), each.times_usual or 0.0) for each in diagnosis.identified]
    beyond = [(name, ratio) for name, ratio in times if ratio > _BEYOND_USUAL]
    if beyond:
        sizes = listed([f"{name} (at least {units.two_digits(ratio)} times)" for name, ratio in beyond], _SHOWN)
        yield f"  far above the largest usual size: {sizes}; {_LOOK_FIRST}"


def smooth(process: CorrelatedError) -> str:
    """Return a smooth random error in words."""
    each = f" of each {process.by} by itself" if process.by else ""
    each = f" of {process.by} {process.place}" if process.place else each
    return f"error that varies smoothly with {process.covariate}{each}"


_HIGH_NOISE, _FEW_DOF = 2.0, 30
"""Noise ratio above which, with fewer degrees of freedom than this, several wrong readings may pass as noise"""
_USUAL = "a machine or mover that does not return to the same place, a wrong sigma, vibration or turbulence of the air"


def noise_lines(diagnosis: Diagnosis) -> Iterator[str]:
    """Yield the noise that was found against the declared one, and the units with a noise of their own."""
    noise, declared = diagnosis.noise, diagnosis.job.declared
    interval = f"{noise.ratio:.2f} [{noise.low:.2f}, {noise.high:.2f}]"
    if diagnosis.job.noise_model:
        yield f"noise: {interval} times the noise that the job estimates"
    elif ESTIMATED in declared:
        yield f"noise: {interval} times that of the job ({declared}); the estimated part follows the residuals"
    elif noise.as_declared:
        others = " for the others" if any(unit.key != DECLARED_SIGMA for unit in diagnosis.variance_groups) else ""
        yield f"noise: as declared{others} ({interval} times {declared or 'it'})"
    else:
        yield f"noise: {interval} times the declared noise{f' ({declared})' if declared else ''}"
        real = f"`{diagnosis.job.model_key}: {ESTIMATED}`"
        yield f"  The result's standard uncertainties are for the declared noise; {real} uses the noise that was found."
        if noise.is_implausible:
            yield f"  An instrument seldom has so much: {_LOOK_FIRST}."
        elif noise.low > 1:
            yield f"  Usual reasons: {_USUAL}."
        if noise.low > _HIGH_NOISE and noise.dof < _FEW_DOF:
            yield f"  With {noise.dof:.0f} degrees of freedom, several wrong readings may pass as noise: measure more."
    if not diagnosis.job.smooth_covariates and not diagnosis.quick:
        yield "  Errors that vary smoothly are not sought: no covariate is known of all groups of readings."
    readings = [unit for unit in diagnosis.variance_groups if unit.key != DECLARED_SIGMA]
    weighted = f"; `variance_groups:` weights {'it' if len(readings) == 1 else 'them'} so"
    if len(readings) == 1:
        yield f"  {noisier(readings[0])}, each relative to what is declared for it{weighted}."
    elif readings:
        each = "; ".join(f"{_named(unit)} {units.two_digits(unit.ratio)}" for unit in readings)
        yield f"  Times as noisy as the others, each relative to what is declared for it: {each}{weighted}."
    given, wrong = [unit for unit in diagnosis.variance_groups if unit.key == DECLARED_SIGMA], _given_wrongly(diagnosis)
    right = [unit for unit in given if _is_right(unit, noise.ratio)]
    if right:
        kinds = in_a_row([unit.name.removeprefix("prior of ") for unit in right])
        yield f"  The given values of each {kinds} agree with their sigma; the ratio is that of the readings alone."
    yield from (f"  T{words[1:]}: correct the sigma." for words in wrong)


def _named(unit: VarianceGroup) -> str:
    return unit.name if unit.key == READING else f"{unit.key} {unit.name}"


def noisier(unit: VarianceGroup) -> str:
    """Return in words that a unit is noisier, or quieter, than the others, relative to what is declared for each."""
    return f"{_named(unit)} is {units.two_digits(unit.ratio)} times as noisy as the others"


def _is_right(given: VarianceGroup, noise: float) -> bool:
    """Return whether the residuals agree with the sigma of given values; `noise` is the ratio of that of the others."""
    return 1 / AS_OTHERS < given.ratio * noise < AS_OTHERS


def _given_wrongly(diagnosis: Diagnosis) -> list[str]:
    """Return in words by how much given values are off where that does not agree with their sigma."""
    noise, given = diagnosis.noise.ratio, (unit for unit in diagnosis.variance_groups if unit.key == DECLARED_SIGMA)
    wrong = [unit for unit in given if not _is_right(unit, noise)]
    sizes = [(unit.name.removeprefix("prior of "), units.two_digits(unit.ratio * noise)) for unit in wrong]
    return [f"the given values of each {kind} are off by {size} times their sigma" for kind, size in sizes]
