"""How the artefact stood in each view according to the readings, against what the job says.

An affine fit of the readings of a view to its balls is, but for errors far below a pitch, one of the 48 matrices that
bring the grid onto itself. A rotation that is not the declared one is a wrong sense or a swapped view; a reflection an
exchange of indices. So all alternatives are tried at once, and the one that the readings fit is named.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from metrocli.adjust.blocks import Array
from metrocli.adjust.observations import Mask
from metrocli.errors import Fault, InputError
from metrocli.instruments.ball_grid import View
from metrocli.tasks.grid_readings import Readings, ball_name, fault
from metrocli.tasks.grid_settings import shift_in_words, turn_in_words

_OFF = 0.25
"""A reading further than this share of a pitch from its place is another ball's, or wrong"""
_TILT = 0.2
"""Entries of a fit may differ from whole numbers by less than this"""
_MOST = 20


@dataclass(frozen=True)
class Observed:
    """How the artefact stood in a view: a ball b was read near `pitch turn b + origin`."""

    turn: Array
    """(3, 3) of whole numbers, a reflection where indices are exchanged"""
    origin: Array
    """(3,) in pitches"""


def check(readings: Readings, pitch: float) -> list[str]:
    """Return warnings; InputError names every view that stood otherwise than declared, and readings of other balls."""
    found = [_observed(readings, n, pitch) for n in range(len(readings.views))]
    file = readings.table.file
    exchanged = _exchanged(readings.views, found)
    if exchanged:
        raise InputError([Fault(text, file) for text in exchanged])
    faults = _otherwise(readings.views, found)
    if faults:
        raise InputError([Fault(text, file) for text in faults])
    astray = [one for n, seen in enumerate(found) if seen for one in _astray(readings, n, pitch)]
    if astray:
        raise InputError(astray[:_MOST])
    return _off_site(readings.views, found)


def _observed(readings: Readings, view: int, pitch: float) -> Observed | None:
    """Return how a view stood; None where its balls do not span space or fit no matrix of whole numbers."""
    rows = readings.at(view)
    balls, values = readings.balls[rows].astype(float), readings.values[rows] / pitch
    keep: Mask = np.ones(len(balls), dtype=bool)
    for _ in range(3):
        design = np.column_stack([balls, np.ones(len(balls))])
        if np.linalg.matrix_rank(design[keep]) < 4:
            return None
        fit = np.linalg.lstsq(design[keep], values[keep], rcond=None)[0]
        off = np.abs(values - design @ fit).max(axis=1)
        keep = off <= max(2 * float(np.median(off)), 1e-9)
    turn = np.rint(fit[:3].T)
    whole = np.abs(fit[:3].T - turn).max() < _TILT and np.array_equal(turn @ turn.T, np.eye(3))
    if not whole:
        return None
    return Observed(turn, np.median(values - balls @ turn.T, axis=0))


def _exchanged(views: tuple[View, ...], found: list[Observed | None]) -> list[str]:
    """Return the views whose indices are exchanged: the readings fit a reflection."""
    mirrored = {
        view.name: np.rint(view.turn.T @ seen.turn)
        for view, seen in zip(views, found, strict=True)
        if seen is not None and np.linalg.det(seen.turn) < 0
    }
    kinds = {matrix.tobytes() for matrix in mirrored.values()}
    if len(mirrored) > 1 and len(kinds) == 1 and len(mirrored) == sum(seen is not None for seen in found):
        return [f"in all views {_exchange(next(iter(mirrored.values())))}"]
    return [f"in view '{name}' {_exchange(matrix)}" for name, matrix in mirrored.items()]


def _exchange(matrix: Array) -> str:
    names = "ijk"
    order = [int(np.argmax(np.abs(row))) for row in matrix]
    swapped = [n for n in range(3) if order[n] != n]
    if len(swapped) == 2 and matrix.sum() == 3:
        pair = f"{names[swapped[0]]} and {names[swapped[1]]}"
        return f"{pair} are exchanged: the readings fit the balls the other way round"
    flipped = [names[n] for n in range(3) if order[n] == n and matrix[n, n] < 0]
    if not swapped:
        return f"{' and '.join(flipped)} counts against its axis: the readings fit balls of the opposite sign"
    seen = ", ".join(f"{'-' if matrix[n, order[n]] < 0 else ''}{names[order[n]]}" for n in range(3))
    return f"the readings fit a mirrored artefact, i, j, k read as {seen}"


def _otherwise(views: tuple[View, ...], found: list[Observed | None]) -> list[str]:
    """Return what is wrong with the views that stood otherwise than declared, as rotations and as shifts."""
    known = [(n, seen) for n, seen in enumerate(found) if seen is not None]
    right = [(n, seen) for n, seen in known if np.array_equal(seen.turn, views[n].turn)]
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
            f"view '{view.name}' stands shifted by {shift_in_words(shift)} pitches against the others, "
            f"declared {shift_in_words(view.shift)}{like}"
        )
    sense = "; is the sense of its rotation wrong?" if np.array_equal(turn, view.turn.T) else ""
    return f"view '{view.name}' stands {turn_in_words(turn)}, declared {turn_in_words(view.turn)}{like}{sense}"


def _astray(readings: Readings, n: int, pitch: float) -> list[Fault]:
    """Return the readings that are not where their ball stands, with the ball that stands there."""
    rows = np.flatnonzero(readings.at(n))
    turn = readings.views[n].turn
    place = readings.values[rows] / pitch - readings.balls[rows] @ turn.T
    off = place - np.median(place, axis=0)
    faults = []
    for k in np.flatnonzero(np.abs(off).max(axis=1) > _OFF)[:_MOST]:
        ball, row = readings.balls[rows[k]], int(rows[k])
        nearest = np.rint(ball + off[k] @ turn).astype(np.intp)
        distance = float(np.linalg.norm(off[k])) * pitch
        meant = f", where {ball_name(nearest)} stands" if not np.array_equal(nearest, ball) else ""
        text = f"{ball_name(ball)} of view '{readings.views[n].name}' is read {distance:.3g} mm from its place{meant}"
        faults.append(fault(readings.table, row, text))
    return faults


def _off_site(views: tuple[View, ...], found: list[Observed | None]) -> list[str]:
    """Return warnings of views that stand so far from their sites that the machine error there is another one."""
    known = [(view, seen) for view, seen in zip(views, found, strict=True) if seen is not None]
    if not known:
        return []
    origins = np.array([seen.origin - view.shift for view, seen in known])
    off = np.abs(origins - np.median(origins, axis=0)).max(axis=1)
    return [
        f"view '{view.name}' stands {share:.2g} pitches from its sites: the machine error there is not that at the site"
        for (view, _), share in zip(known, off.tolist(), strict=True)
        if share > 0.05
    ]
