"""Readings of a calibration: whether its targets and scale bars can be used, and the reason if they cannot."""

from __future__ import annotations

import numpy as np

from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.arrays import Index
from metrocli.errors import InputError, UndeterminedError
from metrocli.instruments import camera
from metrocli.instruments.frames import DistanceBetween
from metrocli.table import Table
from metrocli.tasks.calibrate_camera.problem import CameraProblem
from metrocli.tasks.calibrate_camera.settings import FEWEST, Files, Settings
from metrocli.tasks.shared.images.settings import ESTIMATE
from metrocli.tasks.shared.images.sightings import Needs, Sighted, sightings
from metrocli.tasks.shared.lists import repeated

_STRANGE = "not in the list of targets"
_FEWEST_READINGS = 4
"""Fewest readings that determine the pose of one camera"""
_ON_A_LINE = 1e-9
"""Extent across a line of targets that is rounding, as a share of the extent along it"""


def check_targets(rig: str, sighted: Sighted) -> None:
    """Raise UndeterminedError if the targets that are seen cannot determine the pose of a camera."""
    points = sighted.targets.points[np.unique(sighted.target)]
    if rig == "cmm" and sighted.observations.count < _FEWEST_READINGS:
        raise UndeterminedError(
            f"{sighted.observations.count} readings in all: the pose of a camera needs at least {_FEWEST_READINGS}"
        )
    spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if spread[1] <= _ON_A_LINE * max(spread[0], 1.0):
        raise UndeterminedError(
            f"all {len(points)} targets that are seen lie on one line or at one place: they determine no camera pose\n"
            "  what would determine it: targets spread over a plane or in space; check the columns of the targets file"
        )


def sighted_in(settings: Settings, files: Files) -> Sighted:
    """Return what the images of a job show, one camera or several.

    Raises InputError for readings that contradict the list of targets, and for test lengths that are scale bars too.
    """
    sigma = float("nan") if settings.targets == ESTIMATE else 0.0
    needs = Needs(FEWEST[settings.rig], float("nan") if settings.rig == "network" else sigma, sigma)
    sighted = sightings(settings, files.observations, files.targets, files.images, needs)
    _must_not_be_used(files.test_lengths, files.scale_bars)
    return sighted


def _must_not_be_used(tests: Table | None, bars: Table | None) -> None:
    """Raise InputError if a test length is a scale bar too: a length of the adjustment proves nothing about it."""
    if tests is None or bars is None:
        return
    used = {frozenset(pair) for pair in zip(bars.texts("from"), bars.texts("to"), strict=True)}
    pairs = [frozenset(pair) for pair in zip(tests.texts("from"), tests.texts("to"), strict=True)]
    both = [row for row, pair in enumerate(pairs) if pair in used]
    if both:
        raise InputError(
            tests.faults_at(
                both,
                lambda row: f"the length {' - '.join(sorted(pairs[row]))} is a scale bar of this adjustment too",
                lambda row: "a length either gives the scale or tests it: take it out of one of the two files",
            )
        )


def readings(sighted: Sighted, rig: str) -> Observations:
    """Return the readings; with rig cmm all share one camera pose."""
    observations = sighted.observations
    if rig != "cmm":
        return observations
    return observations.with_index({camera.TAPER: np.zeros(observations.count, dtype=np.intp)})


_LIKE = 2.0
"""Ratio of scale bars to distances of the list beyond which units are doubted"""
_BARS = "scale bars"


def longer_than_listed(problem: CameraProblem) -> float:
    """Return how many times longer scale bars are than the distances of the listed targets; 1 without bars."""
    bars = next((group.observations for group in problem.others if group.name == _BARS), None)
    if bars is None:
        return 1.0
    begin, end = problem.sighted.targets.points[bars.index[camera.TARGET]]
    return float(np.median(bars.readings[0] / np.maximum(np.linalg.norm(end - begin, axis=1), 1e-300)))


def units_doubted(size: float) -> tuple[str, ...]:
    """Return that scale bars and list may differ in their unit, if the bars are so many times longer than listed."""
    if 1 / _LIKE < size < _LIKE:
        return ()
    return (
        f"by its scale bars the network has {size:.3g} times the size of the list of targets: check the units of "
        "both, unless the list has no scale of its own",
    )


def scale_bars(bars: Table | None, names: tuple[str, ...], seen: Index) -> list[Group]:
    """Return the group of calibrated distances [mm] between targets; an empty list without scale bars.

    Raises InputError if a bar ends at a target that fewer than two images show, or has no positive length and sigma.
    """
    if bars is None:
        return []
    index = ends_of(bars, names, seen, "scale bar")
    observations = Observations(
        bars.numbers("length")[None],
        bars.numbers("sigma")[None],
        {camera.TARGET: index},
        keys={"from": tuple(bars.texts("from")), "to": tuple(bars.texts("to"))},
        components=("length",),
        unit="mm",
    )
    return [Group(_BARS, Chain((DistanceBetween(camera.TARGET),)), observations)]


def ends_of(lengths: Table, names: tuple[str, ...], seen: Index | None, what: str) -> Index:
    """Return the targets at both ends of calibrated lengths, (2, n).

    Raises InputError as `scale_bars`; `what` names a length in its messages. Without `seen` no images are needed.
    """
    place = {name: i for i, name in enumerate(names)}
    ends = [lengths.texts("from"), lengths.texts("to")]
    wrong = [
        (row, f"{what} end '{name}' is {'seen in fewer than two images' if name in place else _STRANGE}")
        for column in ends
        for row, name in enumerate(column)
        if name not in place or (seen is not None and seen[place[name]] < 2)
    ]
    wrong += [
        (row, f"the {what} is from '{end}' to itself")
        for row, (end, other) in enumerate(zip(*ends, strict=True))
        if end == other
    ]
    wrong += [
        (row, f"a second {what} between '{ends[0][row]}' and '{ends[1][row]}': the list has it in row {before + 1}")
        for row, before in repeated(zip(*ends, strict=True))
    ]
    for name in ("length", "sigma"):
        wrong += [
            (int(row), f"the {name} of the {what} is not above zero")
            for row in np.flatnonzero(lengths.numbers(name) <= 0)
        ]
    faults = [lengths.fault_at(row, text) for row, text in wrong]
    if faults:
        raise InputError(faults)
    return np.array([[place[name] for name in column] for column in ends], dtype=np.intp)
