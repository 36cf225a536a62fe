"""The result of the volume form: the largest uncertainty per axis, by contributor and by point.

By contributor, the root sum of squares of each contributor's maximum in the volume. By point, the maximum of the root
sum of squares at each point.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from metrocli.arrays import Array
from metrocli.expressions.dimensions import converted
from metrocli.expressions.expression import Expression, parse
from metrocli.frozen import dataclass
from metrocli.result import Estimate, Result
from metrocli.table import Table
from metrocli.tasks.report_uncertainty import KIND
from metrocli.tasks.report_uncertainty.budget import aligned
from metrocli.tasks.report_uncertainty.entries import Entries
from metrocli.tasks.report_uncertainty.volume_problem import VolumeProblem, build
from metrocli.uncertainty import monte_carlo
from metrocli.uncertainty.decision import FACTOR_2017, capable
from metrocli.uncertainty.distributions import Normal, Uniform
from metrocli.uncertainty.inputs import InputQuantity, Inputs, join
from metrocli.uncertainty.propagation import Coverage, coverage_factor, covered, effective_dof
from metrocli.uncertainty.trials import plan_of
from metrocli.uncertainty.validation import Judged, judge, known_ends
from metrocli.uncertainty.volume import AXES, Contribution, Extremes, by_source, extremes
from metrocli.uncertainty.workers import Workers
from metrocli.units import two_digits

PLAIN = (
    "k",
    "dof",
    "probability",
    "trials",
    "gum_valid",
    "capable",
    "U_over_T",
    "U_over_T_pointwise",
    "k_trials",
    "covered",
)


@dataclass(frozen=True)
class _Axis:
    """Result along one axis; `std` combines the contributors' maxima, `pointwise` is the largest at a point."""

    name: str
    std: float
    pointwise: float
    place: Array
    k: float
    dof: float
    mc: monte_carlo.MonteCarloResult | None


def run(settings: Entries, results: Mapping[str, Result], workers: Workers) -> Result:
    """Return the result of a job with a volume; raises InputError with its faults."""
    problem = build(settings, results)
    largest = extremes(problem.contributions, problem.points)
    axes = [_axis(n, largest, problem.contributions, settings, workers) for n in range(3)]
    details = {axis.name: _details(axis, settings) for axis in axes}
    covariance = np.diag([axis.std**2 for axis in axes])
    statistics: dict[str, Any] = {"points": len(problem.points), "contributors": len(problem.contributions)}
    if axes[0].mc is not None:
        statistics |= {"trials": axes[0].mc.trials, "seed": settings.monte_carlo.seed}
    return Result(
        kind=KIND.name,
        title="",
        estimates=tuple(Estimate(axis.name, 0.0, axis.std, "mm") for axis in axes),
        covariance=covariance,
        statistics=statistics,
        tables=_tables(problem, largest, axes, settings),
        warnings=(*problem.warnings, *_warnings(details)),
        notes=(*_notes(problem, largest, axes, details), *problem.notes),
        details=details,
        plain=PLAIN,
    )


def _sum(parts: tuple[Contribution, ...], axis: int) -> tuple[Inputs, Expression]:
    """Return the contributors' maxima along one axis as quantities, one for each source, and the model of their sum."""
    quantities = []
    for n, group in enumerate(by_source(parts)):
        std = sum(float(part.std[:, axis].max()) for part in group)
        shape = Uniform(std * math.sqrt(3)) if all(part.uniform for part in group) else Normal(std)
        quantities.append(InputQuantity(f"c{n}", 0.0, shape if std > 0 else None, min(part.dof for part in group)))
    return join(quantities), parse(" + ".join(quantity.name for quantity in quantities))


def _axis(axis: int, largest: Extremes, parts: tuple[Contribution, ...], settings: Entries, workers: Workers) -> _Axis:
    inputs, total = _sum(parts, axis)
    coverage = coverage_of(settings)
    dof, _ = effective_dof(inputs, np.ones(len(inputs.quantities)))
    mc = None
    if settings.monte_carlo.trials != 0:
        wanted = settings.monte_carlo
        plan = plan_of({"sum": total}, inputs, wanted.seed, covered(coverage, dof), wanted.trials)
        mc = monte_carlo.run(plan, workers, wanted.digits, wanted.most)
    pointwise, place = float(largest.pointwise[axis]), largest.places[axis]
    k = coverage_factor(coverage, dof)
    return _Axis(AXES[axis], float(largest.by_contributor[axis]), pointwise, place, k, dof, mc)


def coverage_of(settings: Entries) -> Coverage:
    """Return the coverage of U."""
    return Coverage(settings.coverage.probability or 0.95, settings.coverage.k)


def _details(axis: _Axis, settings: Entries) -> dict[str, Any]:
    coverage = coverage_of(settings)
    U, probability = axis.k * axis.std, covered(coverage, axis.dof)
    printed: dict[str, Any] = {
        "U": U, "U_pointwise": axis.k * axis.pointwise, "std_pointwise": axis.pointwise, "at": axis.place.tolist(),
        "k": axis.k, "dof": axis.dof, "probability": probability, "interval": [-U, U],
        "second_order": {"value": 0.0, "std": axis.std}, "gum_valid": math.nan,
    }  # fmt: skip
    if axis.mc is not None:
        printed |= _against_trials(axis, axis.mc, U, settings)
    if settings.tolerance is not None:
        width = settings.tolerance.value.value
        printed["tolerance"] = {
            "T": width, "U_over_T": U / width, "capable": capable(U, width),
            "U_over_T_pointwise": axis.k * axis.pointwise / width,
            "acceptance": _left(width, U), "acceptance_2017": _left(width, FACTOR_2017 * axis.std),
        }  # fmt: skip
    return printed


