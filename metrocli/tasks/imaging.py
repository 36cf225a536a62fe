"""What the image jobs share: reading sightings and target lists, outliers, and the tables of an image adjustment."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt

from metrocli.adjust.adjustment import adjust
from metrocli.adjust.blocks import Block
from metrocli.adjust.datum import Datum
from metrocli.adjust.groups import Group, prior
from metrocli.adjust.observations import Observations
from metrocli.adjust.robust import Suspects, gross, robust_start, suspects
from metrocli.adjust.solution import Residuals, Solution, residuals_of
from metrocli.errors import Fault, InputError, NotConvergedError, UndeterminedError
from metrocli.imageset import ImageSet
from metrocli.settings import Choice, setting
from metrocli.table import TEXT, Column, Columns, Table
from metrocli.targets.find import find
from metrocli.targets.pattern import GRIDS, Pattern, pattern_points

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]

OBSERVATIONS = Columns(
    (
        Column("image", TEXT),
        Column("target", TEXT),
        Column("u", "pixel"),
        Column("v", "pixel"),
        Column("sigma", "pixel", required=False),
        Column("t", "time", required=False),
        Column("temp", "temperature", required=False),
    ),
    key=("image", "target"),
    description="image coordinates of targets",
)
TARGETS = Columns(
    (
        Column("target", TEXT),
        Column("x", "length"),
        Column("y", "length"),
        Column("z", "length"),
        *(
            Column(name, "length", required=False, may_be_empty=True)
            for name in ("sigma", "sigma_x", "sigma_y", "sigma_z", "radius")
        ),
    ),
    key=("target",),
    description="coordinates of targets",
)
IMAGES = "images"
"""Name of the group of image points"""
_VIEW_SUSPECT = 2.5
"""An image whose RMS is this many times the median of all is named."""


@dataclass(frozen=True)
class Targets:
    """A list of targets and how well each coordinate is known."""

    names: tuple[str, ...]
    points: Array
    """(m, 3) mm"""
    sigma: Array
    """(m, 3) mm: 0 exact, nan unknown"""
    radius: Array
    """(m,) mm, nan where it is not given"""


@dataclass(frozen=True)
class Sighted:
    """Image points of known targets, ready for an adjustment."""

    images: tuple[str, ...]
    targets: Targets
    observations: Observations
    warnings: tuple[str, ...] = ()
    eccentric: bool = False
    """Whether the readings are centres of ellipses whose eccentricity the model has to follow"""

    @property
    def view(self) -> Index:
        """Image of each reading."""
        return self.observations.index["view"]

    @property
    def target(self) -> Index:
        """Target of each reading."""
        return self.observations.index["target"]


def read_targets(table: Table, default_sigma: float = 0.0) -> Targets:
    """Return the targets of a list; where no sigma column is given, `default_sigma` (nan: unknown)."""
    common = table.numbers("sigma", default_sigma)
    sigma = np.stack([table.numbers(f"sigma_{axis}") if f"sigma_{axis}" in table else common for axis in "xyz"], axis=1)
    negative = np.flatnonzero((sigma < 0).any(axis=1))
    if negative.size:
        raise InputError([Fault("a standard deviation is negative", table.file, table.lines[i]) for i in negative])
    return Targets(tuple(table.texts("target")), table.stacked(("x", "y", "z")), sigma, table.numbers("radius", np.nan))


def targets_of(pattern: Pattern) -> Targets:
    """Return the targets of a printed pattern, taken as exact."""
    names, points = pattern_points(pattern)
    return Targets(tuple(names), points, np.zeros_like(points), np.full(len(names), np.nan))


def eccentricity_setting() -> str:
    """Return the setting of how the eccentricity of circular targets is treated."""
    text = "perspective moves the centre of a circle's image: correct it (needs radii), ignore it, or auto: correct it where images of targets of known diameter are measured"
    chosen: str = setting(Choice("auto", "correct", "ignore"), text, default="auto")
    return chosen


def image_faults(
    observations: object, images: object, pattern: Pattern | None, targets: object
) -> Iterable[tuple[str, str]]:
    """Yield what is missing between observations, images, targets and pattern."""
    if (observations is None) == (images is None):
        yield "inputs", "give either observations (a CSV file) or images (with a pattern), not both and not neither"
    if images is not None and pattern is None:
        yield (
            "inputs.images",
            "images need a pattern: what they show, e.g. pattern: {type: chessboard, columns: 9, rows: 6, pitch: 25 mm}",
        )
    if targets is None and (observations is not None or (pattern is not None and pattern.type not in GRIDS)):
        yield "inputs", "the key 'targets' is missing in 'inputs': the coordinates of the targets"


class ImageSettings(Protocol):
    """The settings that image jobs share."""

    @property
    def noise(self) -> float | str:
        """Standard deviation of an image coordinate, or 'estimated'."""

    @property
    def pattern(self) -> Pattern | None:
        """What the images show."""

    @property
    def eccentricity(self) -> str:
        """auto, correct or ignore."""


def sightings(
    settings: ImageSettings, observations: Table | None, targets: Table | None, images: ImageSet | None, needs: Needs
) -> Sighted:
    """Return the readings, from a table or found in images, joined to their targets."""
    warnings: tuple[str, ...] = ()
    pattern = settings.pattern
    if images is not None and pattern is not None:
        observations, warnings = sight(images, pattern)
    if observations is None:
        raise InputError("there are neither observations nor images")
    known = known_targets(pattern, targets, needs.unknown_sigma)
    sighted = join(
        observations, known, START_NOISE if isinstance(settings.noise, str) else settings.noise, needs.fewest
    )
    if not sighted.images:
        raise UndeterminedError(
            f"no image shows {needs.fewest} or more targets of the list, so nothing can be determined"
        )
    circular = pattern is not None and pattern.type not in ("chessboard", "charuco")
    eccentric = settings.eccentricity == "correct" or (
        settings.eccentricity == "auto" and images is not None and circular
    )
    return replace(
        sighted,
        warnings=warnings + sighted.warnings,
        eccentric=_radii_known(sighted, settings.eccentricity) and eccentric,
    )


def known_targets(pattern: Pattern | None, targets: Table | None, unknown_sigma: float) -> Targets:
    """Return the targets of the list, or of the printed pattern where there is none, with the pattern's diameter where the list has no radius."""
    if targets is not None:
        known = read_targets(targets, unknown_sigma)
    elif pattern is not None:
        known = targets_of(pattern)
    else:
        raise InputError("there is no list of targets")
    if pattern is not None and pattern.diameter is not None:
        known = replace(known, radius=np.where(np.isnan(known.radius), pattern.diameter / 2, known.radius))
    return known


