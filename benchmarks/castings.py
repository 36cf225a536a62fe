"""Random castings laid out by fit-part: coverage of the pose, optimality, infeasible castings; and a large mesh.

The truth of a pose is the fit to the points without errors. The dense solver is SLSQP with all points and the largest
least overstock as a seventh unknown.

    python -m benchmarks.castings [RUNS] [AIM]
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from simulated.castings import Casting, casting, nominal

from metrocli.errors import UndeterminedError
from metrocli.geometry import poses
from metrocli.project import yaml_text
from metrocli.settings import Section
from metrocli.tasks.fit_part.contradiction import contradiction, feasible
from metrocli.tasks.fit_part.fit import most
from metrocli.tasks.fit_part.ideal import ideal
from metrocli.tasks.fit_part.nominals import OfMesh, OfSurfaces
from metrocli.tasks.fit_part.settings import NominalFile
from metrocli.tasks.fit_part.solve import fitted_part
from metrocli.tasks.fit_part.stock import Stock
from metrocli.tasks.fit_part.uncertainty import of_result, sensitivity

Array = npt.NDArray[np.float64]
MINIMUM, BOUND = 0.5, 12.5916
"""Minimum overstock [mm]; 95 % bound of chi-square with 6 degrees of freedom"""
SCALE = np.array([1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3])


def part() -> OfSurfaces | OfMesh:
    """Return the ideal part of all castings."""
    with TemporaryDirectory() as folder:
        return ideal(Section(NominalFile).read(yaml_text.parse(nominal(), "part.yaml", Path(folder), []), []))


def dense(one: Casting, enough: float | None = None) -> float:
    """Return the largest least overstock by SLSQP, restarted once, or `enough` where it reaches that."""
    start, x = one.pose, np.append(np.zeros(6), one.overstock_at(one.pose).min())
    for _ in range(2):
        x = minimize(
            lambda p: -p[6],
            x,
            method="SLSQP",
            bounds=[(None, None)] * 6 + [(None, enough)],
            constraints={"type": "ineq", "fun": lambda p: one.overstock_at(start + p[:6] * SCALE) - p[6]},
            options={"ftol": 1e-15, "maxiter": 500},
        ).x
    return float(one.overstock_at(start + x[:6] * SCALE).min())


def main(runs: int, aim: str) -> None:
    """Print coverage, optimality and refusals of many castings."""
    nominal_part = part()
    inside, within, short, refused, wrong = [], [], [], 0, 0
    began = time.process_time()
    for seed in range(runs):
        rng = np.random.default_rng(10_000 + seed)
        less = {"left": -rng.uniform(3, 7), "right": -rng.uniform(3, 7)} if seed % 4 == 0 else None
        one = casting(seed, less=less)
        surface = np.array([nominal_part.names.index(name) for name in one.surface])
        near = poses.inverse(poses.pose_from_euler(one.pose[:3], one.pose[3:]))
        stock = Stock(nominal_part, one.points, surface)
        highest = most(stock, near)
        short.append(highest[1] - dense(one))
        if not feasible(highest[1], MINIMUM):
            refused += 1
            found = contradiction(stock, highest[2], MINIMUM, highest[0])
            for name in found.surfaces:
                rest = np.isin(one.surface, [other for other in found.surfaces if other != name])
                if rest.any():
                    alone = Casting(one.pose, one.surface[rest], one.points[rest], one.exact[rest], one.targets, 0.0)
                    wrong += dense(alone, MINIMUM) < MINIMUM - 1e-6
            continue
        try:
            chosen, fit = fitted_part(stock, aim, MINIMUM, highest, np.zeros(6))
            exact = Stock(nominal_part, one.exact, surface)
            _, true = fitted_part(exact, aim, MINIMUM, most(exact, highest[0]), np.zeros(6))
        except UndeterminedError:
            continue
        covariance = np.broadcast_to(np.eye(3) * one.sigma**2, (len(surface), 3, 3))
        change = of_result(fit)
        stated = change @ sensitivity(fit, chosen, np.zeros(6), covariance).covariance @ change.T
        off = poses.euler_form(poses.inverse(fit.into)) - poses.euler_form(poses.inverse(true.into))
        inside.append(np.abs(off) < 1.96 * np.sqrt(np.diag(stated)))
        size = np.sqrt(np.diag(stated))
        within.append(float((off / size) @ np.linalg.solve(stated / np.outer(size, size), off / size)) < BOUND)
    share = np.mean(inside, axis=0) * 100
    print(f"{runs} castings, aim {aim}: {len(inside)} fitted, {refused} refused as infeasible, ", end="")
    print(f"{time.process_time() - began:.0f} s CPU with the dense solver")
    print(
        "coverage of value +- 1.96 std [%]: "
        + ", ".join(f"{n} {v:.1f}" for n, v in zip(poses.EULER, share, strict=True))
    )
    print(f"coverage of all six together [%]: {100 * np.mean(within):.1f}; of the single ones {share.mean():.1f}")
    print(f"largest least overstock minus that of the dense solver [mm]: {min(short):.1e} ... {max(short):.1e}")
    print(f"surfaces of a contradiction without which the others still contradict: {wrong}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200, sys.argv[2] if len(sys.argv) > 2 else "even")
