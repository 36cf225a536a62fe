"""The casting of the sample raw-part: the ideal part laid into it, without the program's readers.

Points and their joint covariance are those of the result of its photogrammetry, which is a calibrate-camera job.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from scipy.optimize import minimize

from benchmarks.apart.model import Array
from benchmarks.apart.samples import stated
from benchmarks.apart.statement import TRIALS, Rng, Simulated, Statement, of_mean, of_share, of_spread, of_value
from benchmarks.hidden.scenes import rotation

_PLANES = {"left": (0, -1, 0.0), "right": (0, 1, 1500.0), "front": (1, -1, 0.0), "back": (1, 1, 1000.0)}
_PLANES |= {"bottom": (2, -1, 0.0), "top": (2, 1, 400.0)}
"""Axis, direction of the outward normal, place"""
_ROUND = {"bore-1": (400.0, 300.0, 60.0, -1), "bore-2": (1150.0, 700.0, 90.0, -1), "boss": (750.0, 500.0, 150.0, 1)}
"""Place of the axis along z, radius, and 1 for material inside"""
_STEP = 1e-5
_SCALE = np.array([1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3])
"""Units of a step that the search sees [mm, rad]"""
_MANY = 100_000
"""Draws of the overstock by chance"""


def overstock(points: Array, surface: list[str]) -> Array:
    """Return the distance (n,) of points in the part frame (n, 3) from their ideal surfaces, outward."""
    found, names = np.empty(len(points)), np.array(surface)
    for name in set(surface):
        x, y, z = points[names == name].T
        if name in _PLANES:
            axis, sign, place = _PLANES[name]
            found[names == name] = sign * ((x, y, z)[axis] - place)
        else:
            x0, y0, radius, sign = _ROUND[name]
            found[names == name] = sign * (np.hypot(x - x0, y - y0) - radius)
    return found


class Casting:
    """Measured points with their joint covariance, and the ideal part laid into them with the least variation."""

    def __init__(self, folder: Path, result: Path) -> None:
        used = [row for row in stated(result, "overstock") if row["used"]]
        targets = [row["target"] for row in stated(result, "targets")]
        self.names, self.surface, self.targets = (
            [row["point"] for row in used],
            [row["surface"] for row in used],
            targets,
        )
        with h5py.File(folder / "results/photogrammetry.h5") as file:
            listed = [name.decode() for name in file["points"]["point"]]
            rows_of = [listed.index(name) for name in [*self.names, *targets]]
            self.places = np.stack([file["points"][a][rows_of] for a in "xyz"], axis=1)
            each = file["points_covariance"][:][rows_of]
            common, core = file["points_common"][:][rows_of], file["points_core"][:]
        flat = common.reshape(-1, len(core))
        joint = flat @ core @ flat.T
        own = each - np.einsum("nka,ab,nlb->nkl", common, core, common, optimize=True)
        for i, one in enumerate(own):
            joint[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] += one
        values, vectors = np.linalg.eigh(joint)
        self.root = vectors * np.sqrt(np.maximum(values, 0.0))
        self.pose = np.array([row["value"] for row in stated(result, "parameters")])

    def drawn(self, rng: Rng) -> Array:
        """Return places with the errors of the photogrammetry."""
        return np.asarray(self.places + (self.root @ rng.normal(size=self.root.shape[1])).reshape(-1, 3))

    def in_part(self, pose: Array, places: Array) -> Array:
        """Return places (n, 3) in the frame of the part."""
        return np.asarray((places - pose[:3]) @ rotation(pose[3:]))

    def overstock_at(self, pose: Array, places: Array) -> Array:
        """Return the overstock (n,) of places for a pose of the part."""
        return overstock(self.in_part(pose, places[: len(self.names)]), self.surface)

    def now(self, places: Array) -> Array:
        """Return the overstock (n,) of places where the part is machined as reported."""
        return self.overstock_at(self.pose, places)

    def fitted(self, places: Array) -> Array:
        """Return the pose with the least variation of the overstock (6,), by two Gauss-Newton steps."""
        pose = self.pose.copy()

        def varied(pose: Array) -> Array:
            found = self.overstock_at(pose, places)
            return np.asarray(found - found.mean())

        steps = np.diag([1e-2, 1e-2, 1e-2, _STEP, _STEP, _STEP])
        for _ in range(2):
            columns = [(varied(pose + step) - varied(pose - step)) / (2 * step.max()) for step in steps]
            pose = pose - np.linalg.lstsq(np.stack(columns, axis=1), varied(pose), rcond=None)[0]
        return pose

    def held(self, places: Array, minimum: float) -> Array:
        """Return the pose with the least variation of the overstock that leaves a minimum everywhere (6,), by SLSQP.

        SLSQP may end a little below the minimum, so it begins twice.
        """
        pose = self.pose
        for _ in range(2):

            def now(step: Array, begin: Array = pose) -> Array:
                return self.overstock_at(begin + step * _SCALE, places)

            room = {"type": "ineq", "fun": lambda step, now=now: now(step) - minimum}
            options = {"ftol": 1e-15, "maxiter": 200}
            found = minimize(
                lambda step, now=now: now(step).var(), np.zeros(6), method="SLSQP", constraints=room, options=options
            )
            pose = pose + found.x * _SCALE
        return np.asarray(pose)

    @cached_property
    def simulated(self) -> tuple[Array, Array, Array]:
        """Poses (t, 6), targets in the part (t, m, 3), and overstock where the part is machined as reported (t, n)."""
        rng, n = np.random.default_rng(1), len(self.names)
        poses, targets, left = [], [], []
        for _ in range(TRIALS):
            places = self.drawn(rng)
            poses.append(self.fitted(places))
            targets.append(self.in_part(poses[-1], places[n:]))
            left.append(self.now(places))
        return np.array(poses), np.array(targets), np.array(left)


def _spread(of: Callable[[], Array], claimed: float) -> Callable[[Rng], Simulated]:
    return lambda _: of_spread(of(), claimed)


def statements(place: str, one: Casting, result: Path) -> Iterable[list[Statement]]:
    """Yield what a report of fit-part states: uncertainties and overstock."""

    def said(claim: str, text: str, check: Callable[[Rng], Simulated]) -> Statement:
        return Statement("fit-part", place, claim, text, check)

    def std(claim: str, value: float, of: Callable[[], Array], unit: str = "mm") -> Statement:
        return said(f"standard uncertainty of {claim}", f"{value:.3g} {unit}", _spread(of, value))

    points = {row["point"]: row for row in stated(result, "overstock")}
    surfaces: Mapping[str, Mapping[str, float]] = {row["surface"]: row for row in stated(result, "surfaces")}
    rows = {name: np.array([one == name for one in one.surface]) for name in surfaces}
    yield [
        std(f"the pose, {row['name']}", row["std"], lambda i=i: one.simulated[0][:, i], row["unit"])
        for i, row in enumerate(stated(result, "parameters"))
    ]
    yield [
        std(f"target {row['target']}.{axis}", row[f"sigma_{axis}"], lambda i=i, a=a: one.simulated[1][:, i, a])
        for i, row in enumerate(stated(result, "targets"))
        for a, axis in enumerate("xyz")
    ]
    yield [
        std(f"the overstock at {name}", points[name]["s_overstock"], lambda i=i: one.simulated[2][:, i])
        for i, name in enumerate(one.names)
    ]
    yield [
        std(
            f"the mean overstock of {name}",
            row["s_mean"],
            lambda name=name: one.simulated[2][:, rows[name]].mean(axis=1),
        )
        for name, row in surfaces.items()
    ]
    now = one.now(one.places)
    yield [
        said(
            f"least overstock of {name}",
            f"{row['least']:.4f} mm",
            lambda _, name=name, row=row: of_value(float(now[rows[name]].min()), row["least"]),
        )
        for name, row in surfaces.items()
    ]


def unclean(place: str, one: Casting, surfaces: Iterable[Mapping[str, Any]], minimum: float) -> Iterable[Statement]:
    """Yield the chances that a surface has less than the minimum somewhere, where the part is machined as reported."""

    def check(name: str, chance: float) -> Callable[[Rng], Simulated]:
        rows = np.array([of == name for of in one.surface])

        def simulated(rng: Rng) -> Simulated:
            hits = sum((one.now(one.drawn(rng))[rows] < minimum).any() for _ in range(TRIALS))
            return of_share(int(hits), TRIALS, chance, chance)

        return simulated

    for row in surfaces:
        if row["below"] > 0:
            claim, chance = f"chance that {row['surface']} has less than {minimum:g} mm", float(row["below"])
            yield Statement("fit-part", place, claim, f"{chance:.1%}", check(row["surface"], chance))


def degrees_of_freedom(place: str, one: Casting, dof: int) -> Statement:
    """Return the degrees of freedom: the mean sum of squares where independent overstock of std 1 varies by chance."""

    def check(rng: Rng) -> Simulated:
        steps = np.diag([1e-2, 1e-2, 1e-2, _STEP, _STEP, _STEP])
        columns = [one.overstock_at(one.pose + step, one.places) - one.now(one.places) for step in steps]
        even = np.stack([column - column.mean() for column in columns], axis=1)
        varied = rng.normal(size=(len(one.names), _MANY))
        varied -= varied.mean(axis=0)
        left = varied - even @ np.linalg.lstsq(even, varied, rcond=None)[0]
        return of_mean((left**2).sum(axis=0), dof)

    return Statement("fit-part", place, "degrees of freedom", f"{dof}", check)