@dataclass(frozen=True)
class Needs:
    """What a job needs of its sightings."""

    fewest: int
    """Targets that an image must show"""
    unknown_sigma: float = 0.0
    """Standard deviation of targets in a list without a sigma column; nan: unknown"""


START_NOISE = 0.1
"""Noise [px] to start from where it is estimated"""


def _radii_known(sighted: Sighted, wish: str) -> bool:
    known = bool(np.isfinite(sighted.observations.conditions["radius"]).all())
    if wish == "correct" and not known:
        raise InputError(
            "eccentricity: correct needs the radius of every target: a column radius_mm in the targets file, or the pattern's diameter"
        )
    return known


def sight(images: ImageSet, pattern: Pattern) -> tuple[Table, tuple[str, ...]]:
    """Find the targets of a pattern in images; return the sightings as a table of observations and what to warn of.

    A single dot is named after its image (file name without ending), since it stands in another place in each.
    """
    names: list[str] = []
    targets: list[str] = []
    parts: list[Array] = []
    warnings: list[str] = []
    for name, picture in images:
        found = find(pattern, picture)
        if found.reason:
            warnings.append(f"{name}: {found.reason}")
        names += [name] * len(found.targets)
        targets += [name.rsplit(".", 1)[0]] if pattern.type == "dot" and len(found.targets) else list(found.targets)
        parts.append(found.uv)
    uv = np.concatenate([*parts, np.zeros((0, 2))])
    if not len(uv):
        raise InputError([Fault(f"no target found in any of {len(images.names)} images", hint="; ".join(warnings[:3]))])
    columns = {"image": np.array(names), "target": np.array(targets), "u": uv[:, 0], "v": uv[:, 1]}
    return Table(columns, {"u": "px", "v": "px"}), tuple(warnings)


