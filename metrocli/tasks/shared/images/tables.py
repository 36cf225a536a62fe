"""What every image adjustment reports: residuals, RMS by image and by target, statistics, points with rays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.quantities import Quantity
from metrocli.adjust.robust import Suspects
from metrocli.adjust.solution import Residuals, Solution
from metrocli.arrays import Array, Index
from metrocli.instruments import camera
from metrocli.instruments.camera import TARGET
from metrocli.table import Table
from metrocli.tasks.shared.images.adjustment import AdjustedImages
from metrocli.tasks.shared.images.sightings import Sighted
from metrocli.tasks.shared.joint_covariance import factors
from metrocli.tasks.shared.statistics import (
    Statistics,
    basic_statistics,
    beyond_bound,
    left_out,
    residual_table,
    with_noise,
    with_tests,
)
from metrocli.uncertainty.predicted import POINTS_COVARIANCE
from metrocli.words import counted, listed

_VIEW_SUSPECT = 2.5
"""A warning names images whose RMS is more than this many times the median."""


def root_mean_square(values: Array) -> float:
    """Return the root mean square length of image residuals (2, n), in their unit; each point counts once."""
    return float(np.sqrt((values**2).sum(axis=0).mean())) if values.size else float("nan")


FEW = 20
"""Fewest readings of an image whose residuals are smoothed"""
_SMOOTH = 7
"""Largest degree of the polynomial that stands for what the lens model lacks in one image"""


def scatter(residuals: Array, readings: Array, image: Index, size: tuple[int, int]) -> float:
    """Return the scatter of image points about their neighbours [px], as `root_mean_square` has it; NaN of few points.

    It is what a polynomial in u and v leaves of the residuals (2, n) of an image, the median of all images. `image` is
    that of each reading, `size` that of images [px].
    """
    w, h = size
    squares = list[float]()
    for i in np.flatnonzero(np.bincount(image) >= FEW).tolist():
        mine = image == i
        # about the middle and in units of the image: powers up to 7 stay of one size
        x, y = readings[0, mine] / w - 0.5, readings[1, mine] / h - 0.5
        # at least twice as many points as coefficients, or the polynomial would take the noise, too
        degree = next(d for d in range(_SMOOTH, 0, -1) if (d + 1) * (d + 2) <= mine.sum())
        smooth = np.stack([x**a * y**b for a in range(degree + 1) for b in range(degree + 1 - a)], axis=1)
        values = residuals[:, mine].T
        left = values - smooth @ np.linalg.lstsq(smooth, values, rcond=None)[0]
        # divided by what is left after the coefficients, so that high degrees do not make the noise smaller
        squares.append(float((left**2).sum()) / (len(left) - smooth.shape[1]))
    return float(np.sqrt(np.median(squares))) if squares else float("nan")


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
    # written in rising order, so that the largest of each stays
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


def image_tables(adjusted: AdjustedImages, residuals: Residuals, sighted: Sighted, view: str) -> dict[str, Table]:
    """Return the tables of readings, images and targets; `view` is the index of the images among those of readings."""
    group = adjusted.group
    index = group.observations.index
    return {
        "residuals": residual_table(residuals, group),
        "views": rms_table(residuals.values, group, "image", index[view], sighted.images),
        "targets": rms_table(residuals.values, group, "target", index[TARGET], sighted.targets.names),
        "suspects": suspect_table(adjusted.suspects, group),
        "rejected": adjusted.rejected,
    }


def suspect_table(suspects: Suspects, group: Group) -> Table:
    """Return the image points beyond the outlier bound, the worst first."""
    order = np.argsort(-suspects.tests)
    rows = suspects.rows[order].tolist()
    keys = {f"{name} [text]": [group.observations.keys[name][row] for row in rows] for name in ("image", "target")}
    return Table.of({**keys, "w": suspects.tests[order]})


def image_statistics(adjusted: AdjustedImages, residuals: Residuals, own: Statistics) -> Statistics:
    """Return the statistics of an adjustment of image points, with those of its kind of job."""
    statistics = basic_statistics(adjusted.solution, {"px": root_mean_square(residuals.values)}) | own
    if adjusted.noise is None:
        return statistics
    return with_noise(statistics, adjusted.solution, {"noise": adjusted.noise}, adjusted.structured)


def image_warnings(
    adjusted: AdjustedImages, sighted: Sighted, views: Table | None, own: Sequence[str] = ()
) -> list[str]:
    """Return the warnings of what was found in the images, of the kind of job, and of what stands out."""
    lines = [*sighted.warnings, *own]
    if views is not None:
        rms = views.numbers("rms") / _stated_ratios(adjusted.group, sighted.images)
        lines += suspect_images(sighted.images, rms, views.numbers("readings"))
    wrong = np.isfinite(adjusted.rejected.numbers("w"))
    lines += left_out(_named(adjusted.rejected.selected(wrong)))
    if lost := list(dict.fromkeys(adjusted.rejected.selected(~wrong).texts("target"))):
        few = f"{counted(len(lost), 'target', 'are')} placed by fewer than two right readings"
        lines.append(f"left out: {few}: {listed(lost)}")
    return lines + suspect_readings(adjusted.suspects, adjusted.group)


def _stated_ratios(group: Group, images: Sequence[str]) -> Array:
    """Return the ratio of the noise of each image to the declared one, root mean square, 1 where none is stated."""
    ratios = group.observations.ratios
    if ratios is None:
        return np.ones(len(images))
    rows = {name: row for row, name in enumerate(images)}
    index = np.array([rows[name] for name in group.observations.keys["image"]], dtype=np.intp)
    counts = np.bincount(index, minlength=len(images))
    return np.sqrt(np.where(counts, np.bincount(index, ratios**2, len(images)) / np.maximum(counts, 1), 1.0))


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
    return [beyond_bound(_named(suspect_table(suspects, group)), suspects.critical)]


def _named(chosen: Table) -> list[str]:
    """Return the image points of a table with their tests, the worst first."""
    pairs = zip(chosen.texts("image"), chosen.texts("target"), strict=True)
    return with_tests([f"{image}/{target}" for image, target in pairs], chosen.numbers("w").tolist())


def adjustment_notes(adjusted: AdjustedImages) -> list[str]:
    """Return the notes of the report on the estimated noise."""
    lines = []
    if adjusted.noise is not None:
        lines.append(f"estimated noise of an image coordinate: {adjusted.noise:.3g} px; covariances are scaled by it")
    if adjusted.structured is not None:
        lines.append(adjusted.structured.note)
    return lines


def with_places(targets: Table, solution: Solution) -> Table:
    """Return the table of targets with their coordinates, as listed or as adjusted."""
    block = solution.blocks[camera.TARGET]
    row = {name: number for number, name in enumerate(block.members)}
    return targets.joined({"x y z [mm]": block.values[[row[name] for name in targets.texts("target")]]})


def depths(group: Group, solution: Solution) -> Array:
    """Return how far before its camera each target is, along the optical axis, for each reading (n,) [mm]."""
    to_camera = group.chain.until(Quantity.POINT_IN_CAMERA)
    return np.asarray(to_camera.predict({**solution.blocks}, group.observations)[2])


def points_of(solution: Solution, target: Index, origins: Array) -> tuple[Table, dict[str, Array]]:
    """Return the coordinates of the targets that are seen, with their rays, and the arrays of their covariance.

    `target` (readings,) and `origins` (readings, 3) are the target of each reading and the place that sees it.
    """
    block, covariance = solution.blocks[camera.TARGET], solution.covariance_or_raise()
    each = covariance.members(camera.TARGET)
    std = np.sqrt(np.einsum("mii->mi", each))
    rays = np.bincount(target, minlength=len(block.members))
    known = rays > 0
    table = Table.of(
        {
            "point": np.array(block.members)[known],
            "x y z [mm]": block.values[known],
            "sx sy sz [mm]": std[known],
            "rays": rays[known],
            "ray_angle [rad]": _ray_angles(block.values, target, origins)[known],
        }
    )
    return table, {POINTS_COVARIANCE: each[known], **factors(covariance, camera.TARGET, known)}


def _ray_angles(points: Array, target: Index, origins: Array) -> Array:
    """Return the largest angle [rad] between two rays of each target, 0 for a single ray."""
    angles = np.zeros(len(points))
    for i in np.unique(target):
        rays = origins[target == i] - points[i]
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        angles[i] = np.arccos(np.clip((rays @ rays.T).min(), -1.0, 1.0))
    return angles
