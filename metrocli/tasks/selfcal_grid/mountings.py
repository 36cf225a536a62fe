"""Check how the artefact stood in each view: the readings against the declaration in the job.

An affine fit of the readings of a view to its balls gives one of the 48 matrices that bring the grid onto itself, apart
from a tilt and errors far below a pitch. A rotation other than the declared one points to a wrong sense or to swapped
views. A reflection points to exchanged indices. The message names the mounting that the readings fit.
Balls in one plane do not show the side of the artefact: the fit takes a rotation, never a reflection across the plane.
"""

from __future__ import annotations

from itertools import permutations, product

import numpy as np

from metrocli.arrays import Array, Index, Mask
from metrocli.errors import Fault, InputError
from metrocli.frozen import dataclass
from metrocli.instruments.ball_grid import View
from metrocli.tasks.selfcal_grid.readings import GridReadings, ball_name
from metrocli.tasks.selfcal_grid.settings import shift_in_words, turn_in_words

_OFF = 0.25
"""Largest distance of a reading from its place, in pitches: one farther away belongs to another ball or is wrong"""
_TILT = 0.2
"""Largest difference of a fitted entry from a whole number; few balls near each other may differ by more"""
_DOUBTFUL = 0.005
"""Warn if the distance of neighbouring balls differs from the pitch by more than this share"""
_OFF_SITE = 0.05
_MOST = 20
_ONTO_ITSELF = tuple(
    np.eye(3)[list(order)] * np.array(signs)[:, None]
    for order in permutations(range(3))
    for signs in product((1.0, -1.0), repeat=3)
)
"""The 48 matrices that bring the grid onto itself"""


@dataclass(frozen=True)
class Observed:
    """How the artefact stood in a view: the reading of ball b is near `pitch (scale (turn + tilt) b + origin)`."""

    turn: Array
    """(3, 3) of whole numbers, a reflection where indices are exchanged"""
    tilt: Array
    """(3, 3)"""
    scale: float
    origin: Array
    """(3,) in pitches"""

    def off(self, balls: Index, values: Array) -> Array:
        """Return the differences of readings (n, 3) from the fitted places of their balls, in pitches."""
        place = values - self.scale * balls @ (self.turn + self.tilt).T
        return np.asarray(place - np.median(place, axis=0))


def check(readings: GridReadings, pitch: float) -> list[str]:
    """Return warnings on the pitch and on views far from their sites.

    Raises InputError if a view stood otherwise than declared, and for readings that belong to another ball.
    """
    observed = [_observed(readings, n, pitch) for n in range(len(readings.views))]
    file = readings.table.file
    for faults in (
        _other_pitch(readings, observed, pitch),
        _exchanged(readings.views, observed),
        _otherwise(readings.views, observed),
    ):
        if faults:
            raise InputError([Fault(text, file) for text in faults])
    astray = [fault for n, seen in enumerate(observed) if seen for fault in _astray(readings, n, seen, pitch)]
    if astray:
        raise InputError(astray[:_MOST])
    return [*_doubtful_pitch(observed, pitch), *_off_site(readings, observed)]


def _observed(readings: GridReadings, view: int, pitch: float) -> Observed | None:
    """Return how the artefact stood in a view, or None if its balls stand in a row or are too few."""
    rows = readings.at(view)
    balls, values = readings.balls[rows].astype(float), readings.values[rows] / pitch
    keep: Mask = np.ones(len(balls), dtype=bool)
    for _ in range(3):
        if np.linalg.matrix_rank(balls[keep] - balls[keep].mean(axis=0)) < 2:
            return None
        matrix = _affine(balls[keep], values[keep])
        place = values - balls @ matrix.T
        off = np.abs(place - np.median(place[keep], axis=0)).max(axis=1)
        keep = off <= max(2 * float(np.median(off)), 1e-9)
    scale = float(np.linalg.svd(matrix, compute_uv=False).mean())
    # the nearest of the 48 matrices that bring the grid onto itself
    turn = max(_ONTO_ITSELF, key=lambda turn: float((turn * (matrix / scale)).sum()))
    return Observed(turn, matrix / scale - turn, scale, np.median(values - balls @ turn.T, axis=0))


