"""Check of the uncertainties of a fit: fits to points with simulated errors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from metrocli.errors import NotConvergedError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.result import Scalar
from metrocli.table import Table
from metrocli.tasks.fit_part.contradiction import feasible
from metrocli.tasks.fit_part.draws import drawing
from metrocli.tasks.fit_part.fit import MOST, most_of_many
from metrocli.tasks.fit_part.solve import FittedPart, fitted_part
from metrocli.tasks.fit_part.uncertainty import pose_by_step

_ALIKE, _BY_CHANCE = 0.2, 3.0
"""Relative difference of a standard uncertainty from that of the simulated fits from which a note warns

It is more where few fits leave more to chance: a standard deviation of n values is known to `1/sqrt(2(n - 1))`.
"""


@dataclass(frozen=True)
class Check:
    """Standard uncertainties of the pose, as computed and as simulated."""

    table: Table
    statistics: Mapping[str, Scalar]
    notes: tuple[str, ...]


def checked(solved: FittedPart, minimum: float, trials: int, seed: int) -> Check:
    """Fit the part to points with simulated errors, `trials` times, and compare how far the poses are off."""
    rng = np.random.default_rng(seed)
    draw = drawing(solved.prepared.readings.surface_points.of(solved.used).places)
    rows = []
    for _ in range(trials):
        stock = replace(solved.stock, measured=solved.stock.measured + draw(rng))
        highest = (solved.fit.to_part, np.inf, solved.fit.duals)
        if solved.aim.name == MOST:
            highest = most_of_many(stock, solved.fit.to_part)
            if not feasible(highest[1], minimum):
                continue
        try:
            _, fitted = fitted_part(stock, solved.aim.name, minimum, highest, solved.prepared.start)
        except NotConvergedError:
            continue
        rows.append(poses.difference(poses.inverse(fitted.to_part), poses.inverse(solved.fit.to_part)))
    by_angle = poses.euler_form_by_step(poses.inverse(solved.fit.to_part))
    steps = np.array(rows).reshape(-1, 6) @ by_angle.T
    change = pose_by_step(solved.fit)
    computed = np.sqrt(np.diag(change @ solved.sensitivity.covariance @ change.T))
    # about the fitted pose, as the stated uncertainties are: exchanges of the points that hold it also shift the mean
    simulated = np.sqrt((steps**2).mean(axis=0)) if len(steps) else np.full(6, np.nan)
    # a part that stays where it was has neither
    ratio = np.where((computed == 0) & (simulated == 0), 1.0, simulated / np.maximum(computed, 1e-300))
    table = Table(
        {
            "parameter": np.array(poses.EULER),
            "value": computed,
            "simulated": simulated,
            "ratio": ratio,
            "unit": np.array(["mm"] * 3 + ["rad"] * 3),
        }
    )
    by_chance = _BY_CHANCE / np.sqrt(2 * max(len(steps) - 1, 1))
    agree = bool((np.abs(ratio - 1) < max(_ALIKE, by_chance)).all())
    verdict = "agree with" if agree else "differ from"
    note = (
        f"Monte Carlo: {len(steps)} of {trials} fits to points with simulated errors; their scatter is "
        f"{ratio.min():.2f} to {ratio.max():.2f} of the standard uncertainties, which {verdict} it"
    )
    if not agree:
        note += ": other points hold the fit in part of them, so use the simulated values (table monte_carlo)"
    statistics: dict[str, Scalar] = {"monte_carlo_trials": len(steps), "monte_carlo_failed": trials - len(steps)}
    return Check(table, statistics, (note,))
