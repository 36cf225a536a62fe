"""The result of report-uncertainty: each measurand by GUM and Monte Carlo, its budget, and the decision."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from metrocli.frozen import dataclass
from metrocli.result import Estimate, Result
from metrocli.table import Table
from metrocli.tasks.report_uncertainty import KIND
from metrocli.tasks.report_uncertainty import budget as budget_text
from metrocli.tasks.report_uncertainty.budget import MeasurandBudget, needed_factors
from metrocli.tasks.report_uncertainty.decisions import PLAIN as DECIDED
from metrocli.tasks.report_uncertainty.decisions import DecidedMeasurand, decide, limits_of, lines
from metrocli.tasks.report_uncertainty.entries import Entries
from metrocli.tasks.report_uncertainty.problem import PropagationProblem
from metrocli.uncertainty.monte_carlo import MonteCarloResult
from metrocli.uncertainty.propagation import (
    Coverage,
    LinearPropagation,
    Propagated,
    coverage_factor,
    covered,
    ellipsoid_factor,
    t_std,
    whole_dof,
)
from metrocli.uncertainty.validation import Judged, Validation, judge, known_ends
from metrocli.units import rounded

_MANY = 1e6
"""Degrees of freedom that are not reported: k is that of the normal distribution"""
_PURE = ("trials", "covered")
"""Numbers of a Monte Carlo run that have no unit"""
_ROUNDING = 1e-14
"""A smaller relative std of trials is that of rounding errors"""
_BINS, _LEAST_SHOWN = 60, 0.998
"""Bins of a histogram of trials, and the share of the trials that it shows at least"""
PLAIN = ("k", "dof", "probability", "trials", "covered", "gum_valid", "capable", "factor", *DECIDED)


@dataclass(frozen=True)
class BothMethods:
    """The results of both methods, GUM and Monte Carlo."""

    problem: PropagationProblem
    propagated: Propagated
    coverage: Coverage
    outcome: MonteCarloResult | None
    settings: Entries


@dataclass(frozen=True)
class _Measurand:
    """One measurand with its results, in its own unit."""

    name: str
    unit: str
    linear: LinearPropagation
    value: float
    std: float
    details: dict[str, Any]
    verdict: Validation | None
    budget: MeasurandBudget


def report(evaluation: BothMethods) -> Result:
    """Return the result of a job."""
    names = list(evaluation.problem.models)
    measurands = [_measurand(evaluation, index, name) for index, name in enumerate(names)]
    factors = np.array([evaluation.problem.units[name].factor for name in names])
    covariance = evaluation.propagated.covariance.copy()
    if evaluation.outcome is not None:
        # where the law of propagation does not apply, the covariance is that of the trials
        replaced = [n for n, m in enumerate(measurands) if m.linear.replaced]
        covariance[replaced, :] = evaluation.outcome.covariance[replaced, :]
        covariance[:, replaced] = evaluation.outcome.covariance[:, replaced]
    covariance = covariance / factors[:, None] / factors
    statistics: dict[str, Any] = {"measurands": len(names), "quantities": len(evaluation.problem.inputs.quantities)}
    arrays = {}
    if len(names) > 1:
        statistics["joint_factor"] = ellipsoid_factor(covered(evaluation.coverage, math.inf), len(names))
        arrays["correlation"] = _correlation(covariance)
    if evaluation.outcome is not None:
        statistics |= {"trials": evaluation.outcome.trials, "seed": evaluation.settings.monte_carlo.seed}
        arrays["monte_carlo_covariance"] = evaluation.outcome.covariance / factors[:, None] / factors
    return Result(
        kind=KIND.name,
        title="",
        estimates=tuple(Estimate(m.name, m.value, m.std, m.unit) for m in measurands),
        covariance=covariance,
        statistics=statistics,
        tables=budget_text.tables([m.budget for m in measurands]) | _histograms(evaluation, measurands),
        arrays=arrays,
        warnings=(*evaluation.problem.warnings, *(note for m in measurands for note in _warnings(m))),
        notes=tuple(line for m in measurands for line in _notes(m)),
        details={m.name: m.details for m in measurands},
        plain=PLAIN,
    )


def _correlation(covariance: Any) -> Any:
    std = np.sqrt(np.diag(covariance))
    scale = np.where(std > 0, std, 1.0)
    return covariance / scale[:, None] / scale


def _measurand(evaluation: BothMethods, index: int, name: str) -> _Measurand:
    unit, linear = evaluation.problem.units[name], evaluation.propagated.measurands[name]
    k, probability = coverage_factor(evaluation.coverage, linear.dof), covered(evaluation.coverage, linear.dof)
    factor, mc = unit.factor, _monte_carlo(evaluation, index, probability)
    std, interval = linear.std, (linear.value - k * linear.std, linear.value + k * linear.std)
    if linear.replaced and mc is not None:
        std, interval = mc["std"], tuple(mc["interval"])
        # a job states a probability or k, and the other one follows from the trials
        if evaluation.coverage.k is None:
            k = (interval[1] - interval[0]) / 2 / std if std > 0 else k
        else:
            interval = (mc["mean"] - k * std, mc["mean"] + k * std)
            probability = _share_within(evaluation, index, interval)
    details: dict[str, Any] = {
        "U": k * std / factor, "k": k, "dof": linear.dof, "probability": probability,
        "interval": [end / factor for end in interval],
        "second_order": {"value": linear.second_value / factor, "std": linear.second_std / factor},
    }  # fmt: skip
    verdict = None
    if mc is not None:
        mc["covered"] = _share_within(evaluation, index, interval) if mc["std"] else 1.0
        mc = details["mc"] = {key: item if key in _PURE else _scaled(item, factor) for key, item in mc.items()}
        verdict = _verdict(evaluation, index, name, k, mc)
    details["gum_valid"] = math.nan if verdict is None or verdict.valid is None else verdict.valid
    if evaluation.settings.tolerance and name in evaluation.settings.tolerance:
        details["tolerance"] = _decision(evaluation, index, name, std, k * std)
    parts = _budget(evaluation, name, details)
    return _Measurand(name, unit.text, linear, linear.value / factor, std / factor, details, verdict, parts)


def _budget(evaluation: BothMethods, name: str, details: dict[str, Any]) -> MeasurandBudget:
    """Return the budget of a measurand, and add its target, if it has one, to the details."""
    unit, linear = evaluation.problem.units[name], evaluation.propagated.measurands[name]
    plain = MeasurandBudget(name, "" if unit.text == "1" else unit.text, unit.factor, linear, evaluation.problem.inputs)
    if name not in evaluation.settings.target:
        return plain
    wanted = evaluation.settings.target[name].value
    U = details["U"] * unit.factor
    reached = wanted >= U
    details["target"] = {"U": wanted / unit.factor, "reached": reached, "factor": 1.0 if reached else wanted / U}
    needed = None if linear.replaced else needed_factors(linear, plain.inputs, evaluation.coverage, wanted)
    return replace(plain, target=wanted / unit.factor, needed=needed)


def _verdict(evaluation: BothMethods, index: int, name: str, k: float, mc: dict[str, Any]) -> Validation:
    """Return the validation of the law of propagation by Monte Carlo (JCGM 101, 8), with u in the measurand's unit."""
    linear, outcome = evaluation.propagated.measurands[name], evaluation.outcome
    factor = evaluation.problem.units[name].factor
    assert outcome is not None
    if linear.replaced:
        return Validation(False, linear.notes)
    probability = covered(evaluation.coverage, linear.dof)
    normal = coverage_factor(Coverage(probability), math.inf)
    value, std, second = linear.value / factor, linear.std / factor, linear.second_std / factor
    ends = (mc["interval"][0], mc["interval"][1])
    wider = t_std(evaluation.problem.inputs, linear.sensitivities) / factor
    centre = outcome.centres[index]
    low, high = (
        ((end[0] + centre) / factor, (end[1] + centre) / factor)
        for end in known_ends(outcome.samples[index], probability, outcome.trials)
    )
    judged = Judged(
        value, std, k * std, linear.nonlinear, second, mc["mean"], mc["std"], ends, (low, high), outcome.trials,
        normal, wider,
    )  # fmt: skip
    return judge(judged, evaluation.settings.monte_carlo.digits)