def _affine(balls: Array, values: Array) -> Array:
    """Return the matrix (3, 3) that maps balls (n, 3) to values apart from a shift.

    For balls in one plane the third direction is that of a rotation.
    """
    inner = balls - balls.mean(axis=0)
    fit = np.asarray(np.linalg.lstsq(inner, values - values.mean(axis=0), rcond=None)[0].T)
    _, sizes, axes = np.linalg.svd(inner, full_matrices=False)
    if sizes[2] > 1e-9 * sizes[0]:
        return fit
    images = fit @ axes[:2].T
    length = np.sqrt(np.linalg.norm(images[:, 0]) * np.linalg.norm(images[:, 1]))
    across = np.cross(images[:, 0], images[:, 1]) / max(float(length), 1e-300)
    return np.asarray(fit + np.outer(across, np.cross(axes[0], axes[1])))


def _other_pitch(readings: GridReadings, observed: list[Observed | None], pitch: float) -> list[str]:
    """Return the faults of views whose readings do not form a grid of this pitch; one fault if no view does."""
    several = [
        f"the readings of view '{view.name}' fit no grid: half of them are more than {_OFF:g} pitches off; "
        "the view may have readings of two set-ups"
        for n, (view, seen) in enumerate(zip(readings.views, observed, strict=True))
        if seen is not None and _half_off(readings, n, seen, pitch) > _OFF
    ]
    if several:
        return several
    known = [(view.name, seen) for view, seen in zip(readings.views, observed, strict=True) if seen is not None]
    reach = [_reach(readings.balls[readings.at(n)]) for n, seen in enumerate(observed) if seen is not None]
    wrong = {
        f" of view '{name}'": seen.scale * pitch
        for (name, seen), far in zip(known, reach, strict=True)
        if abs(seen.scale - 1) * far > _OFF
    }
    if len(wrong) == len(known) > 1:
        wrong = {"": float(np.median(list(wrong.values())))}
    texts = [
        f"the balls{whose} are read {apart:.5g} mm apart, the pitch is {pitch:g} mm: "
        "is the pitch or a unit of the file wrong?"
        for whose, apart in wrong.items()
    ]
    skew = [
        name
        for (name, seen), far in zip(known, reach, strict=True)
        if (tilt := float(np.abs(seen.tilt).max())) > _TILT and tilt * far > 2 * _OFF
    ]
    return texts or [f"the readings of view '{name}' do not fit a grid turned by a multiple of 90 deg" for name in skew]


def _half_off(readings: GridReadings, n: int, seen: Observed, pitch: float) -> float:
    """Return how far half of the readings of a view are from the fitted places of their balls, in read pitches."""
    rows = readings.at(n)
    off = np.abs(seen.off(readings.balls[rows], readings.values[rows] / pitch)).max(axis=1)
    return float(np.median(off)) / max(seen.scale, 1e-12)


def _reach(balls: Index) -> float:
    """Return the distance of the outermost ball from the mean of all balls, in pitches."""
    return float(np.linalg.norm(balls - balls.mean(axis=0), axis=1).max())


def _doubtful_pitch(observed: list[Observed | None], pitch: float) -> list[str]:
    scales = [seen.scale for seen in observed if seen is not None]
    scale = float(np.median(scales)) if scales else 1.0
    if abs(scale - 1) < _DOUBTFUL:
        return []
    return [
        f"the balls are read {scale * pitch:.5g} mm apart, the pitch is {pitch:g} mm: the machine error and the "
        "artefact error share the difference"
    ]


def _exchanged(views: tuple[View, ...], observed: list[Observed | None]) -> list[str]:
    """Return the faults of exchanged indices or axes, common to all views, or of mirrored readings in single views."""
    known = [(view, seen) for view, seen in zip(views, observed, strict=True) if seen is not None]
    for names, matrices in (
        # exchanged indices act before the turn of the view, exchanged axes behind it
        ("ijk", [view.turn.T @ seen.turn for view, seen in known]),
        ("xyz", [view.turn @ seen.turn.T for view, seen in known]),
    ):
        alike = len(known) > 1 and all(np.array_equal(matrix, matrices[0]) for matrix in matrices)
        if alike and not np.array_equal(matrices[0], np.eye(3)):
            return [f"in all views {_exchange(matrices[0], names)}"]
    return [
        f"in view '{view.name}' {_exchange(view.turn.T @ seen.turn, 'ijk')}"
        for view, seen in known
        if np.linalg.det(seen.turn) < 0
    ]


