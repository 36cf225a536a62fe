"""Order of the points of a flat board: found from their positions alone, and checked wherever it comes from.

Method: docs/algorithms/target-detection.md.
"""

from __future__ import annotations

from collections import deque
from itertools import product

import numpy as np
import numpy.typing as npt

from metrocli.arrays import Array
from metrocli.targets.homography import homography, projected, seen_by_a_lens

Whole = npt.NDArray[np.int64]

NEAR = 0.3
"""A neighbour must be within this share of a step from its expected position."""
GATE = 0.2
"""Largest root mean square distance from a view of the board, in steps of the lattice; real lenses stay below it."""
BENT = 0.25
"""Largest distance of a point from the middle of its two neighbours, in steps; 0.33 where a row between is missing"""
UNORDERED = "the order of the points is not that of a flat board"
FEWEST = 0.75
"""Share of a board's points that must be found."""


def order_fault(steps: Whole, uv: Array) -> str:
    """Return why the points (n, 2) cannot be at these places (n, 2) of a flat lattice; empty if they can.

    Two tests that images of any real lens pass: the points fit a homography and smooth distortion within 0.2 steps
    (root mean square), and each point between two neighbours is within 0.25 steps of their middle.
    """
    if len(set(map(tuple, steps.tolist()))) < len(steps):
        return "two points have one place"
    if len(uv) < 4:
        return "fewer than four points"
    step = _step(steps, uv)
    plane = steps.astype(float)
    off = seen_by_a_lens(plane, uv, plane) - uv
    rms = float(np.sqrt(np.mean(np.sum(off**2, axis=1))))
    if not rms < GATE * step:
        return f"{UNORDERED} ({rms:.1f} px from a view of it, steps of {step:.1f} px)"
    # perspective moves points of a coarse board off the middle, a fisheye the homography of a fine one
    bend = min(_bend(steps, uv, uv), _bend(steps, uv, projected(homography(plane, uv), plane) - uv))
    if bend > BENT:
        return f"{UNORDERED} (a point is {bend:.2f} steps off its neighbours' middle)"
    return ""


def ordered(expected: Whole, uv: Array) -> tuple[Whole, str]:
    """Find which of the points `uv` (m, 2) is at which expected place (n, 2) of a flat lattice.

    Returns the row in `uv` for each place (n,), -1 if the place is empty, and the reason if no order is found. If
    several orders fit (a symmetric board), the most upright one in the image is taken.
    """
    members, steps = largest(uv, len(expected))
    if len(members) < max(4, FEWEST * len(expected)):
        return np.full(len(expected), -1), f"{len(members)} points lie on a lattice, {len(expected)} are expected"
    fits = _alignments(expected, members, steps)
    fits = [fit for fit in fits if not order_fault(expected[fit >= 0], uv[fit[fit >= 0]])]
    if len({frozenset(fit.tolist()) for fit in fits}) > 1:
        return np.full(len(expected), -1), "the pattern fits in several places of a larger lattice"
    fit = _most_upright(expected, uv, fits)
    if fit is None:
        return np.full(len(expected), -1), "the points found do not have the outline of the pattern"
    return fit, ""


def largest(uv: Array, enough: int) -> tuple[Whole, Whole]:
    """Return the rows of the points (m, 2) that lie on the largest lattice, and their places in whole steps.

    Seeds near the middle are tried until a lattice has `enough` points.
    """
    best = np.empty(0, np.int64), np.empty((0, 2), np.int64)
    for seed in np.asarray(np.argsort(np.linalg.norm(uv - np.median(uv, axis=0), axis=1))[:8]):
        grown = _grown(uv, seed)
        if len(grown[0]) > len(best[0]):
            best = grown
        if len(best[0]) >= enough:
            break
    return best


