"""Random castings laid out by fit-part: coverage of the pose, optimality, castings without enough material.

Every fifth casting lacks material between two opposite surfaces. The truth of a pose is the fit to the points without
errors. The dense solver shares nothing with the project: SLSQP from several starts with all points, the largest least
overstock as a seventh unknown, and overstock by plain formulas.

    python -m benchmarks castings [RUNS or FIRST-LAST] [AIM] [held] [alone]

AIM is `even` unless given. `held` takes a minimum that points come to, 0.15 mm below the largest that is possible with
the exact points, instead of 0.5 mm. `alone` leaves the dense solver out, which takes most of the time.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from simulated.castings import Casting, casting, nominal, turn

from metrocli.errors import UndeterminedError
from metrocli.geometry.poses import EULER
from metrocli.project import yaml_text
from metrocli.settings import Section
from metrocli.table import Table
from metrocli.tasks.fit_part.fit import EVEN, LEAST_MOTION, MOST
from metrocli.tasks.fit_part.report import report
from metrocli.tasks.fit_part.settings import Inputs, NominalFile, Overstock, Settings
from metrocli.tasks.fit_part.solve import FittedPart, prepare, solve

Array = npt.NDArray[np.float64]
MINIMUM, BOUND = 0.5, 12.5916
"""Minimum overstock [mm]; 95 % bound of chi-square with 6 degrees of freedom"""
BELOW = 0.15
"""Distance of the minimum from the largest possible one, for `held` [mm]"""
SCALE = np.array([1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3])
STARTS = 3
SHOWN = 20
"""Castings between two lines of progress"""
SHORT = (("left", "right"), ("front", "back"), ("bottom", "top"))


def ideal_part() -> NominalFile:
    """Return the ideal part of all castings."""
    with TemporaryDirectory() as folder:
        return Section(NominalFile).read(yaml_text.parse(nominal(), "part.yaml", Path(folder), []), [])


def dense(one: Casting, seed: int, enough: float | None = None) -> float:
    """Return the largest least overstock by SLSQP from several starts, or `enough` where it reaches that."""
    rng = np.random.default_rng(seed)
    best = -np.inf
    for _ in range(STARTS):
        begin = one.pose + rng.normal(size=6) * 3 * SCALE
        x = np.append(np.zeros(6), one.overstock_at(begin).min())

        def room(p: Array, begin: Array = begin) -> Array:
            return one.overstock_at(begin + p[:6] * SCALE) - p[6]

        for _ in range(2):
            x = minimize(
                lambda p: -p[6],
                x,
                method="SLSQP",
                bounds=[(None, None)] * 6 + [(None, enough)],
                constraints={"type": "ineq", "fun": room},
                options={"ftol": 1e-15, "maxiter": 500},
            ).x
        best = max(best, float(one.overstock_at(begin + x[:6] * SCALE).min()))
    return best


def worse_than_dense(one: Casting, aim: str, pose: Array, least: float) -> float:
    """Return by how much what the aim makes small is larger at a pose than at the optimum of SLSQP [mm]."""

    def value(at: Array) -> float:
        if aim == LEAST_MOTION:
            moves = (one.points - at[:3]) @ turn(at[3:]) - one.points
            return float(np.sqrt((moves**2).sum(axis=1).mean()))
        return float(one.overstock_at(at).std())

    found = minimize(
        lambda p: value(pose + p * SCALE),
        np.random.default_rng(1).normal(size=6) * 0.5,
        method="SLSQP",
        constraints={"type": "ineq", "fun": lambda p: one.overstock_at(pose + p * SCALE) - least},
        options={"ftol": 1e-15, "maxiter": 500},
    )
    best = pose + found.x * SCALE
    return value(pose) - value(best) if one.overstock_at(best).min() >= least - 1e-7 else float("nan")


def solved(part: NominalFile, one: Casting, points: Array, aim: str, least: float = MINIMUM) -> FittedPart:
    """Return what a job of these points gives, start, chips and flash included."""
    table = Table(
        {
            "point": np.array([f"P{n}" for n in range(len(points))]),
            **{axis: points[:, k] for k, axis in enumerate("xyz")},
            "surface": one.surface,
            "sigma": np.full(len(points), one.sigma),
        }
    )
    settings = Settings(Inputs(points=Path("points.csv"), nominal=Path("part.yaml")), Overstock(least, aim))
    return solve(settings, prepare(settings, part, table))


def not_contradicting(one: Casting, message: str, seed: int, least: float) -> int:
    """Return how many of the surfaces that a refusal names can be left out, with the others as impossible as before.

    That the named ones contradict each other is counted as well where it is not so.
    """
    (line,) = [line for line in message.splitlines() if "contradict" in line]
    named = line.partition(": ")[2].replace(" and ", ", ").split(", ")
    wrong = int(dense(of_surfaces(one, named), seed, least) >= least - 1e-6)
    for name in named:
        others = [other for other in named if other != name]
        wrong += bool(others) and dense(of_surfaces(one, others), seed, least) < least - 1e-6
    return wrong


def of_surfaces(one: Casting, names: list[str]) -> Casting:
    """Return the points of some surfaces of a casting."""
    rows = np.isin(one.surface, names)
    return replace(one, surface=one.surface[rows], points=one.points[rows], exact=one.exact[rows])


def main(seeds: range, aim: str, held: bool, compared: bool) -> None:
    """Print coverage of many castings, and where they are compared with the dense solver, optimality and refusals."""
    part = ideal_part()
    inside, within, short, worse, refused, wrong, missed = [], [], [], [], 0, 0, 0
    ours = 0.0
    for done, seed in enumerate(seeds):
        if done and done % SHOWN == 0:
            print(
                f"{done} of {len(seeds)} castings, {len(inside)} fitted, {refused} refused", file=sys.stderr, flush=True
            )
        rng = np.random.default_rng(10_000 + seed)
        lacking = dict.fromkeys(SHORT[rng.integers(3)], -rng.uniform(4, 7)) if seed % 5 == 0 else {}
        one = casting(seed, less=lacking)
        possible = dense(one, seed) if compared else float("nan")
        least = MINIMUM
        if held and not lacking:
            least = solved(part, one, one.exact, aim).largest - BELOW
        began = time.process_time()
        try:
            got = solved(part, one, one.points, aim, least)
        except UndeterminedError as error:
            ours += time.process_time() - began
            refused += 1
            missed += possible >= least
            wrong += not_contradicting(one, str(error), seed, least) if compared else 0
            continue
        ours += time.process_time() - began
        missed += possible < least
        short.append(got.largest - possible)
        result = report(got)
        pose = np.array([estimate.value for estimate in result.estimates])
        true = np.array([estimate.value for estimate in report(solved(part, one, one.exact, aim, least)).estimates])
        if aim != MOST and compared:
            worse.append(worse_than_dense(one, aim, pose, least))
        size = np.array([estimate.std for estimate in result.estimates])
        off = (pose - true) / size
        inside.append(np.abs(off) < 1.96)
        within.append(float(off @ np.linalg.solve(result.covariance / np.outer(size, size), off)) < BOUND)
    share = np.mean(inside, axis=0) * 100
    print(f"{len(seeds)} castings, aim {aim}: {len(inside)} fitted, {refused} refused, ", end="")
    print(f"{1e3 * ours / len(seeds):.0f} ms CPU each")
    print("coverage of value +- 1.96 std [%]: ", end="")
    print(", ".join(f"{n} {v:.1f}" for n, v in zip(EULER, share, strict=True)), f"; mean {share.mean():.1f}", sep="")
    print(f"coverage of all six together [%]: {100 * np.mean(within):.1f}")
    if not compared:
        return
    print(f"castings that are fitted or refused wrongly: {missed}")
    print(f"largest least overstock minus that of the dense solver [mm]: {min(short):.1e} to {max(short):.1e}")
    if worse:
        known = np.array(worse)[~np.isnan(worse)]
        print(f"what the aim makes small minus that of the dense solver [mm], {len(known)} castings: ", end="")
        print(f"{known.min():.1e} to {known.max():.1e}")
    print(f"surfaces named in refusals that do not belong there: {wrong}")


def seeds_of(words: list[str]) -> range:
    """Return the seeds of `RUNS` or `FIRST-LAST` in the words of the command line, 200 unless given."""
    first, _, last = next((word for word in words if word[0].isdigit()), "200").partition("-")
    return range(int(first), int(last) + 1) if last else range(int(first))


if __name__ == "__main__":
    given = sys.argv[1:]
    aims = [word for word in given if word in (EVEN, MOST, LEAST_MOTION)]
    main(seeds_of(given), aims[0] if aims else EVEN, "held" in given, "alone" not in given)
