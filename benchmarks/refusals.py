"""Refusals of parts on a mesh: whether the surfaces that a whole job names contradict each other, and each is needed.

A block with a notch lacks 3 to 9 mm, and with `less` 2 to 5 mm, on two to four of its ten surfaces; its points go up to
the edges. Linear programmes on the planes that the points were made on judge each set. They know nothing of the mesh.

    python -m benchmarks refusals [RUNS or FIRST-LAST] [less]
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from simulated.notch import largest_least, notched, plane_of, raw

from benchmarks.castings import Array, seeds_of
from metrocli.errors import UndeterminedError
from metrocli.geometry.triangles import Triangles
from metrocli.table import Table
from metrocli.tasks.fit_part.fit import EVEN
from metrocli.tasks.fit_part.nominals import OfMesh
from metrocli.tasks.fit_part.settings import Inputs, Overstock, Settings
from metrocli.tasks.fit_part.solve import prepare, solve

MINIMUM, SIGMA = 0.5, 0.02
"""Least overstock and standard deviation of a coordinate [mm]"""
MISSING, LESS = (3.0, 9.0), (2.0, 5.0)
CLOSE = 1e-4
"""What the linear programmes may be off [mm]"""


def refusal(mesh: Triangles, points: Array) -> str:
    """Return the message of a job of these points, empty if the part is fitted."""
    columns = {axis: points[:, k] for k, axis in enumerate("xyz")}
    table = Table({"point": np.array([f"P{n}" for n in range(len(points))]), **columns})
    settings = Settings(
        Inputs(points=Path("points.csv"), nominal=Path("part.stl")), Overstock(MINIMUM, EVEN), noise=SIGMA
    )
    try:
        solve(settings, prepare(settings, mesh, table))
    except UndeterminedError as error:
        return str(error)
    return ""


def sets_of(message: str) -> list[list[str]]:
    """Return the sets of surfaces that a refusal names."""
    found = []
    for line in message.splitlines():
        before, _, named = line.strip().partition(": ")
        if before.startswith("surface") or before == "beside them":
            found.append(named.partition(" (")[0].replace(" and ", ", ").split(", "))
    return found


def main(seeds: range, missing: tuple[float, float]) -> None:
    """Print how many refusals name surfaces that do not contradict each other, or more than needed."""
    mesh = notched()
    refused = sets = harmless = needless = wrong = 0
    ours = 0.0
    for seed in seeds:
        points, of = raw(seed, missing, 0.0)
        began = time.process_time()
        message = refusal(mesh, points)
        ours += time.process_time() - began
        refused += bool(message)
        wrong += bool(message) == (largest_least(points, of) >= MINIMUM - CLOSE)
        for named in sets_of(message):
            planes = [plane_of(OfMesh(mesh), name) for name in named]
            every = [np.isin(of, planes), *(np.isin(of, [k for k in planes if k != one]) for one in planes)]
            least = [largest_least(points[rows], of[rows]) if rows.any() else np.inf for rows in every]
            sets += 1
            harmless += least[0] >= MINIMUM - CLOSE
            needless += least[0] < MINIMUM - CLOSE and min(least[1:]) < MINIMUM - CLOSE
    print(f"{len(seeds)} parts: {refused} refused, {1e3 * ours / len(seeds):.0f} ms CPU each")
    print(f"parts that are fitted or refused wrongly: {wrong}")
    print(f"sets of surfaces named: {sets}; ", end="")
    print(f"that do not contradict each other: {harmless}; with a needless one: {needless}")


if __name__ == "__main__":
    main(seeds_of(sys.argv[1:] or ["75"]), LESS if "less" in sys.argv[1:] else MISSING)