def upright(shape: tuple[int, int], uv: Array) -> Whole | None:
    """Return the rows (rows * columns,) of points listed row by row, or from another corner, upright in the image.

    None if the points (rows * columns, 2) do not lie on a flat lattice in that order.
    """
    expected, listed = np.indices(shape)[::-1].reshape(2, -1).T, np.arange(len(uv)).reshape(shape)
    if order_fault(expected, uv):
        return None
    faces = [listed, listed.T] if shape[0] == shape[1] else [listed]
    turns = [face[::down, ::right].ravel() for face in faces for down in (1, -1) for right in (1, -1)]
    return _most_upright(expected, uv, turns)


def _most_upright(expected: Whole, uv: Array, fits: list[Whole]) -> Whole | None:
    """Return the fit with x most to the right and y most down in the image; None where all are mirror images."""
    score = [_uprightness(expected, uv, fit) for fit in fits]
    return fits[int(np.argmax(score))] if max(score, default=-np.inf) > -np.inf else None


def _pairs(steps: Whole, by: tuple[int, int]) -> tuple[Whole, Whole]:
    """Return the pairs of rows a and b with steps[b] = steps[a] + by."""
    place = {tuple(step): row for row, step in enumerate(steps.tolist())}
    pairs = [(row, place.get((x + by[0], y + by[1]))) for (x, y), row in place.items()]
    rows = np.array([(a, b) for a, b in pairs if b is not None], dtype=np.int64).reshape(-1, 2)
    return rows[:, 0], rows[:, 1]


_STEPS = ((1, 0), (0, 1), (1, 1), (1, -1))
"""Directions to neighbours: rows, columns and both diagonals."""


def _step(steps: Whole, uv: Array) -> float:
    """Return the median distance of neighbours in the image [px], in the lattice direction where it is shortest."""
    lengths = []
    for by in _STEPS:
        a, b = _pairs(steps, by)
        if len(a):
            lengths.append(float(np.median(np.linalg.norm(uv[b] - uv[a], axis=1))))
    return min(lengths, default=0.0)


def _bend(steps: Whole, uv: Array, off: Array) -> float:
    """Return the largest difference of `off` (n, 2) from its mean at two opposite neighbours, over half their distance.

    With the image points as `off` it is how far a point is from the middle of two neighbours.
    """
    worst = 0.0
    for by in _STEPS:
        a, b = _pairs(steps, (2 * by[0], 2 * by[1]))
        place = {tuple(step): row for row, step in enumerate(steps.tolist())}
        middle = np.array([place.get((x + by[0], y + by[1]), -1) for x, y in steps[a].tolist()], dtype=np.int64)
        a, b, middle = a[middle >= 0], b[middle >= 0], middle[middle >= 0]
        if len(a):
            away = np.linalg.norm(off[middle] - (off[a] + off[b]) / 2, axis=1)
            worst = max(worst, float((away / (np.linalg.norm(uv[b] - uv[a], axis=1) / 2 + 1e-9)).max()))
    return worst


def _grown(uv: Array, seed: int) -> tuple[Whole, Whole]:
    """Grow a lattice from a seed and return the rows of its points and their places in steps from the seed.

    Each neighbour is expected one local step further; the local steps follow the lattice as perspective changes them.
    """
    empty = np.empty(0, np.int64), np.empty((0, 2), np.int64)
    basis = _basis(uv, seed)
    if basis is None:
        return empty
    place: dict[tuple[int, int], int] = {(0, 0): int(seed)}
    bases = {(0, 0): basis}
    taken = {int(seed)}
    queue = deque([(0, 0)])
    while queue:
        here = queue.popleft()
        for by in ((1, 0), (0, 1), (-1, 0), (0, -1)):
            there = here[0] + by[0], here[1] + by[1]
            step = by @ bases[here]
            away = np.linalg.norm(uv - uv[place[here]] - step, axis=1)
            near = int(np.argmin(away))
            if there in place or near in taken or away[near] > NEAR * np.linalg.norm(step):
                continue
            place[there], bases[there] = near, _updated(bases[here], by, uv[near] - uv[place[here]])
            taken.add(near)
            queue.append(there)
    return np.array(list(place.values())), np.array(list(place.keys())).reshape(-1, 2)