def _decision(evaluation: BothMethods, index: int, name: str, std: float, expanded: float) -> dict[str, Any]:
    linear, outcome = evaluation.propagated.measurands[name], evaluation.outcome
    sample = outcome.samples[index] if outcome is not None else None
    centre = outcome.centres[index] if outcome is not None else 0.0
    measured = DecidedMeasurand(linear.value, std, expanded, whole_dof(linear.dof), sample, centre)
    return decide(limits_of(evaluation.settings.tolerance[name]), measured, evaluation.problem.units[name].factor)


def _scaled(value: Any, factor: float) -> Any:
    return [item / factor for item in value] if isinstance(value, list | tuple) else value / factor


def _share_within(evaluation: BothMethods, index: int, interval: tuple[float, float]) -> float:
    """Return the share of the trials of a measurand within an interval, nan without trials."""
    if evaluation.outcome is None:
        return math.nan
    sample, centre = evaluation.outcome.samples[index], evaluation.outcome.centres[index]
    return sample.below(interval[1] - centre) - sample.below(interval[0] - centre)


def _monte_carlo(evaluation: BothMethods, index: int, probability: float) -> dict[str, Any] | None:
    outcome = evaluation.outcome
    if outcome is None:
        return None
    sample, centre = outcome.samples[index], outcome.centres[index]
    mean, std = float(outcome.means[index]), math.sqrt(outcome.covariance[index, index])
    if std <= _ROUNDING * abs(mean):
        return {"mean": mean, "std": 0.0, "interval": [mean, mean], "shortest": [mean, mean], "trials": outcome.trials}
    run: dict[str, Any] = {
        "mean": mean,
        "std": std,
        "interval": [end + centre for end in sample.symmetric(probability)],
        "shortest": [end + centre for end in sample.shortest(probability)],
        "trials": outcome.trials,
    }
    return run | ({"resolution": sample.resolution} if sample.resolution else {})


