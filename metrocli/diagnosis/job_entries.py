"""What the extended job has that the job has not: entries of effects, and the noise."""

from __future__ import annotations

from collections.abc import Mapping

from metrocli.adjust.cluster_robust import FEWEST, STRUCTURED
from metrocli.diagnosis.findings import Diagnosis
from metrocli.diagnosis.searched import Scatter
from metrocli.diagnosis.selection.confidence_set import NamedEffect


def scatter_as_job(one: Scatter) -> Mapping[str, str]:
    """Return the entry of an effect at all places of a kind in a job."""
    effect = one.found.effect
    return {"name": effect.name, "std": _written(float(f"{one.found.std:.3g}"), effect.parameters[0].unit)}


def proposed_noise(diagnosis: Diagnosis) -> str:
    """Return the noise that the extended job takes, so that uncertainties include the structure left; else ''."""
    job = diagnosis.job
    wanted = diagnosis.left is not None and job.sharing >= FEWEST and job.noise_model != STRUCTURED
    return STRUCTURED if wanted else ""


def as_job(name: NamedEffect) -> Mapping[str, str]:
    """Return the entry of an effect in a job: to be estimated, with scanned parameters and those taken as 0."""
    alternative = name.alternative
    effect = alternative.effect
    known = {p.name: p for p in effect.all_parameters}
    found = {"name": effect.name, **dict(zip(effect.keys, alternative.instance, strict=True))}
    if effect.by:
        found["by"] = effect.by
    numbers = {key: _written(value, known[key].unit) for key, value in name.known.items() if not known[key].place}
    return found | dict(alternative.named) | numbers


def _written(value: float, unit: str) -> str:
    return f"{value:.10g} {unit}" if unit not in ("", "1") else f"{value:.10g}"
