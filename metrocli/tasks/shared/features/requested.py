"""The features that a job asks for: their keys, and their probing points."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from metrocli.arrays import Index
from metrocli.errors import Fault, InputError
from metrocli.frozen import dataclass
from metrocli.settings import At, Choice, Either, LocatedValue, MapOf, Section, setting
from metrocli.table import Table
from metrocli.tasks.shared.features.fit import Criterion, fewest
from metrocli.tasks.shared.features.ideal import IdealFeature
from metrocli.words import suggestion


@dataclass(frozen=True)
class RequestedFeature:
    """A feature to lay through some of the probing points."""

    name: str
    shape: IdealFeature
    criteria: tuple[Criterion, ...]
    rows: Index


def requested_features(
    features: Mapping[str, LocatedValue], points: Table | None, key: str = "probing"
) -> tuple[RequestedFeature, ...]:
    """Return the features of a job; raises InputError for those without points or with too few.

    `key` is that of the points under `inputs`, which have a column `feature`.
    """
    names = np.array([] if points is None or "feature" not in points else points.texts("feature"), dtype=str)
    known = sorted({*names.tolist()} - {""})
    requested, faults = [], []
    for name, placed in features.items():
        shape = IdealFeature(placed.value if isinstance(placed.value, str) else placed.value.shape)
        fit = "least-squares" if isinstance(placed.value, str) else placed.value.fit
        rows = np.flatnonzero(names == name)
        if fault := _fault(name, shape, len(rows), known, placed, key):
            faults.append(fault)
        requested.append(RequestedFeature(name, shape, tuple(Criterion) if fit == "both" else (Criterion(fit),), rows))
    if faults:
        raise InputError(faults)
    return tuple(requested)


def _fault(
    name: str, shape: IdealFeature, points: int, known: list[str], placed: LocatedValue, key: str
) -> Fault | None:
    at = placed.node.path
    if not known:
        text = f"{at}: features need `inputs: {key}` with a column 'feature'"
        return placed.node.fault(text, "expected points on the feature, with its name")
    if not points:
        return placed.node.fault(f"{at}: no point of `{key}` is of feature '{name}'", suggestion(name, known))
    least = fewest(shape)
    if points < least:
        return placed.node.fault(
            f"{at}: feature '{name}' has {points} points", f"expected {least} or more for a {shape}"
        )
    return None


SHAPES = ("line", "plane", "circle", "sphere", "cylinder", "cone")


@dataclass(frozen=True)
class Feature:
    """An ideal feature to lay through points."""

    shape: str = setting(Choice(*SHAPES), "the ideal shape")
    fit: str = setting(
        Choice("least-squares", "minimum-zone", "both"), "how it is laid through the points", default="least-squares"
    )


def features_through(points: str) -> Any:
    """Return the key `features` of a job: shapes, or shapes and fits, by the names of features."""
    return setting(
        MapOf(At(Either(Choice(*SHAPES), Section(Feature)))),
        f"ideal features through {points}, by the names in column `feature`",
        default={},
    )