def _histograms(evaluation: BothMethods, measurands: Sequence[_Measurand]) -> dict[str, Table]:
    """Return the share of the trials of each measurand in equal bins, which also hold the intervals of both methods."""
    rows: list[tuple[Any, ...]] = []
    for index, measurand in enumerate(measurands):
        outcome, mc = evaluation.outcome, measurand.details.get("mc")
        if outcome is None or not mc or not mc["std"]:
            continue
        factor, sample, centre = measurand.budget.factor, outcome.samples[index], outcome.centres[index]
        ends = [*(end + centre for end in sample.symmetric(_LEAST_SHOWN))]
        ends += [end * factor for end in (*measurand.details["interval"], *mc["interval"])]
        edges = np.linspace(min(ends), max(ends), _BINS + 1)
        below = [sample.below(edge - centre) for edge in edges.tolist()]
        edges = edges / factor
        rows += [(measurand.name, edges[n], edges[n + 1], 100 * (below[n + 1] - below[n])) for n in range(_BINS)]
    return {"trials": Table.of_rows(("measurand [text]", "from", "to", "share [percent]"), rows)} if rows else {}


def _warnings(measurand: _Measurand) -> list[str]:
    warnings = [f"{measurand.name}: {note}" for note in measurand.linear.notes]
    # `valid` has a third value, None, if the trials do not decide
    if measurand.verdict is not None and measurand.verdict.valid is False and not measurand.linear.replaced:
        warnings.append(f"{measurand.name}: Monte Carlo does not validate the interval of GUM; use that of Monte Carlo")
    return warnings


def _notes(measurand: _Measurand) -> list[str]:
    details, unit = measurand.details, "" if measurand.unit == "1" else f" {measurand.unit}"
    value, std = rounded(measurand.value, measurand.std)
    U, dof = rounded(measurand.value, details["U"])[1], details["dof"]
    freedom = f", {dof:.4g} effective degrees of freedom" if dof < _MANY else ""
    covers = f"k = {details['k']:.3g}, {100 * details['probability']:.4g} %"
    notes = [f"{measurand.name} = {value}{unit}, U = {U}{unit} ({covers}{freedom}), u = {std}{unit}"]
    second = details["second_order"]
    if math.isfinite(second["std"]) and measurand.linear.nonlinear > 1e-4:
        value, std = rounded(second["value"], second["std"])
        notes.append(f"  second order: {value}{unit}, u = {std}{unit}")
    mc = details.get("mc")
    if mc is not None:
        ends = [
            "[" + ", ".join(rounded(end, mc["std"] / 10)[0] for end in mc[key]) + "]"
            for key in ("interval", "shortest")
        ]
        mean, std = rounded(mc["mean"], mc["std"])
        notes.append(
            f"  Monte Carlo, {mc['trials']} trials: {mean}{unit}, u = {std}{unit}, interval {ends[0]}, "
            f"shortest {ends[1]}{unit}"
        )
        notes.append(f"  U covers {100 * mc['covered']:.4g} % of the trials")
        if mc.get("resolution"):
            notes.append(f"  trials counted in bins: interval ends are known to {mc['resolution']:.1e}{unit}")
    notes += _judgement(measurand)
    notes += [f"  {line}" for line in budget_text.lines(measurand.budget)]
    notes += [f"  {line}" for line in budget_text.reverse_lines(measurand.budget, details.get("target", {}))]
    if "tolerance" in details:
        notes += [f"  {line}" for line in lines(details["tolerance"], measurand.unit)]
    return notes


def _judgement(measurand: _Measurand) -> list[str]:
    verdict = measurand.verdict
    if verdict is None:
        return []
    if verdict.valid:
        return ["  Monte Carlo validates GUM (JCGM 101, clause 8)"]
    does = "does not decide whether GUM holds" if verdict.valid is None else "does not validate GUM"
    return [f"  Monte Carlo {does} (JCGM 101, clause 8):"] + [f"    {reason}" for reason in verdict.reasons]