def _left(width: float, guard: float) -> float:
    """Return the half-width of the acceptance zone, or NaN if it is empty."""
    return width / 2 - guard if guard <= width / 2 else math.nan


def _against_trials(axis: _Axis, mc: monte_carlo.MonteCarloResult, U: float, settings: Entries) -> dict[str, Any]:
    """Return the Monte Carlo result for the sum of the maxima, and whether it validates k u."""
    probability = covered(coverage_of(settings), axis.dof)
    sample, std = mc.samples[0], math.sqrt(mc.covariance[0, 0])
    interval = sample.symmetric(probability)
    half = (interval[1] - interval[0]) / 2
    normal = coverage_factor(Coverage(probability), math.inf)
    wider = math.inf if math.isfinite(axis.dof) else axis.std  # the sum is linear
    known = known_ends(sample, probability, mc.trials)
    judged = Judged(0.0, axis.std, U, 0.0, axis.std, float(mc.means[0]), std, interval, known, mc.trials, normal, wider)
    verdict = judge(judged, settings.monte_carlo.digits)
    covers = sample.below(U) - sample.below(-U)
    trials = {"mean": float(mc.means[0]), "std": std, "interval": list(interval), "trials": mc.trials}
    trials |= {"shortest": list(sample.shortest(probability)), "k_trials": half / std if std else math.nan}
    return {"mc": trials | {"covered": covers}, "gum_valid": math.nan if verdict.valid is None else verdict.valid}


def _tables(problem: VolumeProblem, largest: Extremes, axes: list[_Axis], settings: Entries) -> dict[str, Table]:
    parts = problem.contributions
    rows = []
    for n, axis in enumerate(axes):
        share = 100 * largest.largest[:, n] ** 2 / axis.std**2 if axis.std > 0 else np.zeros(len(parts))
        for part, std, percent in zip(parts, largest.largest[:, n], share, strict=True):
            shape = "uniform" if part.uniform else "normal"
            rows.append((axis.name, part.name, 0.0, std, shape, part.source, 1.0, std, percent, part.dof))
    names = (
        "measurand",
        "contributor",
        "value",
        "std",
        "distribution",
        "source",
        "sensitivity",
        "contribution",
        "share",
    )
    units = dict.fromkeys(("value", "std", "contribution"), " [mm]") | {"share": " [percent]"}
    maxima = {
        "axis": [axis.name for axis in axes],
        "u [mm]": [axis.std for axis in axes],
        "U [mm]": [axis.k * axis.std for axis in axes],
        "u_pointwise [mm]": [axis.pointwise for axis in axes],
        "U_pointwise [mm]": [axis.k * axis.pointwise for axis in axes],
        "x y z [mm]": [axis.place for axis in axes],
    }
    return {
        "sources": _sources(settings),
        "budget": Table.of_rows([name + units.get(name, "") for name in (*names, "dof")], rows),
        "map": Table.of({"x y z [mm]": problem.points, "u_x u_y u_z [mm]": largest.each}),
        "maxima": Table.of(maxima),
    }


def _sources(settings: Entries) -> Table:
    """Return the sources that each contributor contains, so that a job that uses this result can detect duplicates."""
    given = [placed.value for placed in settings.contributors]
    rows = [(label, item.name) for item in given for label in (item.name, item.source, *item.includes) if label]
    return Table.of_rows(("source", "contributor"), rows)


def _warnings(details: Mapping[str, Mapping[str, Any]]) -> list[str]:
    printed = []
    for name, detail in details.items():
        mc = detail.get("mc")
        if mc is not None and not detail["gum_valid"]:
            printed.append(
                f"{name}: by Monte Carlo, k = {detail['k']:.3g} covers {100 * mc['covered']:.2f} % of the distribution "
                f"of the sum; k = {mc['k_trials']:.2f} covers {100 * detail['probability']:.4g} %"
            )
    return printed


def _notes(
    problem: VolumeProblem, largest: Extremes, axes: list[_Axis], details: Mapping[str, Mapping[str, Any]]
) -> list[str]:
    rows = [["largest u in the volume", *(f"{axis.name} [um]" for axis in axes)]]
    rows += [[part.name, *map(_spread, std)] for part, std in zip(problem.contributions, largest.largest, strict=True)]
    ks = sorted({f"{axis.k:.3g}" for axis in axes})
    rows.append(
        [f"U (k = {', '.join(ks)}), contributor by contributor", *(_spread(axis.k * axis.std) for axis in axes)]
    )
    rows.append(["U, point by point", *(_spread(axis.k * axis.pointwise) for axis in axes)])
    if details["x"].get("mc"):
        halves = [(mc["interval"][1] - mc["interval"][0]) / 2 for mc in (details[axis.name]["mc"] for axis in axes)]
        rows.append([f"Monte Carlo, {100 * details['x']['probability']:.4g} % half-width", *map(_spread, halves)])
    if "tolerance" in details["x"]:
        held = [details[axis.name]["tolerance"] for axis in axes]
        width = held[0]["T"]
        rows.append([f"U/T, T = {width:g} mm", *(f"{100 * item['U_over_T']:.1f} %" for item in held)])
        rows.append(["Berndt, 20 %", *("capable" if item["capable"] else "not capable" for item in held)])
        rows.append(["accept within ± (ISO 14253-1, U)", *(_um(item["acceptance"]) for item in held)])
        rows.append(["accept within ± (1.65 u)", *(_um(item["acceptance_2017"]) for item in held)])
    return aligned(rows, left=(0,))


def _spread(length: float) -> str:
    """Return an uncertainty in um with two digits (GUM 7.2.6)."""
    return two_digits(converted(length, "mm", "um"))


def _um(length: float) -> str:
    return f"{converted(length, 'mm', 'um'):.1f}" if math.isfinite(length) else "none"