def target_priors(targets: Block, sigma: Array, free: Array) -> list[Group]:
    """Return what is known of the targets beforehand: one group for each set of axes that has a standard deviation."""
    known = free & np.isfinite(sigma) & (sigma > 0)
    groups = []
    for pattern in np.unique(known, axis=0):
        axes = tuple(int(i) for i in np.flatnonzero(pattern))
        members = np.flatnonzero((known == pattern).all(axis=1))
        if axes and members.size:
            groups.append(prior(targets, members, sigma[np.ix_(members, axes)], columns=axes))
    return groups


def join(table: Table, targets: Targets, sigma: float, fewest: int) -> Sighted:
    """Match readings to targets; images with fewer than `fewest` of them are left out with a warning.

    Raises InputError for every reading of a target that the list does not have.
    """
    place = {name: i for i, name in enumerate(targets.names)}
    of_target = table.texts("target")
    strange = [row for row, name in enumerate(of_target) if name not in place]
    if strange:
        raise InputError([_strange(table, row, of_target[row]) for row in strange[:20]])
    of_image = np.asarray(table.columns["image"], dtype=str)
    images, view, counts = np.unique(of_image, return_inverse=True, return_counts=True)
    warnings = [
        f"image {images[i]} has {counts[i]} targets, fewer than {fewest}: left out"
        for i in np.flatnonzero(counts < fewest)
    ]
    keep = counts[view] >= fewest
    renumbered = np.cumsum(counts >= fewest) - 1
    target = np.array([place[name] for name in of_target], dtype=np.intp)
    unseen = [name for i, name in enumerate(targets.names) if i not in set(target[keep].tolist())]
    if unseen:
        warnings.append(f"{len(unseen)} targets of the list are seen in no image: {_listed(unseen)}")
    spread = table.numbers("sigma", sigma)
    observations = Observations(
        readings=table.stacked(("u", "v")).T[:, keep],
        sigma=np.broadcast_to(spread, (2, len(spread)))[:, keep],
        index={"view": renumbered[view][keep].astype(np.intp), "target": target[keep]},
        keys={
            "image": tuple(of_image[keep].tolist()),
            "target": tuple(name for name, k in zip(of_target, keep, strict=True) if k),
        },
        conditions={name: table.numbers(name)[keep] for name in ("t", "temp") if name in table}
        | {"radius": targets.radius[target[keep]]},
        components=("u", "v"),
        unit="px",
    )
    return Sighted(tuple(images[counts >= fewest].tolist()), targets, observations, tuple(warnings))


def _strange(table: Table, row: int, name: str) -> Fault:
    line = table.lines[row] if table.lines else None
    return Fault(
        f"target '{name}' is not in the list of targets",
        table.file,
        line,
        hint="add it to the targets file, or remove the row",
    )


def _listed(names: Sequence[str], most: int = 8) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


@dataclass(frozen=True)
class Adjusted:
    """An image adjustment with what was rejected on the way."""

    solution: Solution
    group: Group
    """The image points that were used"""
    rejected: Table
    suspects: Suspects
    noise: float | None = None
    """Standard deviation of an image coordinate found from the residuals, where it was estimated [px]"""


