"""Ranges of a vehicle to beacons adjusted by numpy alone, to judge what a diagnosis names; nothing of metrocli is used.

`l = (1 + scale) |x - b| + offset + ...`, beacons b unknown in x and y; ranges far off count linearly (Huber).
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
_LOSS, _STEPS, _STILL = 3.0, 60, 1e-6
FOLDS = 10
SHARED = {"length-scale": "distance", "length-offset": "one"}
OF_BEACON = {"tracer-scale": "distance", "dead-path-drift": "time"}


@dataclass(frozen=True)
class Ranges:
    """Ranges to beacons."""

    beacons: tuple[str, ...]
    start: Array
    """(beacons, 3) mm"""
    beacon: Index
    point: Array
    """Place of the vehicle at each range, (n, 3) mm"""
    length: Array
    """(n,) mm"""
    time: Array
    columns: Mapping[str, list[str]]
    """Of the file"""

    @classmethod
    def read(cls, stem: Path) -> Ranges:
        """Return the ranges of a drive."""
        rows = {}
        for what in ("lengths", "points", "tracers"):
            with Path(f"{stem}_{what}.csv").open(encoding="utf-8") as file:
                rows[what] = list(csv.DictReader(line for line in file if not line.startswith("#")))
        names = tuple(row["tracer"] for row in rows["tracers"])
        places = {row["point"]: [float(row[f"{a}_m"]) * 1e3 for a in "xyz"] for row in rows["points"]}
        seen = rows["lengths"]
        return cls(
            names,
            np.array([[float(row[f"{a}_m"]) * 1e3 for a in "xyz"] for row in rows["tracers"]]),
            np.array([names.index(row["tracer"]) for row in seen]),
            np.array([places[row["point"]] for row in seen]),
            np.array([float(row["length_m"]) * 1e3 for row in seen]),
            np.array([float(row["t_s"]) for row in seen]),
            {key: [row[key] for row in seen] for key in seen[0]},
        )

    def only(self, kept: Index) -> Ranges:
        """Return some of the ranges."""
        parts = (one[kept] for one in (self.beacon, self.point, self.length, self.time))
        return replace(self, **dict(zip(("beacon", "point", "length", "time"), parts, strict=True)))

    def with_change(self, change: Array) -> dict[str, list[str]]:
        """Return the columns of the file with changed lengths (n,) mm."""
        return {**self.columns, "length_m": [repr(float(one)) for one in (self.length + change) / 1e3]}

    def column(self, name: str, where: Mapping[str, str]) -> Array:
        """Return the change of the ranges by a unit effect (n,)."""
        kind = SHARED.get(name) or OF_BEACON[name]
        there = (
            self.beacon == self.beacons.index(where["tracer"]) if "tracer" in where else np.ones(len(self.beacon), bool)
        )
        distance = np.linalg.norm(self.point - self.start[self.beacon], axis=1)
        values = {"distance": distance, "one": np.ones(len(distance)), "time": self.time - self.time.min()}
        return np.where(there, values[kind], 0.0)


Terms = Sequence[tuple[str, Mapping[str, str]]]


@dataclass(frozen=True)
class Fit:
    """Adjusted beacons, and sizes of effects."""

    places: Array
    sizes: Array
    sigma: float


def _left(one: Ranges, terms: Terms, places: Array, sizes: Array) -> Array:
    moved = replace(one, start=places)
    added = sum(
        (size * moved.column(*term) for size, term in zip(sizes, terms, strict=True)), np.zeros(len(one.length))
    )
    return one.length - np.linalg.norm(one.point - places[one.beacon], axis=1) - added


def fitted(one: Ranges, terms: Terms) -> Fit:
    """Return the beacons adjusted beside some effects."""
    places, sizes, sigma = one.start.copy(), np.zeros(len(terms)), 1.0
    for _ in range(_STEPS):
        r = _left(one, terms, places, sizes)
        sigma = 1.4826 * float(np.median(np.abs(r)))
        weight = np.sqrt(np.minimum(1.0, _LOSS * sigma / np.maximum(np.abs(r), 1e-12)))
        off = places[one.beacon] - one.point
        unit = off / np.linalg.norm(off, axis=1)[:, None]
        j = np.zeros((len(r), 2 * len(places) + len(terms)))
        for axis in range(2):
            j[np.arange(len(r)), 2 * one.beacon + axis] = unit[:, axis]
        moved = replace(one, start=places)
        for at, term in enumerate(terms):
            j[:, 2 * len(places) + at] = moved.column(*term)
        scale = np.maximum(np.linalg.norm(j * weight[:, None], axis=0), 1e-12)
        step = np.linalg.lstsq(j * weight[:, None] / scale, r * weight, rcond=None)[0] / scale
        places[:, :2] += step[: 2 * len(places)].reshape(-1, 2)
        sizes = sizes + step[2 * len(places) :]
        if np.abs(step * scale).max() < _STILL * sigma * np.sqrt(len(r)):
            break
    return Fit(places, sizes, sigma)


def gain(one: Ranges, before: Terms, after: Terms) -> tuple[float, float]:
    """Return by how much held-out parts of the drive fit better with more effects, and the standard error of it."""
    sigma = fitted(one, after).sigma
    order = np.argsort(one.time, kind="stable")
    differences = []
    for part in np.array_split(order, FOLDS):
        rest = one.only(np.setdiff1d(order, part))
        squares = []
        for terms in (before, after):
            fit = fitted(rest, terms)
            r = np.abs(_left(one.only(part), terms, fit.places, fit.sizes)) / sigma
            squares.append(float(np.where(r < _LOSS, r**2, _LOSS * (2 * r - _LOSS)).sum()))
        differences.append((squares[0] - squares[1]) / 2)
    d = np.array(differences)
    return float(d.sum()), float(d.std(ddof=1) * np.sqrt(len(d)))
