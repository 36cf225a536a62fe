"""The keys of features in a job: shape, and how it is laid through the points."""

from __future__ import annotations

from typing import Any

from metrocli.frozen import dataclass
from metrocli.settings import At, Choice, Either, MapOf, Section, setting

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