def _exchange(matrix: Array, names: str) -> str:
    order = [int(np.argmax(np.abs(row))) for row in matrix]
    swapped = [n for n in range(3) if order[n] != n]
    if len(swapped) == 2 and matrix.sum() == 3:
        pair = f"{names[swapped[0]]} and {names[swapped[1]]}"
        return f"{pair} are exchanged: the readings fit the balls the other way round"
    flipped = [names[n] for n in range(3) if order[n] == n and matrix[n, n] < 0]
    if len(flipped) in (1, 3) and not swapped:
        verb = "counts against its axis" if len(flipped) == 1 else "count against their axes"
        return f"{' and '.join(flipped)} {verb}: the readings fit balls of the opposite sign"
    seen = ", ".join(f"{'-' if matrix[n, order[n]] < 0 else ''}{names[order[n]]}" for n in range(3))
    artefact = "a mirrored artefact" if np.linalg.det(matrix) < 0 else "the artefact"
    return f"the readings fit {artefact} with {', '.join(names)} read as {seen}"


def _otherwise(views: tuple[View, ...], observed: list[Observed | None]) -> list[str]:
    """Return the faults of views that stood otherwise than declared: another rotation, shift, or swapped views."""
    known = [(n, seen) for n, seen in enumerate(observed) if seen is not None]
    right = [(n, seen) for n, seen in known if np.array_equal(seen.turn, views[n].turn)]
    # views that stood turned as declared show the common origin: a wrong one may have been moved as well
    origins = np.array([seen.origin - views[n].shift for n, seen in (right or known)])
    common = np.median(origins, axis=0) if len(origins) else np.zeros(3)
    stood = {n: (seen.turn, np.rint(seen.origin - common)) for n, seen in known}
    wrong = [n for n in stood if not _as(views[n], stood[n])]
    texts = []
    for n in wrong:
        others = [m for m in range(len(views)) if m != n and _as(views[m], stood[n])]
        swapped = [m for m in others if m in wrong and _as(views[n], stood[m])]
        if swapped and swapped[0] > n:
            texts.append(
                f"views '{views[n].name}' and '{views[swapped[0]].name}' are exchanged: "
                "the readings of each stand as the other is declared"
            )
        elif not swapped:
            texts.append(_stood(views, n, stood[n], others))
    return texts


def _as(view: View, stood: tuple[Array, Array]) -> bool:
    return np.array_equal(view.turn, stood[0]) and np.array_equal(view.shift, stood[1])


def _stood(views: tuple[View, ...], n: int, stood: tuple[Array, Array], others: list[int]) -> str:
    view, (turn, shift) = views[n], stood
    like = f", which is how view '{views[others[0]].name}' is declared" if others else ""
    if np.array_equal(turn, view.turn):
        return (
            f"view '{view.name}' stands shifted by {shift_in_words(shift)} pitches relative to the others, "
            f"declared {shift_in_words(view.shift)}{like}"
        )
    sense = "; is the sense of its rotation wrong?" if np.array_equal(turn, view.turn.T) else ""
    return f"view '{view.name}' stands {turn_in_words(turn)}, declared {turn_in_words(view.turn)}{like}{sense}"


def _astray(readings: GridReadings, n: int, seen: Observed, pitch: float) -> list[Fault]:
    """Return the faults of readings far from their ball, each with the ball that is nearest to the reading."""
    rows, view = np.flatnonzero(readings.at(n)), readings.views[n]
    off = seen.off(readings.balls[rows], readings.values[rows] / pitch)
    faults = []
    for k in np.flatnonzero(np.abs(off).max(axis=1) > _OFF)[:_MOST]:
        ball, row = readings.balls[rows[k]], int(rows[k])
        nearest = np.rint(ball + off[k] @ view.turn).astype(np.intp)
        distance = float(np.linalg.norm(off[k])) * pitch
        other = not np.array_equal(nearest, ball) and (readings.balls == nearest).all(axis=1).any()
        meant = f", where {ball_name(nearest)} stands" if other else ""
        text = f"{ball_name(ball)} of view '{view.name}' is read {distance:.4g} mm from its place{meant}"
        faults.append(readings.table.fault_at(row, text))
    return faults


def _off_site(readings: GridReadings, observed: list[Observed | None]) -> list[str]:
    """Return warnings of views with balls so far from their sites that the machine error differs there."""
    known = [(n, seen) for n, seen in enumerate(observed) if seen is not None]
    if not known:
        return []
    origins = np.array([seen.origin - readings.views[n].shift for n, seen in known])
    texts = []
    for (n, seen), origin in zip(known, (origins - np.median(origins, axis=0)), strict=True):
        share = float(np.abs(readings.balls[readings.at(n)] @ seen.tilt.T + origin).max())
        if share > _OFF_SITE:
            texts.append(
                f"view '{readings.views[n].name}' stands up to {share:.2g} pitches from its sites: the machine error "
                "there differs from that at the sites"
            )
    return texts
