"""Tables and warnings of an image adjustment: residuals, RMS by image and by target, and what stands out."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from metrocli.adjust.blocks import Array
from metrocli.adjust.groups import Group
from metrocli.adjust.observations import Index
from metrocli.adjust.robust import Suspects
from metrocli.adjust.solution import Residuals
from metrocli.table import Table
from metrocli.tasks.image_adjustment import Adjusted
from metrocli.tasks.sightings import listed

if TYPE_CHECKING:
    from metrocli.table import Values

_VIEW_SUSPECT = 2.5
"""An image whose RMS is this many times the median of all is named."""


def root_mean_square(values: Array) -> float:
    """Return the root mean square length of image residuals (2, n), in their unit, a point counting once."""
    return float(np.sqrt((values**2).sum(axis=0).mean())) if values.size else float("nan")


def residual_table(residuals: Residuals, group: Group) -> Table:
    """Return /residuals: a row for each coordinate of each reading."""
    observations = group.observations
    d, n = observations.readings.shape
    columns: dict[str, Values] = {
        name: np.repeat(np.array(values, dtype=str), d) for name, values in observations.keys.items()
    }
    columns["component"] = np.tile(np.array(observations.components, dtype=str), n)
    columns["reading"] = observations.readings.T.ravel()
    for name, values in (
        ("residual", residuals.values),
        ("sigma", residuals.sigma),
        ("normalised", residuals.normalised),
        ("redundancy", residuals.redundancy),
    ):
        columns[name] = np.ascontiguousarray(values.T).ravel()
    return Table(columns, dict.fromkeys(("reading", "residual", "sigma"), observations.unit))


def rms_table(label: str, names: Sequence[str], index: Index, residuals: Array) -> Table:
    """Return for each member, an image or a target, the number of readings, their RMS and the largest residual."""
    return Table({label: np.array(names), **rms_by(names, index, residuals)}, {"rms": "px", "largest": "px"})


def rms_by(names: Sequence[str], index: Index, residuals: Array) -> dict[str, Array]:
    """Return for each member the number of readings, their RMS and the largest residual, in pixels."""
    square = (residuals**2).sum(axis=0)
    counts = np.bincount(index, minlength=len(names))
    largest = np.zeros(len(names))
    np.maximum.at(largest, index, np.sqrt(square))
    return {
        "readings": counts.astype(float),
        "rms": np.sqrt(np.bincount(index, square, len(names)) / np.maximum(counts, 1)),
        "largest": largest,
    }


def suspect_images(names: Sequence[str], rms: Array, counts: Array) -> list[str]:
    """Return a warning for each image whose RMS is far above the others'."""
    seen = rms[counts > 0]
    if seen.size < 3:
        return []
    middle = float(np.median(seen))
    return [
        f"image {name}: RMS {value:.3f} px is {value / middle:.1f} times the median of the images; "
        "look at it, or leave it out"
        for name, value, n in zip(names, rms, counts, strict=True)
        if n > 0 and value > _VIEW_SUSPECT * middle
    ]


def suspect_readings(found: Suspects, group: Group) -> list[str]:
    """Return a warning that names the readings with the largest tests."""
    if not found.rows.size:
        return []
    order = np.argsort(-found.tests)
    keys = group.observations.keys
    worst = [
        f"{keys['image'][i]}/{keys['target'][i]} (w = {t:.1f})"
        for i, t in zip(found.rows[order].tolist(), found.tests[order].tolist(), strict=True)
    ]
    return [
        f"{len(worst)} readings exceed the outlier bound |w| = {found.critical:.2f}: {listed(worst, 5)}; "
        "`outliers: remove` leaves such readings out"
    ]


def adjustment_notes(adjusted: Adjusted) -> list[str]:
    """Return what the reader is told of the noise found and the readings rejected."""
    lines = []
    if adjusted.noise is not None:
        lines.append(f"noise of an image coordinate found: {adjusted.noise:.4f} px; covariances are scaled by it")
    if len(adjusted.rejected):
        lines.append(
            f"{len(adjusted.rejected)} readings rejected as outliers (table 'rejected' has each with its test value)"
        )
    return lines
