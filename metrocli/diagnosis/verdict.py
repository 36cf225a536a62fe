"""The verdict as plain data: the output of `metrocli diagnose --json`."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from metrocli import units
from metrocli.adjust.clusters.robust import STRUCTURED
from metrocli.adjust.model.blocks import Array
from metrocli.diagnosis.adjusted_job import REPORTED, AdjustedJob
from metrocli.diagnosis.correlated_error import CorrelatedError
from metrocli.diagnosis.detectability import Detectability
from metrocli.diagnosis.evidence.gain import Gain
from metrocli.diagnosis.findings import Diagnosis, Finding, Instead, RandomEffect, RemainingStructure
from metrocli.diagnosis.laws.definition import written
from metrocli.diagnosis.laws.law import Law
from metrocli.diagnosis.linear.candidates import Candidate
from metrocli.diagnosis.status import candidates, delivered
from metrocli.diagnosis.trials import Mistaken
from metrocli.diagnosis.wrong_readings import Outlier


def as_data(diagnosis: Diagnosis) -> dict[str, Any]:
    """Return a diagnosis under the keys of the contract, in internal units unless a `unit` stands beside a number."""
    noise, left = diagnosis.noise, diagnosis.left
    return {
        "verdict": diagnosis.verdict,
        "noise": {
            "declared": diagnosis.job.declared,
            "ratio": noise.ratio,
            "interval": [noise.low, noise.high],
            # a noise that follows the residuals is not declared
            "as_declared": noise.as_declared if diagnosis.job.declares_noise else None,
            "apart": [{unit.key: unit.name, "ratio": unit.ratio} for unit in diagnosis.variance_groups],
        },
        "part": _part(diagnosis.job),
        "limited": diagnosis.limited,
        "interrupted": diagnosis.interrupted,
        "quick": diagnosis.quick,
        "mistake": None if diagnosis.mistaken is None else _correction(diagnosis.mistaken),
        "noticed": list(diagnosis.job.noticed),
        "outliers": [_outlier(outlier) for outlier in diagnosis.outliers],
        "effects": [
            _effect(diagnosis.job, effect) if isinstance(effect, Finding) else _scatter(diagnosis.job, effect)
            for effect in diagnosis.identified
        ],
        "unconfirmed": [asdict(unconfirmed) for unconfirmed in diagnosis.unconfirmed],
        "together": None if diagnosis.together is None else _gain(diagnosis.together, diagnosis.job),
        "structure": {"before": diagnosis.before, "after": diagnosis.after},
        "unexplained": None if left is None else _left(diagnosis.job, left),
        "processes": [_process(diagnosis.job, error) for error in diagnosis.correlated_errors],
        "laws": [_law(diagnosis.job, law) for law in diagnosis.laws],
        "candidates": candidates(diagnosis.job, diagnosis.design, diagnosis.conclusions),
        "alike": alike(diagnosis.design),
        "separate_by": list(diagnosis.separate_by),
    }


def _process(job: AdjustedJob, process: CorrelatedError) -> dict[str, Any]:
    value, std, symbol = process.shown(*job.reading)
    return {
        "depends_on": process.covariate,
        "of_each": process.by or None,
        "of": process.place or None,
        "length": process.length,
        "std": {"value": value, "std": std, "unit": symbol},
        "visible": process.visible,
        "p_value": float(np.exp(process.log_level)),
        "instead_of": [*map(_named, process.instead_of)],
        "in_uncertainties": job.noise_model == STRUCTURED,
    }


def _law(job: AdjustedJob, law: Law) -> dict[str, Any]:
    texts = written(law)
    parameters: dict[str, Any] = {
        name: {"value": value, "std": std, "unit": unit} for name, (value, std, unit) in texts.parameters.items()
    }
    parameters |= {name: {"value": value, "std": None, "unit": unit} for name, (value, unit) in texts.scan.items()}
    return {
        "acts_on": law.terms[0].spot.acting.name,
        "where": dict(law.terms[0].spot.where),
        "adds": texts.adds[""] if set(texts.adds) == {""} else texts.adds,
        "parameters": parameters,
        "terms": len(law.terms),
        "p_value": law.p_value,
        "gain": _gain(law.gain, job),
        "part_of_structure": law.part_of_structure,
        "near": [_named(candidate) | {"correlation": cosine} for candidate, cosine in law.near],
        "as_likely": [
            {
                "acts_on": term.spot.acting.name,
                "component": term.spot.component,
                "where": dict(term.spot.where),
                "form": term.form.text,
            }
            for term in law.as_likely
        ],
        "chosen": law.chosen,
        "data": _shown(job, law) if law.chosen else None,
    }


def _shown(job: AdjustedJob, law: Law) -> dict[str, Any] | None:
    """Return a law at each reading, and the readings without it, over its variable."""
    data = law.data
    if data is None:
        return None
    size, symbol = units.column_unit(float(np.abs(data.law).max()), data.adds_unit)
    curve = data.curve and {"x": _short(data.curve[0]), "law": _short(data.curve[1] / size)}
    return {
        "variable": data.variable,
        "variable_unit": data.unit,
        "x": _short(data.x if data.variable else data.x / size),
        "law": _short(data.law / size),
        "residual": _short(data.residual / size),
        "unit": symbol,
        "curve": curve,
    }


def _short(values: Array) -> list[float]:
    """Return numbers to six digits, more than a picture shows."""
    return [float(f"{value:.6g}") for value in values.tolist()]


def design_data(job: AdjustedJob, design: Detectability) -> dict[str, Any]:
    """Return what a measurement can detect, as plain data."""
    return {"part": _part(job), "candidates": candidates(job, design), "alike": alike(design)}


def _part(job: AdjustedJob) -> dict[str, Any] | None:
    return None if job.part is None else asdict(job.part)


def _correction(mistaken: Mistaken) -> dict[str, Any]:
    """Return the most likely mistake, what to write instead, and those that explain the job as well."""
    files = [{"file": mistake.input, "what": mistake.words, "write": mistake.write} for mistake in mistaken.mistakes]
    return files[0] | {"alternatives": files[1:]}


def _effect(job: AdjustedJob, finding: Finding) -> dict[str, Any]:
    name, gain = finding.effect, finding.gain
    units_of = {parameter.name: parameter.unit for parameter in name.alternative.effect.scanned}
    return _named(name.alternative) | {
        "parameters": _parameters(finding),
        "p_value": float(np.exp(name.log_level)),
        "alternatives": [
            *(
                _named(rival.alternative)
                | {"correlation": None if rival.beside else rival.correlation, "odds": rival.odds}
                | ({"with": [*map(_named, rival.beside)]} if rival.beside else {})
                for rival in name.rivals
            ),
            *map(_error, finding.errors),
        ],
        "by": name.alternative.effect.by or None,
        "forms": [{"by": form.alternative.effect.by, "odds": form.odds} for form in name.forms],
        "aliases": [
            {"parameter": key, "value": value, "odds": odds, "unit": units_of[key]} for key, value, odds in name.aliases
        ],
        "times_usual": finding.times_usual,
        "other_shape_from": finding.other_shape_from,
        "gain": _gain(gain, job) | {"result_shift": delivered(job, finding.shift)},
    }


def _outlier(reading: Outlier) -> dict[str, Any]:
    return {
        "observation": dict(reading.keys),
        "or": [dict(other) for other in reading.others],
        "or_effects": [*map(_named, reading.effects)],
        "w": reading.test,
    }


def _scatter(job: AdjustedJob, scatter: RandomEffect) -> dict[str, Any]:
    """Return an effect at all places of a kind: one entry without a place, with the standard deviation of its sizes."""
    effect = scatter.effect
    return {
        "name": effect.name,
        "where": {},
        "parameters": {"std": {"value": scatter.std, "std": scatter.spread, "unit": effect.parameters[0].unit}},
        "p_value": float(np.exp(scatter.log_level)),
        "alternatives": [*map(_error, scatter.rivals)],
        "times_usual": scatter.times_usual,
        "other_shape_from": None,
        "gain": _gain(scatter.gain, job) | {"result_shift": delivered(job, scatter.shift)},
    }


def _named(alternative: Candidate) -> dict[str, Any]:
    return {"name": alternative.effect.name, "where": alternative.where | dict(alternative.named)}


def _error(instead: Instead) -> dict[str, Any]:
    return asdict(instead) | {"correlation": None, "words": str(instead)}


def _gain(gain: Gain, job: AdjustedJob) -> dict[str, Any]:
    unit = units.find_unit(*job.reading)
    return {
        "holdout_before": unit.outside(gain.before),
        "holdout_after": unit.outside(gain.after),
        "holdout_median_before": unit.outside(gain.median_before),
        "holdout_median_after": unit.outside(gain.median_after),
        "reduction_percent": 100 * gain.reduction,
        "unit": unit.symbol,
        "log_score": gain.log_score,
        "log_score_std": gain.log_score_std,
        "folds": list(gain.folds),
        "shown": gain.shown,
    }


def _left(job: AdjustedJob, left: RemainingStructure) -> dict[str, Any]:
    unit = units.find_unit(*REPORTED.get(left.unit, job.reading))
    return {
        "p_value": left.p_value,
        "depends_on": list(left.depends_on),
        "where": list(left.where),
        "size": {"value": unit.outside(left.size), "unit": unit.symbol},
    }


def _parameters(finding: Finding) -> dict[str, Any]:
    return {
        size.parameter.name: {"value": size.value, "std": size.std, "unit": size.parameter.unit}
        | ({} if size.seen else {"unseen": True})
        for size in finding.sizes
    }


def alike(design: Detectability) -> list[dict[str, Any]]:
    """Return the pairs of candidates that are hard to distinguish."""
    return [
        {
            "names": [pair.one, pair.other],
            "correlation": pair.correlation,
            "separable_from": {"value": pair.separable, "unit": pair.unit},
        }
        for pair in design.pairs
    ]
