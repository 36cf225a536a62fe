"""The result of a multilateration: points with their covariance, tracers, reliability, and corrected probing points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from metrocli.adjust.model.observations import TIME
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array
from metrocli.effects.estimates import estimates, free_blocks
from metrocli.effects.estimates import tables as effect_results
from metrocli.instruments import tracer as t
from metrocli.result import SCALE, Estimate, Result, ShownTable
from metrocli.table import Table
from metrocli.tasks.multilaterate import KIND, layout_faults
from metrocli.tasks.multilaterate.blunders import Reason
from metrocli.tasks.multilaterate.correction import Probing, corrected, distant, list_offset, wrong_entries
from metrocli.tasks.multilaterate.solve import AdjustedTracers
from metrocli.tasks.multilaterate.uncontrolled import noise_of_tests, scale_warnings, uncontrolled
from metrocli.tasks.shared.environment import blocks_of, estimates_of
from metrocli.tasks.shared.features.report import FEATURES, SHOWN, exchanging, fitted
from metrocli.tasks.shared.features.requested import RequestedFeature
from metrocli.tasks.shared.joint_covariance import factors
from metrocli.tasks.shared.lists import name_of, unless_without_noise
from metrocli.tasks.shared.noise import JobNoise
from metrocli.tasks.shared.part import Part
from metrocli.tasks.shared.statistics import (
    REMOVE,
    REPEATS,
    Statistics,
    basic_statistics,
    columns_with_std,
    condition_columns,
    estimates_of_block,
    job_noise_notes,
    left_out,
    noise_notes,
    noise_warnings,
    reliability,
    with_job_noise,
)
from metrocli.tasks.shared.uncontrolled import in_words
from metrocli.uncertainty.predicted import COMMON, CORE
from metrocli.words import counted, listed

_UNITS = ("mm", "mm", "mm", "mm", "")
_INDEPENDENT = (
    "the covariance between so many points is left out: features take their points as independent, and their stated "
    "uncertainty may be too small; give features a job of their own points"
)
_ELSEWHERE = 0.5
"""Warn if a tracer is farther from its listed place than this share of its distance from the points"""


def report(
    solved: AdjustedTracers,
    noise: JobNoise,
    probing: Probing | None,
    features: Sequence[RequestedFeature],
    part: Part | None = None,
) -> Result:
    """Return the result of a solved network.

    Raises InputError if a probing point cannot be corrected, UndeterminedError if points do not determine a feature.
    With a part the points are at 20 degC: the corrected ones, or without them those of the network.
    """
    solution, added = noise.solution, solved.network.effects
    delivered = (*_tracer_estimates(solution), *estimates_of(solution), *estimates(added, solution))
    hidden = uncontrolled(solved.network, part, solved.second)
    tables, arrays = _adjusted(solved, solution, None if probing is not None else part)
    tables["not_controlled"] = hidden
    if probing is not None:
        tables["corrected"], joint = corrected(solved.network, solution, probing, arrays, part)
        arrays["corrected_covariance"] = joint.of_points()
        feature_tables, feature_arrays, _ = fitted(features, tables["corrected"], joint)
        tables, arrays = tables | feature_tables, arrays | feature_arrays
    return Result(
        kind=KIND.name,
        title="",
        estimates=delivered,
        covariance=solution.joint((t.TRACER, *blocks_of(solution), *free_blocks(added))),
        statistics=with_job_noise(_statistics(solved, solution), noise) | ({} if part is None else part.facts),
        tables=tables,
        arrays=arrays,
        warnings=(
            *_warnings(solved),
            *distant(solved.network, probing),
            *([_INDEPENDENT] if features and COMMON not in arrays else []),
        ),
        shown=(*_shown(solved), *(ShownTable(FEATURES, SHOWN) for _ in features[:1])),
        notes=(
            *(() if solved.network.air is None else (solved.network.air.note,)),
            *(() if part is None else (part.note,)),
            *solved.network.noise.notes,
            *job_noise_notes(noise),
            *noise_notes(solution, cures=(REMOVE,)),
            *exchanging(tables),
            *in_words(hidden),
        ),
        details=noise.details([estimate.name for estimate in delivered]),
        doubts=wrong_entries(solved.network, solved.solution),
        list_offset=max(solved.list_offset, list_offset(solved.network, probing)),
    )


def _adjusted(
    solved: AdjustedTracers, solution: Solution, part: Part | None
) -> tuple[dict[str, Table], dict[str, Array]]:
    """Return the tables and arrays of the adjusted network and of its effects; the points are those of a part."""
    points, arrays = _points(solved, solution, part)
    effect_tables, effect_arrays = effect_results(solved.network.effects, solution)
    tables = {
        "points": points,
        "residuals": _residuals(solved),
        "tracers": _tracers(solution),
        "suspects": _suspects(solved),
        "rejected": _rejected(solved),
    }
    return tables | effect_tables, arrays | effect_arrays


def _statistics(solved: AdjustedTracers, solution: Solution) -> Statistics:
    rms = float(np.sqrt((solved.residuals.values**2).mean()))
    return basic_statistics(solution, {"mm": rms}) | {
        "rejected": len(solved.rejected),
        "critical_w": solved.critical,
        "weakness": layout_faults.weakness(solved.network, solution),
        **solved.network.noise.facts,
    }


def _shown(solved: AdjustedTracers) -> Iterator[ShownTable]:
    if solved.network.blocks[t.POINT].free.any():
        yield ShownTable("points", ("point", "x", "y", "z", "sx", "sy", "sz"))
    if solved.suspects:
        yield ShownTable("suspects")


def _tracer_estimates(solution: Solution) -> tuple[Estimate, ...]:
    units = (("mm",), ("mm",), ("mm",), ("mm",), ("1", SCALE))
    block = solution.blocks[t.TRACER]
    return estimates_of_block(block, solution.std(t.TRACER), units, lambda tracer, name: f"{tracer}.{name}")


def _points(solved: AdjustedTracers, solution: Solution, part: Part | None) -> tuple[Table, dict[str, Array]]:
    """Return /points, with the mover's error at each point (its reading minus the point), and their covariances.

    With a part the points are at 20 degC; the mover's error is that at the measurement.
    """
    network = solved.network
    block, seen = solution.blocks[t.POINT], network.seen > 0
    each = solution.covariance_or_raise().members(t.POINT)[seen]
    places, pairs = block.values[seen], factors(solution.covariance_or_raise(), t.POINT, seen)
    error = network.nominal[seen] - places
    if part is not None:
        places, each = part.of_points(places, each)
        if pairs:
            pairs[COMMON], pairs[CORE] = part.of_factors(places, pairs[COMMON], pairs[CORE])
    std = np.sqrt(np.maximum(np.einsum("mii->mi", each), 0.0))
    columns = {"point": np.array(block.members)[seen], "x y z [mm]": places, "sx sy sz [mm]": std}
    table = Table.of(columns | {"error_x error_y error_z [mm]": error})
    return table, {"points_covariance": each, **pairs}


def _tracers(solution: Solution) -> Table:
    block = solution.blocks[t.TRACER]
    return Table.of({"tracer": block.members, **columns_with_std(block, solution.std(t.TRACER), _UNITS)})


def _residuals(solved: AdjustedTracers) -> Table:
    """Return /residuals, with minimal detectable error and external reliability of each length."""
    observations, residuals = solved.group.observations, solved.residuals
    blocks = {"point": t.POINT, "tracer": t.TRACER}  # whose names become a column faster than those of the readings
    keys = {
        name: np.array(solved.solution.blocks[blocks[name]].members)[observations.index[blocks[name]]]
        if name in blocks
        else np.array(values)
        for name, values in observations.keys.items()
    }
    numbers = {
        "reading [mm]": observations.readings[0],
        "residual [mm]": residuals.values[0],
        "sigma [mm]": residuals.sigma[0],
        "normalised": residuals.normalised[0],
    }
    noise = noise_of_tests(solved.solution)
    more = reliability(solved.solution, solved.group, residuals, solved.critical, noise)
    return Table.of({**keys, **numbers, **more, **condition_columns(observations)})


def _rejected(solved: AdjustedTracers) -> Table:
    observations = solved.whole.lengths.observations
    chosen = sorted(solved.rejected, key=lambda rejected: rejected.row)
    rows = [rejected.row for rejected in chosen]
    keys = {f"{key} [text]": [values[row] for row in rows] for key, values in observations.keys.items()}
    tests = {
        "w": [rejected.test for rejected in chosen],
        "reason [text]": [str(rejected.reason) for rejected in chosen],
    }
    return Table.of({**keys, "reading [mm]": observations.readings[0, rows], **tests})


def _suspects(solved: AdjustedTracers) -> Table:
    suspects, keys = solved.suspects, solved.whole.lengths.observations.keys
    times = [keys[TIME][suspect.rows[0]] if suspect.tracer else "" for suspect in suspects] if TIME in keys else []
    return Table.of(
        {
            "point [text]": [suspect.point for suspect in suspects],
            "tracer [text]": [suspect.tracer or "ambiguous" for suspect in suspects],
            **({TIME: times} if times else {}),
            "or [text]": [" ".join(suspect.others) for suspect in suspects],
            "w": [suspect.test for suspect in suspects],
        }
    )


def _or(others: Sequence[str]) -> str:
    return f", or {' or '.join(others)}" if others else ""


def _warnings(solved: AdjustedTracers) -> list[str]:
    cures = (REMOVE,) if solved.network.noise.repeatability else (REMOVE, REPEATS)
    stuck = unless_without_noise(solved.network.stuck, solved.solution.sigma0)
    lines = [*solved.network.warnings, *stuck, *noise_warnings(solved.solution, cures, len(solved.rejected))]
    keys = solved.whole.lengths.observations.keys
    wrong = [
        f"{keys['point'][rejected.row]}/{name_of(keys, 'tracer', rejected.row)}"
        for rejected in solved.rejected
        if rejected.reason in (Reason.GROSS, Reason.OUTLIER)
    ]
    lines += left_out(wrong, "length")
    suspected = [
        f"{suspect.point}/{name_of(keys, 'tracer', suspect.rows[0])} (w = {suspect.test:.1f}{_or(suspect.others)})"
        for suspect in solved.suspects
        if suspect.tracer
    ]
    ambiguous = [suspect for suspect in solved.suspects if not suspect.tracer]
    points = [f"{suspect.point} (w = {suspect.test:.1f}: {' or '.join(suspect.others)})" for suspect in ambiguous]
    bound = f"the outlier bound |w| = {solved.critical:.2f}"
    if solved.solution.sigma0 > 1:
        bound += " (w divided by sigma0, the largest by sigma0 without that length)"
    if suspected:
        lines.append(
            f"{counted(len(suspected), 'length', 'exceed')} {bound}: {listed(suspected, 5)}; "
            "left out by `outliers: remove`"
        )
    if points:
        lines.append(
            f"points with a wrong length beyond {bound}: {listed(points, 5)}; it cannot be identified, "
            "since the tests w of the point are equal (always so with four lengths); one more tracer would identify it"
        )
    gone = _lost(solved)
    if gone:
        lines.append(f"{counted(len(gone), 'point', 'are')} left out, since too few lengths remain: {listed(gone)}")
    lines += _elsewhere(solved)
    lines += scale_warnings(solved.network, solved.solution)
    return lines + layout_faults.warnings(solved.network, solved.solution)


def _elsewhere(solved: AdjustedTracers) -> Iterator[str]:
    """Yield a warning of tracers far from their listed places: lengths fit a layout and its mirror image alike."""
    tracers, network = solved.solution.blocks[t.TRACER], solved.network
    if not len(network.listed_at):
        return
    gap = np.linalg.norm(tracers.values[:, :3] - network.listed_at, axis=1)
    away = np.linalg.norm(tracers.values[:, :3] - network.nominal[network.seen > 0].mean(axis=0), axis=1)
    far = np.flatnonzero(gap > _ELSEWHERE * away)
    if far.size:
        places = listed([f"{tracers.members[i]} ({gap[i]:.0f} mm)" for i in far])
        axes = "are axes and signs of both lists the same? If those of the points are wrong, so is the result"
        # axes and signs would move nearly all tracers
        why = axes if 2 * far.size > len(gap) else "the others are near theirs, so correct these places"
        crossed = np.linalg.norm(tracers.values[far, :3] - network.listed_at[far[::-1]], axis=1)
        if far.size == 2 and (crossed < _ELSEWHERE * away[far]).all():
            why = "each stands at the listed place of the other: give each its own name in one of the files"
        yield f"tracers are far from their listed places: {places}; {why}"


def _lost(solved: AdjustedTracers) -> list[str]:
    """Return the points all of whose lengths are left out."""
    names = solved.network.blocks[t.POINT].members
    return [names[i] for i in np.flatnonzero((solved.network.seen == 0) & (solved.whole.seen > 0))]
