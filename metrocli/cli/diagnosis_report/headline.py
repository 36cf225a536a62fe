"""The first lines of a diagnosis: the verdict, what is wrong, and how much of the misfit that explains."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from metrocli import units
from metrocli.adjust.clusters.robust import ESTIMATED, STRUCTURED
from metrocli.cli.diagnosis_report.noise import noisier
from metrocli.diagnosis.correlated_error import CorrelatedError
from metrocli.diagnosis.findings import Diagnosis, Finding
from metrocli.diagnosis.noise import DECLARED_SIGMA
from metrocli.words import listed

_SHOWN = 6
LEAST_REDUCTION = 0.005
"""Least share of the held-out errors that is shown as a change"""


def headline(diagnosis: Diagnosis) -> str:
    """Return the verdict with what limits it: wrong readings, and noise that is not as declared."""
    noise, count = diagnosis.noise, len(diagnosis.outliers)
    wrong = f", with {count} wrong reading{'s' if count > 1 else ''}" if count else ""
    if diagnosis.quick:
        return f"{diagnosis.verdict}{wrong}"
    as_declared = noise.as_declared or diagnosis.job.noise_model or ESTIMATED in diagnosis.job.declared
    limits = [] if as_declared else [f"the noise is {_times(noise.ratio)} times what was declared"]
    limits += [noisier(unit) for unit in diagnosis.variance_groups if unit.key != DECLARED_SIGMA]
    if diagnosis.left is None and diagnosis.job.noise_model != STRUCTURED:
        limits += [
            f"an {smooth(error)} is not in the uncertainties of the result" for error in diagnosis.correlated_errors
        ]
    where = f" in {diagnosis.job.part}" if diagnosis.job.part else ""
    where += f" so far ({diagnosis.ended_early})" if diagnosis.ended_early else ""
    return f"{diagnosis.verdict}{where}{wrong}{', but ' if limits else ''}{', and '.join(limits)}"


def _times(ratio: float) -> str:
    """Return a ratio to two digits, and to three where these are those of 1."""
    text = f"{ratio:.2g}"
    return text if text != "1" else f"{ratio:.3g}"


def summary(diagnosis: Diagnosis) -> Iterator[str]:
    """Yield what is wrong, how much of the misfit it explains, and what remains."""
    gain = diagnosis.gain
    if gain is None or gain.log_score <= 0:
        return
    names = [
        str(effect.effect.alternative) if isinstance(effect, Finding) else f"{effect.effect.name} everywhere"
        for effect in diagnosis.identified
        if effect.gain.log_score > 0
    ]
    share = 1 - (gain.after / gain.before) ** 2 if gain.before else 0.0
    explained = f"{100 * share:.0f} %" if share > LEAST_REDUCTION else "little"
    verb, remains = "explain" if len(names) > 1 else "explains", ""
    rest = [error for error in diagnosis.correlated_errors if error.unit == diagnosis.job.reading[0]]
    if rest:
        size = units.sized(
            float(np.sqrt(sum((error.std * error.visible) ** 2 for error in rest))), diagnosis.job.reading[1]
        )
        remains = (
            f"; {size} that vary with {listed(list(dict.fromkeys(error.covariate for error in rest)), _SHOWN)} remain"
        )
    yield f"  {listed(names, _SHOWN)} {verb} {explained} of the misfit (squares of held-out errors){remains}"


def smooth(process: CorrelatedError) -> str:
    """Return a smooth random error in words."""
    each = f" of each {process.by} by itself" if process.by else ""
    return f"error that varies smoothly with {process.covariate}{each}"
