"""The noise in the report of a diagnosis: how it compares with the declared one, and which part has its own."""

from __future__ import annotations

from collections.abc import Iterator

from metrocli.adjust.clusters.robust import ESTIMATED
from metrocli.diagnosis.findings import Diagnosis
from metrocli.diagnosis.linear.projection import READING
from metrocli.diagnosis.noise import AS_OTHERS, DECLARED_SIGMA, VarianceGroup

_HIGH_NOISE, _FEW_DOF = 2.0, 30
"""Noise ratio above which, with fewer degrees of freedom than this, several wrong readings may pass as noise"""
_REAL = "`noise: estimated`, or `model: estimated` beside declared parts,"
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
        yield f"  The result's standard uncertainties are for the declared noise; {_REAL} take the real."
        if noise.low > 1:
            yield f"  Usual reasons: {_USUAL}."
        if noise.low > _HIGH_NOISE and noise.dof < _FEW_DOF:
            yield f"  With {noise.dof:.0f} degrees of freedom, several wrong readings may pass as noise: measure more."
    for unit in diagnosis.variance_groups:
        if unit.key == DECLARED_SIGMA:
            yield f"  {_given(unit, unit.ratio * noise.ratio)}"
        else:
            yield f"  {noisier(unit)}, each relative to what is declared for it."


def noisier(unit: VarianceGroup) -> str:
    """Return in words that a unit is noisier, or quieter, than the others, relative to what is declared for each."""
    name = unit.name if unit.key == READING else f"{unit.key} {unit.name}"
    return f"{name} is {unit.ratio:.2g} times as noisy as the others"


def _given(unit: VarianceGroup, ratio: float) -> str:
    """Return whether the residuals agree with the sigma of given values; `found` is the ratio of their noise to it."""
    what = f"The given values of each {unit.name.removeprefix('prior of ')}"
    if 1 / AS_OTHERS < ratio < AS_OTHERS:
        return f"{what} agree with their sigma; the ratio is that of the readings alone."
    return f"{what} are off by {ratio:.2g} times their sigma: correct the sigma."
