"""What every adjustment reports: statistics, residuals, their reliability, and whether they agree with the noise."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.probabilities import chi_square_bound
from metrocli.adjust.robust import minimal_detectable
from metrocli.adjust.solution import Residuals, Solution, place_in_tiles
from metrocli.arrays import Array
from metrocli.instruments import tracer as t
from metrocli.result import Estimate, Scalar
from metrocli.table import Table
from metrocli.tasks.shared.noise import DECLARED, JobNoise, Structured
from metrocli.words import listed

_ABSURD = 10.0
"""A larger sigma0 means a wrong model or gross errors, not noise"""

ESTIMATED, REMOVE = "`noise: estimated`", "`outliers: remove`"
"""Settings that a warning recommends, if the job has them"""
REPEATS = "`noise: {repeatability: estimated}`"
"""A setting that a warning recommends where the carrier returns to its places for each station"""
_BEYOND = 1e6
"""Tests from here on differ by chance: readings that are far off, or that nothing predicts"""
_NAMED = 5
"""Outliers that a warning names, at most"""

_OF_A_UNIT = 1e-4, 0.05
"""sigma0 of readings in another unit: above that of simulated ones without noise, and below any real one"""
CONDITIONS = {"t": "s", "temp": "degC", "pressure": "hPa", "humidity": "percent"}
"""Conditions of readings that files have, with their units"""

Statistics = dict[str, Scalar | Mapping[str, float]]


def basic_statistics(solution: Solution, rms: Mapping[str, float]) -> Statistics:
    """Return the statistics that every adjustment has.

    `rms` is the RMS of the residuals for each unit; a reading of several components counts once.
    """
    return {
        "observations": solution.observations,
        "unknowns": solution.unknowns,
        "conditions": solution.conditions,
        "dof": solution.dof,
        "sigma0": solution.sigma0,
        "chi2": solution.cost,
        "p_value": solution.p_value,
        "iterations": solution.iterations,
        "rms": dict(rms),
        "outcome": solution.outcome.value,
    }


def with_noise(
    statistics: Statistics, solution: Solution, weighed_noise: Mapping[str, float], structured: Structured | None = None
) -> Statistics:
    """Return the statistics of a job whose noise is estimated from the residuals.

    `weighed_noise` is that noise by name. sigma0 then belongs to the unit weight, and the global test does not apply.
    """
    (size,) = weighed_noise.values()
    # with an estimated noise sigma0 is 1 by construction, so that its test and its interval mean nothing
    kept = {name: value for name, value in statistics.items() if name not in ("p_value", "sigma0_low", "sigma0_high")}
    noise: Statistics = {"noise_estimated": True, **weighed_noise, "sigma0": size, "chi2": solution.dof * size**2}
    return {**kept, **noise, **(structured.statistics if structured is not None else {})}


def with_job_noise(statistics: Statistics, noise: JobNoise) -> Statistics:
    """Return the statistics of a job, with the factor on its declared noise where the residuals give that."""
    if noise.model == DECLARED:
        return statistics
    return with_noise(statistics, noise.solution, {"noise_factor": noise.factor}, noise.structured)


def job_noise_notes(noise: JobNoise) -> tuple[str, ...]:
    """Return the notes on noise whose size the residuals give; none for declared noise."""
    if noise.model == DECLARED:
        return ()
    lines = (f"estimated noise: {noise.factor:.3g} times the declared one; covariances are scaled by it",)
    return (*lines, noise.structured.note) if noise.structured is not None else lines


def residual_table(residuals: Residuals, group: Group) -> Table:
    """Return the table `residuals`: a row for each coordinate of each reading."""
    observations, unit = group.observations, group.observations.unit
    d, n = observations.readings.shape
    keys = {name: np.repeat(np.array(values, dtype=str), d) for name, values in observations.keys.items()}
    numbers = {
        f"reading [{unit}]": observations.readings,
        f"residual [{unit}]": residuals.values,
        f"sigma [{unit}]": residuals.sigma,
        "normalised": residuals.normalised,
        "redundancy": residuals.redundancy,
    }
    when = {heading: np.repeat(values, d) for heading, values in condition_columns(observations).items()}
    component = np.tile(np.array(observations.components, dtype=str), n)
    return Table.of(
        {**keys, "component": component, **{name: number.T.ravel() for name, number in numbers.items()}, **when}
    )


def heading(condition: str) -> str:
    """Return the heading of a condition in a table: its name and its unit; further columns have none."""
    return f"{condition} [{CONDITIONS.get(condition, '')}]"


def condition_columns(observations: Observations) -> dict[str, Array]:
    """Return time and temperature of each reading, (n,) each, under their headings as far as the data have them."""
    given = observations.conditions
    return {heading(name): given[name] for name in ("t", "temp") if name in given}


def columns_with_std(block: Block, std: Array, units: Sequence[str]) -> dict[str, Array]:
    """Return the columns of a block (members, size), each with its standard uncertainty `s_NAME`, by heading."""
    pairs = np.stack([block.values, std], axis=2)
    return {
        f"{name} s_{name} [{unit}]": pairs[:, i]
        for i, (name, unit) in enumerate(zip(block.columns, units, strict=True))
    }


def estimates_of_block(
    block: Block, std: Array, units: Sequence[tuple[str, ...]], named: Callable[[str, str], str]
) -> tuple[Estimate, ...]:
    """Return the free entries of a block, row by row; `named` gives their names by member and column.

    `units` has the unit of each column, and its dimension where reports may use another one.
    """
    return tuple(
        Estimate(named(block.members[i], block.columns[k]), float(block.values[i, k]), float(std[i, k]), *units[k])
        for i, k in np.argwhere(block.free).tolist()
    )


def chi_interval(solution: Solution) -> tuple[float, float]:
    """Return the interval that contains sigma0 with 95 % probability if model and noise are right.

    From the chi-square distribution of v'Pv; (nan, nan) without degrees of freedom.
    """
    if solution.dof <= 0:
        return float("nan"), float("nan")
    low, high = (chi_square_bound(solution.dof, tail) for tail in (0.975, 0.025))
    return float(np.sqrt(low / solution.dof)), float(np.sqrt(high / solution.dof))


def noise_warnings(solution: Solution, cures: Collection[str] = (ESTIMATED, REMOVE), removed: int = 0) -> list[str]:
    """Return a warning if sigma0 is above its 95 % interval, else an empty list.

    `cures` are the settings of the job that the warning may recommend, without the one that has `removed` readings.
    Whether the result may be used at all is decided in `metrocli/doubt.py`.
    """
    cures = [cure for cure in cures if cure != REMOVE or not removed]
    low, high = chi_interval(solution)
    if not np.isfinite(solution.sigma0) or solution.sigma0 <= high:
        return []
    if solution.sigma0 > _ABSURD:
        return [
            f"sigma0 = {solution.sigma0:.1f}: the model does not fit the readings; "
            f"check for gross errors{f' ({REMOVE})' if REMOVE in cures else ''}, wrong names or units, "
            f"or a declared noise that is far too small{_of_return(cures)}"
        ]
    return [_noise_sentence(solution, "larger", low, high, cures) + _of_return(cures)]


def noise_notes(solution: Solution, cures: Collection[str] = (ESTIMATED, REMOVE)) -> list[str]:
    """Return a note if sigma0 is below its 95 % interval: the readings scatter less than declared."""
    low, high = chi_interval(solution)
    if not solution.sigma0 < low:
        return []
    note = _noise_sentence(solution, "smaller", low, high, cures)
    least, largest = _OF_A_UNIT
    if least < solution.sigma0 < largest:
        times = f"{1 / solution.sigma0:.0f} times"
        note += f"; residuals that are {times} smaller point to a wrong unit of the readings or of the noise"
    return [note]


def _noise_sentence(solution: Solution, word: str, low: float, high: float, cures: Collection[str]) -> str:
    scaled = f" ({ESTIMATED} scales them)" if ESTIMATED in cures else ""
    return (
        f"sigma0 = {solution.sigma0:.3f} is outside {low:.3f} ... {high:.3f}: "
        f"the residuals are {word} than the declared noise; "
        f"standard uncertainties are for the declared noise{scaled}"
    )


def _of_return(cures: Collection[str]) -> str:
    """Return the end of a warning that recommends `REPEATS`, empty for a job without that setting."""
    if REPEATS not in cures:
        return ""
    return f"; where the carrier returns to its places for each station, {REPEATS} estimates its scatter"


def beyond_bound(names: Sequence[str], critical: float, cure: str = REMOVE) -> str:
    """Return the warning that names the readings beyond the outlier bound; `names` has the worst first.

    `cure` is the setting of the job that leaves them out, if it may be recommended.
    """
    count, them = ("1 reading exceeds", "it") if len(names) == 1 else (f"{len(names)} readings exceed", "them")
    named = f"{count} the outlier bound |w| = {critical:.2f}: {listed(names, _NAMED)}"
    return f"{named}; {cure} leaves {them} out" if cure else named


def left_out(names: Sequence[str], noun: str = "reading") -> list[str]:
    """Return a warning that names the readings left out as wrong, the worst first; an empty list without any."""
    count = f"1 {noun} is" if len(names) == 1 else f"{len(names)} {noun}s are"
    return [f"{count} left out as wrong: {listed(names)} (table rejected)"] if names else []


def with_tests(names: Iterable[str], tests: Iterable[float]) -> list[str]:
    """Return the names of readings with their |w|, the worst first."""
    worst = sorted(zip(tests, names, strict=True), reverse=True)
    return [f"{name} (w {f'= {test:.1f}' if test < _BEYOND else f'> {_BEYOND:g}'})" for test, name in worst]


def reliability(
    solution: Solution, group: Group, residuals: Residuals, critical: float, noise: float = 1.0
) -> dict[str, Array]:
    """Return redundancy, minimal detectable error and the shift of the point by that error, of each reading (n,).

    These are internal and external reliability after Baarda 1968, for the test with this critical value of |w| relative
    to `noise`, and 80 % power. The error of an uncontrolled reading is infinite.
    """
    least = minimal_detectable(residuals, critical, noise)[0]
    shift = point_shift(solution, group)
    moves = shift * np.where(np.isfinite(least), least, 0.0)
    return {
        "redundancy": residuals.redundancy[0],
        f"detectable [{group.observations.unit}]": least,
        "moves_point [mm]": np.where(np.isfinite(least) | (shift == 0), moves, np.inf),
    }


def point_shift(solution: Solution, group: Group) -> Array:
    """Return how far a point moves per unit error of one of its readings, |Q_x. J' / sigma^2|, (n,).

    A reading that uses two points is one of the first.
    """
    covariance = solution.covariance
    if covariance is None:
        raise RuntimeError(solution.outcome.value)
    index = np.atleast_2d(group.observations.index[t.POINT])[0]
    if not solution.blocks[t.POINT].free.any():
        return np.zeros(len(index))
    # where the points are eliminated in tiles of readings, their covariances with these are at hand
    place = place_in_tiles(solution, group)
    if place is not None and covariance.layout.eliminated == t.POINT:
        shape = group.observations.readings.shape
        moved = covariance.factor * covariance.eliminated.cross_covariance(place, shape)[:, 0]
        return np.asarray(np.linalg.norm(moved / group.observations.stds[0], axis=0))
    shift = np.zeros((3, len(index)))
    touches = group.linear(solution.blocks, covariance.layout.wanted).touches
    for touch in touches:
        pair = covariance.pairs(t.POINT, index, touch.block, touch.index)
        shift += np.einsum("abn,bn->an", pair, touch.jacobian[0])
    return np.asarray(np.linalg.norm(shift / group.observations.stds[0], axis=0))
