"""Tables and warnings of an image adjustment: residuals, RMS by image and by target, and what stands out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.adjust.model.groups import Group
from metrocli.adjust.robust import Suspects
from metrocli.arrays import Array, Index
from metrocli.table import Table
from metrocli.tasks.shared.images.adjustment import AdjustedImages
from metrocli.tasks.shared.statistics import beyond_bound

_VIEW_SUSPECT = 2.5
"""A warning names images whose RMS is more than this many times the median."""


def root_mean_square(values: Array) -> float:
    """Return the root mean square length of image residuals (2, n), in their unit; each point counts once."""
    return float(np.sqrt((values**2).sum(axis=0).mean())) if values.size else float("nan")


def rms_table(residuals: Array, group: Group, label: str, index: Index, names: Sequence[str]) -> Table:
    """Return a row for each image or target with the number of its readings and their residuals [px].

    Columns: readings, RMS of the points, RMS of u and of v, the largest residual and the reading that has it. `label`
    is "image" or "target"; `index` gives the row of each reading.
    """
    square = residuals**2
    distance = np.sqrt(square.sum(axis=0))
    counts = np.bincount(index, minlength=len(names))
    u, v = (np.sqrt(np.bincount(index, row, len(names)) / np.maximum(counts, 1)) for row in square)
    by_size = np.argsort(distance, kind="stable")
    worst = np.full(len(names), -1, dtype=np.intp)
    worst[index[by_size]] = by_size
    other = "target" if label == "image" else "image"
    keys = group.observations.keys[other]
    return Table.of(
        {
            label: names,
            "readings": counts,
            "rms rms_u rms_v [px]": np.stack([np.hypot(u, v), u, v], axis=1),
            "largest [px]": np.where(worst >= 0, distance[worst], 0.0),
            f"largest_{other} [text]": [keys[i] if i >= 0 else "" for i in worst],
        }
    )


def suspect_images(names: Sequence[str], rms: Array, counts: Array) -> list[str]:
    """Return a warning for each image whose RMS is more than 2.5 times the median of all images."""
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


def suspect_readings(suspects: Suspects, group: Group) -> list[str]:
    """Return a warning that names the readings beyond the outlier bound, worst first; an empty list without any."""
    if not suspects.rows.size:
        return []
    order = np.argsort(-suspects.tests)
    keys = group.observations.keys
    worst = [
        f"{keys['image'][i]}/{keys['target'][i]} (w = {t:.1f})"
        for i, t in zip(suspects.rows[order].tolist(), suspects.tests[order].tolist(), strict=True)
    ]
    return [beyond_bound(worst, suspects.critical)]


def adjustment_notes(adjusted: AdjustedImages) -> list[str]:
    """Return the notes of the report: the estimated noise and the number of rejected readings."""
    lines = []
    if adjusted.noise is not None:
        lines.append(f"estimated noise of an image coordinate: {adjusted.noise:.3g} px; covariances are scaled by it")
    if adjusted.structured is not None:
        lines.append(adjusted.structured.note)
    if len(adjusted.rejected):
        lines.append(
            f"{len(adjusted.rejected)} readings rejected as outliers (table 'rejected' lists them with their tests)"
        )
    return lines
