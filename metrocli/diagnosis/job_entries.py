"""What the extended job has that the job lacks: entries of effects, and the noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from metrocli import units
from metrocli.adjust.clusters.robust import ESTIMATED, FEWEST, FROM_RESIDUALS, STRUCTURED
from metrocli.diagnosis.correlated_error import CorrelatedError
from metrocli.diagnosis.evidence.identified import IdentifiedEffect
from metrocli.diagnosis.findings import Diagnosis, RandomEffect
from metrocli.diagnosis.noise import AS_OTHERS, DECLARED_SIGMA, VarianceGroup
from metrocli.effects.correlated import stds
from metrocli.effects.effect import Parameter
from metrocli.effects.variance_groups import MOST, StatedVariance
from metrocli.nodes import Node, node_of
from metrocli.units import parse_quantity

_MODEL = "model"
"""Key beside the declared parts of a noise"""
REMOVE = "remove"
"""Of `outliers` in a job that leaves them out"""


def declares(noise: Node | None, scatter: RandomEffect) -> bool:
    """Whether the noise of a job can declare a scatter: it has parts, and this part is a number or absent."""
    key = scatter.effect.noise
    if not key or noise is None or noise.kind != "mapping":
        return False
    known = noise.get(key)
    return known is None or known.text != ESTIMATED


def with_declared(noise: Node, scatter: RandomEffect) -> Node:
    """Return the noise of a job with a scatter beside what it declares, `sqrt(declared^2 + std^2)`."""
    effect, known = scatter.effect, noise.get(scatter.effect.noise)
    before = parse_quantity(known.text, effect.parameters[0].dimension) if known is not None else 0.0
    text = _size(effect.parameters[0], float(np.hypot(before, scatter.std)))
    plain = replace(noise, kind="scalar", entries=(), items=())
    kept = tuple(entry for entry in noise.entries if entry[0].text != effect.noise)
    return replace(noise, entries=(*kept, (replace(plain, text=effect.noise), replace(plain, text=text))))


def scatter_as_job(scatter: RandomEffect) -> Mapping[str, str]:
    """Return the entry of an effect at all places of a kind in a job."""
    effect = scatter.effect
    return {"name": effect.name, "std": _size(effect.parameters[0], scatter.std)}


def proposed_correlated(diagnosis: Diagnosis) -> tuple[CorrelatedError, ...]:
    """Return the correlated errors that the extended job states, so that its estimates and uncertainties have them.

    Where single units (images) have errors of their own, those of the others are not alike either: `noise: structured`
    takes them as they are. One that no job can state, far larger than the declared noise, is left out.
    """
    job, groups = diagnosis.job, diagnosis.job.model.readings
    errors = tuple(error for error in diagnosis.correlated_errors if stds(correlated_as_job(error)["std"], groups))
    alike = not any(error.place for error in errors) or job.sharing < FEWEST
    return errors if alike and job.states_correlated and job.noise_model != STRUCTURED else ()


def correlated_as_job(error: CorrelatedError) -> Mapping[str, str]:
    """Return the entry of a correlated error in a job."""
    size, symbol = units.column_unit(error.std, error.unit)
    entry = {"covariate": error.covariate} | ({"by": error.by} if error.by else {})
    entry |= {"only": error.place} if error.place else {}
    return entry | {"length": f"{error.length:.6g}", "std": _written(float(f"{error.std / size:.3g}"), symbol)}


def variance_groups_as_job(diagnosis: Diagnosis, stated: Sequence[StatedVariance]) -> Sequence[Mapping[str, str]]:
    """Return the variance groups of a job with those that were found; readings of one that it states have both."""
    ratios = {(group.by, group.only): group.ratio for group in stated}
    for group in proposed_variances(diagnosis):
        at = group.key, group.name
        ratios[at] = float(np.clip(ratios.get(at, 1.0) * group.ratio, 1 / MOST, MOST))
    return [{"by": by, "only": only, "ratio": f"{ratio:.3g}"} for (by, only), ratio in ratios.items()]


def proposed_variances(diagnosis: Diagnosis) -> Sequence[VarianceGroup]:
    """Return the variance groups that the extended job states: those of readings, not of values with a sigma."""
    return [group for group in diagnosis.variance_groups if group.key != DECLARED_SIGMA]


def proposed_noise(diagnosis: Diagnosis) -> str:
    """Return the noise that the extended job takes, so that it is the one that was found; else ''.

    Uncertainties for white noise include neither structure that is left nor smooth errors that count as noise. Standard
    deviations of effects and correlated errors were found beside the noise of the readings: another one would weigh
    them otherwise.
    """
    job, left = diagnosis.job, diagnosis.left
    stated = {error.covariate for error in proposed_correlated(diagnosis)}
    remains = not {*left.depends_on} <= stated if left is not None else bool(diagnosis.correlated_errors and not stated)
    if remains and job.sharing >= FEWEST:
        return STRUCTURED if job.noise_model != STRUCTURED else ""
    has_sizes, ratio = bool(stated or diagnosis.scatters), diagnosis.noise.ratio
    other = job.sharing and job.declares_noise and not 1 / AS_OTHERS < ratio < AS_OTHERS
    return ESTIMATED if has_sizes and other and not diagnosis.noise.as_declared else ""


def removes_wrong_readings(diagnosis: Diagnosis) -> bool:
    """Whether the extended job leaves outliers out, without which its effects were found; the job itself does not."""
    known = any(not outlier.others for outlier in diagnosis.outliers)
    return known and diagnosis.mistaken is None and diagnosis.job.outliers not in ("", REMOVE)


def as_job(name: IdentifiedEffect) -> Mapping[str, str]:
    """Return the entry of an effect in a job: to be estimated, with scanned parameters and those taken as 0."""
    alternative = name.alternative
    effect = alternative.effect
    known = {p.name: p for p in effect.all_parameters}
    entry = {"name": effect.name, **dict(zip(effect.keys, alternative.instance, strict=True))}
    if effect.by:
        entry["by"] = effect.by
    numbers = {key: _written(value, known[key].unit) for key, value in name.known.items() if not known[key].place}
    return entry | dict(alternative.named) | numbers


def _size(parameter: Parameter, size: float) -> str:
    """Return a size in the unit that suits it, as the report has it."""
    value, unit = parameter.readable(size) if parameter.dimension else (size, parameter.unit)
    return _written(float(f"{value:.3g}"), unit)


def _written(value: float, unit: str) -> str:
    return f"{value:.10g} {unit}" if unit not in ("", "1") else f"{value:.10g}"


def declared_noise(node: Node | None) -> str:
    """Return the declared parts of a noise in words, without its model."""
    if node is None:
        return ""
    if node.kind == "scalar":
        return node.text
    return ", ".join(
        filter(None, (_declared_part(key.text, entry) for key, entry in node.entries if key.text != _MODEL))
    )


def _declared_part(key: str, node: Node) -> str:
    """Return a part of the noise in words; one that follows the residuals has its name: repeatability estimated."""
    return f"{key} {node.text}" if node.kind == "scalar" and node.text == ESTIMATED else declared_noise(node)


def model_of(node: Node | None) -> str:
    """Return `estimated` or `structured` if the job has it, alone or beside declared parts; else ''."""
    text = node.get(_MODEL) if node is not None and node.kind == "mapping" else node
    return text.text if text is not None and text.text in FROM_RESIDUALS else ""


def key_of_model(node: Node | None) -> str:
    """Return the key under which a job states what its noise is: beside declared parts, else in their place."""
    return _MODEL if node is not None and node.kind == "mapping" else "noise"


def with_model(root: Node, declared: Node, model: str) -> Node:
    """Return the noise of a job with a model: beside its declared parts, else in their place."""
    if declared.kind != "mapping":
        return node_of(root, model)
    parts = tuple((key, value) for key, value in declared.entries if key.text != _MODEL)
    return replace(declared, entries=(*parts, (node_of(root, _MODEL), node_of(root, model))))
