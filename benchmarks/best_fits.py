"""Best fits with something hidden in them: how often `diagnose` names it, and what is not there.

    python -m benchmarks best_fits [COUNT]        # 200 unless given

Twelve points of a part of some metres, turned and shifted at random, with 20 um of noise in each coordinate as
declared. In a quarter of the cases each nothing is hidden, a growth of 40 um/m, a scale of one axis that is wrong by
100 um/m, or a point that moved by 0.15 mm. A point that moved along one axis is one wrong coordinate as well: a report
that calls coordinates of this point wrong, and no others, names the place.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.hidden.named import print_rates, words
from metrocli.diagnosis.diagnose import diagnose
from metrocli.table import Table
from metrocli.tasks.fit_points import task
from metrocli.tasks.fit_points.settings import Inputs, Settings

COUNT, POINTS, NOISE = 200, 12, 0.02
GROWTH, AXIS, MOVED = 40e-6, 100e-6, 0.15
HIDDEN = ("", "part-expansion", "machine-scale", "moved-point")


def listed(places: np.typing.NDArray[np.float64]) -> Table:
    """Return a list of points."""
    return Table.of({"point": [f"P{i}" for i in range(len(places))], "x y z [mm]": places})


def drawn(hidden: str, rng: np.random.Generator) -> tuple[Table, Table, dict[str, str]]:
    """Return the measured and the nominal list, and where something is hidden."""
    nominal = rng.uniform([-2000, -1500, -300], [2000, 1500, 900], (POINTS, 3))
    true, where = nominal.copy(), dict[str, str]()
    if hidden == "part-expansion":
        true *= 1 + GROWTH
    if hidden == "moved-point":
        place, way = int(rng.integers(POINTS)), rng.normal(size=3)
        true[place] += MOVED * way / np.linalg.norm(way)
        where = {"point": f"P{place}"}
    measured = (true - rng.normal(0, 3000, 3)) @ Rotation.random(random_state=rng).as_matrix()
    if hidden == "machine-scale":
        axis = int(rng.integers(3))
        measured[:, axis] *= 1 + AXIS
        where = {"axis": "xyz"[axis]}
    return listed(measured + rng.normal(0, NOISE, measured.shape)), listed(nominal), where


def cases(count: int) -> Iterator[tuple[str, tuple[str, str]]]:
    """Yield a title of each case, and the outcome in words."""
    settings = Settings(Inputs(points=Path("-"), nominal=Path("-")), noise=NOISE)
    for number in range(count):
        hidden = HIDDEN[number % len(HIDDEN)]
        measured, nominal, where = drawn(hidden, np.random.default_rng(number))
        found = diagnose(task.diagnosed(task.TASK.job(settings, measured, nominal)))
        wrong = "" if not found.outliers else f", {len(found.outliers)} wrong readings"
        yield f"{number}{wrong}", words(found, hidden, where)


if __name__ == "__main__":
    sys.exit(print_rates(cases(int(sys.argv[1]) if len(sys.argv) > 1 else COUNT), readings=True))