def adjust_images(
    blocks: Mapping[str, Block], group: Group, others: Sequence[Group], datum: Datum | None, options: Options
) -> Adjusted:
    """Adjust image points with a robust start; remove outliers and estimate the noise as the options ask."""
    state = robust_start(blocks.values(), [group, *others], group.name, datum)
    dropped: list[tuple[int, float]] = []
    rows = np.arange(group.observations.count)
    if options.remove_outliers:
        bad = gross(group, state)
        dropped += [(int(i), float("nan")) for i in rows[bad]]
        rows, group = rows[~bad], group.selected(~bad)
    original = group.observations.sigma
    while True:
        solution = adjust(state.values(), [group, *others], datum)
        if not solution.outcome.good:
            return Adjusted(solution, group, _rejected(group, []), Suspects(np.zeros(0), np.zeros(0), 0.0))
        noise = _noise(solution, group) if options.estimate_noise else None
        if noise is not None and abs(noise - 1) > 1e-9:
            group = group.with_observations(replace(group.observations, sigma=group.observations.sigma * noise))
            state = dict(solution.blocks)
            continue
        unit = 1.0 if options.estimate_noise else max(1.0, solution.sigma0 if np.isfinite(solution.sigma0) else 1.0)
        found = suspects(solution, group, unit)
        if not (options.remove_outliers and found.rows.size):
            break
        worst = _worst_of_each_image(found, group)
        dropped += [(int(rows[i]), float(t)) for i, t in worst]
        keep = np.ones(len(rows), dtype=bool)
        keep[[i for i, _ in worst]] = False
        rows, group, state, original = rows[keep], group.selected(keep), dict(solution.blocks), original[:, keep]
    factor = float(np.mean(group.observations.sigma / original)) if options.estimate_noise else None
    ratio = None if factor is None else factor * float(np.sqrt(np.mean(original**2)))
    return Adjusted(solution, group, _rejected(options.all_readings, dropped), found, ratio)


@dataclass(frozen=True)
class Options:
    """How readings are treated."""

    all_readings: Group
    remove_outliers: bool = False
    estimate_noise: bool = False


def _noise(solution: Solution, group: Group) -> float:
    """Return sigma0 of the image points alone: `sqrt(v'Pv / sum r)` (variance component)."""
    found = residuals_of(solution, group)
    whitened = group.observations.whitened(found.values)
    controlled = float(found.redundancy.sum())
    return float(np.sqrt((whitened**2).sum() / controlled)) if controlled > 0 else 1.0


def _worst_of_each_image(found: Suspects, group: Group) -> list[tuple[int, float]]:
    views = group.observations.index["view"]
    worst: dict[int, tuple[int, float]] = {}
    for row, test in zip(found.rows.astype(int), found.tests, strict=True):
        if test > worst.get(int(views[row]), (0, 0.0))[1]:
            worst[int(views[row])] = (row, float(test))
    return list(worst.values())


def _rejected(group: Group, dropped: Sequence[tuple[int, float]]) -> Table:
    rows = [row for row, _ in dropped]
    keys = group.observations.keys
    return Table(
        {
            "image": np.array([keys["image"][i] for i in rows], dtype=str),
            "target": np.array([keys["target"][i] for i in rows], dtype=str),
            "u": group.observations.readings[0, rows],
            "v": group.observations.readings[1, rows],
            "w": np.array([test for _, test in dropped], dtype=float),
        },
        {"u": "px", "v": "px"},
    )


def root_mean_square(values: Array) -> float:
    """Return the root mean square length of image residuals (2, n), in their unit, a point counting once."""
    return float(np.sqrt((values**2).sum(axis=0).mean())) if values.size else float("nan")


def residual_table(residuals: Residuals, group: Group) -> Table:
    """Return /residuals: a row for each coordinate of each reading."""
    observations = group.observations
    d, n = observations.readings.shape
    columns: dict[str, npt.NDArray[np.float64] | npt.NDArray[np.str_]] = {
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
        f"image {name}: RMS {value:.3f} px is {value / middle:.1f} times the median of the images; look at it, or leave it out"
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
        for i, t in zip(found.rows[order].astype(int), found.tests[order], strict=True)
    ]
    return [
        f"{len(worst)} readings exceed the outlier bound |w| = {found.critical:.2f}: {_listed(worst, 5)}; `outliers: remove` leaves such readings out"
    ]


def must_converge(solution: Solution) -> None:
    """Raise NotConvergedError unless the adjustment ended well or is undetermined (which the task explains)."""
    if not solution.outcome.good and not solution.undetermined:
        raise NotConvergedError(f"{solution.outcome.value} ({solution.iterations} steps)")
