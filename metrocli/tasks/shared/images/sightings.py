"""Sightings: image points of targets, read from a table or found in images, and joined to the list of targets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from metrocli.adjust.model.observations import Observations
from metrocli.arrays import Array, Index, Mask
from metrocli.errors import Fault, InputError, UndeterminedError
from metrocli.frozen import dataclass
from metrocli.imageset import ImageSet
from metrocli.table import Table
from metrocli.targets.pattern import CORNERS, Pattern
from metrocli.tasks.shared.images.eccentricity import SIZE
from metrocli.tasks.shared.images.search import shown_board, sight
from metrocli.tasks.shared.images.settings import ImageSettings
from metrocli.tasks.shared.images.target_list import TargetCoordinates, known_targets
from metrocli.words import counted, listed

START_NOISE = 0.1
"""Starting value of the noise [px] if it is estimated"""

_BEYOND = 0.01
"""How far beyond the border a reading may lie, as a share of the image size"""
_MANY = 0.25
"""If a larger share of the readings lies outside, the file is refused; a smaller share may be gross errors"""
_EXCHANGED = 0.02
"""A smaller share of readings outside is not a sign of exchanged columns: these put a strip of the image outside"""
_MOST_LOST = 1 / 3
"""Largest share of the images that is left out with a warning"""


@dataclass(frozen=True)
class Needs:
    """What a job needs of its sightings."""

    fewest: int
    """Targets that an image must show"""
    unknown_sigma: float = 0.0
    """Standard deviation [mm] of targets in a list without a sigma column; nan: unknown"""
    of_pattern: float = 0.0
    """Standard deviation [mm] of the targets of a pattern without a list; nan: unknown"""


@dataclass(frozen=True)
class Sighted:
    """Image points of known targets, ready for an adjustment."""

    images: tuple[str, ...]
    targets: TargetCoordinates
    observations: Observations
    warnings: tuple[str, ...] = ()
    eccentric: bool = False
    """Whether the readings are centres of ellipses that must be corrected for eccentricity"""

    @property
    def view(self) -> Index:
        """Image of each reading."""
        return self.observations.index["view"]

    @property
    def target(self) -> Index:
        """Target of each reading."""
        return self.observations.index["target"]


def sightings(
    settings: ImageSettings, observations: Table | None, targets: Table | None, images: ImageSet | None, needs: Needs
) -> Sighted:
    """Return the readings, from a table or found in images, joined to their targets.

    Raises InputError for faults in the tables, and UndeterminedError if no image shows enough targets.
    """
    warnings: tuple[str, ...] = ()
    pattern = settings.pattern
    if images is not None and pattern is not None:
        observations, warnings = sight(images, pattern)
    if observations is None:
        raise InputError("there are neither observations nor images")
    known = known_targets(pattern, targets, needs.unknown_sigma, needs.of_pattern)
    noise = START_NOISE if isinstance(settings.noise, str) else settings.noise
    sighted = join(observations, known, noise, needs.fewest)
    if not sighted.images:
        raise UndeterminedError(
            f"no image shows {needs.fewest} or more targets of the list, so nothing can be determined"
        )
    sighted = replace(sighted, warnings=warnings + sighted.warnings)
    _refuse_few(sighted, images.names if images is not None else observations.texts("image"), pattern, images)
    eccentric = _eccentric(settings, sighted, measured=images is not None)
    return replace(sighted, eccentric=eccentric)


def _refuse_few(sighted: Sighted, names: Sequence[str], pattern: Pattern | None, images: ImageSet | None) -> None:
    """Raise InputError if more than a third of the images would be left out: the job does not describe them.

    A wrong size of the pattern otherwise gives a result from the few images that happen to fit it.
    """
    lost, whole = sorted(set(names) - set(sighted.images)), len(set(names))
    if len(lost) <= _MOST_LOST * whole:
        return
    text = f"{len(lost)} of {whole} images cannot be used, more than a third: {listed(lost, 5)}"
    size = shown_board(pattern, images, lost) if pattern is not None and images is not None else ""
    raise InputError([Fault(text + size, hint="; ".join(sighted.warnings[:3]))])


def placed(sighted: Sighted, least: Index) -> Sighted:
    """Return the sightings of targets that at least `least` (targets,) images show; a warning names the others.

    Raises UndeterminedError if no target is left.
    """
    seen = np.bincount(sighted.target, minlength=len(least))
    lost = [name for name, n, needed in zip(sighted.targets.names, seen, least, strict=True) if 0 < n < needed]
    if not lost:
        return sighted
    if not (seen >= least)[sighted.target].any():
        raise UndeterminedError(
            f"all {len(lost)} targets that are seen have unknown coordinates, and one image only shows each of them\n"
            "  what would determine them: the same targets in two images or more from different directions"
        )
    line = f"left out: {counted(len(lost), 'target', 'are')} seen in one image only, which places none: {listed(lost)}"
    observations = sighted.observations.selected((seen >= least)[sighted.target])
    return replace(sighted, observations=observations, warnings=(*sighted.warnings, line))


def _eccentric(settings: ImageSettings, sighted: Sighted, measured: bool) -> bool:
    """Return whether eccentricity has to be corrected; `measured`: the readings were found in images.

    Raises InputError if the job asks for the correction and a radius is missing.
    """
    known = bool(np.isfinite(sighted.observations.conditions["radius"]).all())
    if settings.eccentricity == "correct" and not known:
        raise InputError(
            "eccentricity: correct needs the radius of every target: "
            "a column radius_mm in the targets file, or the pattern's diameter"
        )
    circular = settings.pattern is not None and settings.pattern.type not in CORNERS
    automatic = settings.eccentricity == "auto" and measured and circular
    return known and (settings.eccentricity == "correct" or automatic)


def join(table: Table, targets: TargetCoordinates, sigma: float, fewest: int) -> Sighted:
    """Match readings to targets; leave out images with fewer than `fewest` readings, with a warning.

    `sigma` is the standard deviation [px] of readings without one of their own. Raises InputError that names every
    reading whose target is not in the list.
    """
    of_target, target = _matched(table, targets)
    of_image = np.asarray(table.columns["image"], dtype=str)
    images, view, counts = np.unique(of_image, return_inverse=True, return_counts=True)
    enough = counts >= fewest
    keep = enough[view]
    warnings = [
        f"image {images[i]} has {counts[i]} targets, fewer than {fewest}: left out" for i in np.flatnonzero(~enough)
    ]
    unseen = np.flatnonzero(np.bincount(target[keep], minlength=len(targets.names)) == 0)
    if unseen.size:
        names = listed([targets.names[i] for i in unseen])
        warnings.append(f"{counted(unseen.size, 'target')} of the list seen in no image: {names}")
    spread = table.numbers("sigma", sigma)
    _refuse(table, spread <= 0, "the standard deviation of an image point is not above zero")
    # numbers of the images that are kept, without gaps
    numbers = np.cumsum(enough) - 1
    conditions = {name: values[keep] for name, values in table.conditions("t", "temp", SIZE).items()}
    observations = Observations(
        readings=table.stacked(("u", "v")).T[:, keep],
        sigma=np.broadcast_to(spread, (2, len(spread)))[:, keep],
        index={"view": numbers[view[keep]], "target": target[keep]},
        keys={"image": tuple(of_image[keep].tolist()), "target": tuple(of_target[keep].tolist())},
        conditions={**conditions, "radius": targets.radius[target[keep]]},
        components=("u", "v"),
        unit="px",
    )
    return Sighted(tuple(images[enough].tolist()), targets, observations, tuple(warnings))


def check_inside(sighted: Sighted, size: Array) -> Sighted:
    """Return the sightings, with a warning if a few readings lie outside the image; `size` is (2, n) px.

    Raises InputError if many do, if one is farther outside than the image is large, or if not few do and all would lie
    inside with u and v exchanged.
    """
    uv = sighted.observations.readings
    extent = np.broadcast_to(size, uv.shape)
    outside = ((uv < -_BEYOND * extent) | (uv > (1 + _BEYOND) * extent)).any(axis=0)
    if not outside.any():
        return sighted
    # a reading a whole image away is never seen: one is enough to show a mistake in the file
    far = ((uv < -extent) | (uv > 2 * extent)).any(axis=0)
    i = int(np.flatnonzero(far if far.any() else outside)[0])
    keys = sighted.observations.keys
    which = "one of them far" if far.any() else "the first"
    message = (
        f"{outside.sum()} of {outside.size} readings lie outside an image of {extent[0, i]:g} x {extent[1, i]:g} px, "
        f"{which}: image {keys['image'][i]}, target {keys['target'][i]} at ({uv[0, i]:.1f}, {uv[1, i]:.1f}); "
        "check image_size and the columns"
    )
    few = outside.mean() < _EXCHANGED
    exchanged = not few and ((uv >= -_BEYOND * extent[::-1]) & (uv <= (1 + _BEYOND) * extent[::-1])).all()
    if exchanged:
        raise InputError(f"{message}; with u and v exchanged all would lie inside")
    if outside.mean() > _MANY or far.any():
        raise InputError(message)
    return replace(sighted, warnings=(*sighted.warnings, message))


def _matched(table: Table, targets: TargetCoordinates) -> tuple[np.ndarray[tuple[int], np.dtype[np.str_]], Index]:
    """Return the name of each reading's target and its number in the list; raises InputError for unknown targets."""
    place = {name: i for i, name in enumerate(targets.names)}
    of_target = np.asarray(table.columns["target"], dtype=str)
    names, which = np.unique(of_target, return_inverse=True)
    numbers = np.array([place.get(str(name), -1) for name in names], dtype=np.intp)[which]
    unmatched = np.flatnonzero(numbers < 0)
    if unmatched.size:
        hint = "add it to the targets file, or remove the row"
        text = "target '{}' is not in the list of targets".format
        raise InputError(table.faults_at(unmatched, lambda row: text(of_target[row]), lambda row: hint))
    return of_target, numbers


def _refuse(table: Table, rows: Mask, text: str) -> None:
    """Raise InputError with this text for each of the rows, if there are any."""
    if rows.any():
        raise InputError(table.faults_at(np.flatnonzero(rows), lambda row: text))