def _basis(uv: Array, seed: int) -> Array | None:
    """Return two steps (2, 2) from the seed to neighbours that have an opposite neighbour too; None without them."""
    offsets = uv - uv[seed]
    order = np.argsort((offsets**2).sum(1))[1:13]
    steps: list[Array] = []
    for row in order:
        step = offsets[row]
        length = float(np.hypot(*step))
        opposite = np.linalg.norm(offsets[order] + step, axis=1).min()
        if length == 0 or opposite > NEAR * length:
            continue
        if steps and abs(steps[0][0] * step[1] - steps[0][1] * step[0]) < 0.3 * length * np.hypot(*steps[0]):
            continue
        # half the way between both neighbours: perspective lengthens one side as much as it shortens the other
        steps.append((step - offsets[order[np.argmin(np.linalg.norm(offsets[order] + step, axis=1))]]) / 2)
        if len(steps) == 2:
            return np.stack(steps)
    return None


def _updated(basis: Array, by: tuple[int, int], step: Array) -> Array:
    """Return the local steps at the next point: the step just taken replaces most of the old one in its direction."""
    axis = 0 if by[0] else 1
    changed = basis.copy()
    # steps change slowly across the image by perspective and lens; one noisy step must not lead astray
    changed[axis] = 0.3 * basis[axis] + 0.7 * step * (by[0] + by[1])
    return changed


_TURNS = tuple(
    np.array(turn).reshape(2, 2)
    for turn in product(range(-2, 3), repeat=4)
    if abs(turn[0] * turn[3] - turn[1] * turn[2]) in (1, 2)
)
"""Changes of basis from the grown lattice to the pattern.

Determinant 1 changes between bases of one lattice. Determinant 2 leads to the finer lattice on which the points of an
asymmetric grid are named."""


def _alignments(expected: Whole, members: Whole, steps: Whole) -> list[Whole]:
    """Return the ways to lay the pattern over the grown lattice that find most points: rows (n,), -1 at empty places.

    Stray points may extend the lattice beyond the pattern. A lattice smaller than the pattern is refused, because the
    missing edge could be on either side.
    """
    outline = expected - expected.min(0)
    size, fits = outline.max(0) + 1, []
    for turn in _TURNS:
        turned = steps @ turn.T
        turned -= turned.min(0)
        if (turned.max(0) + 1 < size).any():
            continue
        place = np.full(turned.max(0) + 1, -1)
        place[tuple(turned.T)] = members
        # a pattern finds at most the points in the rectangle about it
        sums = np.zeros(np.array(place.shape) + 1, dtype=np.intp)
        (place >= 0).cumsum(0).cumsum(1, out=sums[1:, 1:])
        a, b = size
        inside = sums[a:, b:] - sums[:-a, b:] - sums[a:, :-b] + sums[:-a, :-b]
        at = outline + np.argwhere(inside >= FEWEST * len(expected))[:, None]
        fits.append(place[at[..., 0], at[..., 1]])
    if not sum(map(len, fits)):
        return []
    tried = np.concatenate(fits)
    seen = (tried >= 0).sum(1)
    return list(tried[(seen == seen.max()) & (seen >= FEWEST * len(expected))])


def _uprightness(expected: Whole, uv: Array, fit: Whole) -> float:
    """Return how well x points right and y points down, at most 2; minus infinity for a mirror image of the board."""
    seen = fit >= 0
    offsets = expected[seen] - expected[seen].mean(0)
    linear = np.linalg.lstsq(offsets.astype(float), uv[fit[seen]] - uv[fit[seen]].mean(0), rcond=None)[0]
    if np.linalg.det(linear) <= 0:
        return -np.inf
    x, y = linear / np.linalg.norm(linear, axis=1, keepdims=True)
    return float(x[0] + y[1])
