"""Task-specific correction: probing points are corrected by the mover's error at each (Härtig et al. section 2)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index
from metrocli.adjust.solution import Solution
from metrocli.errors import InputError
from metrocli.instruments import tracer as t
from metrocli.table import Table
from metrocli.tasks.multilaterate.problem import Network
from metrocli.tasks.multilaterate.settings import Correction
from metrocli.tasks.shared.part import Part
from metrocli.words import listed

if TYPE_CHECKING:
    from metrocli.table import Values

_FAR, _PLAIN, _ENOUGH = 12.0, 1e-4, 6
"""A list entry is reported as wrong from this multiple of the median deviation of all points, if the deviation also
exceeds this share of the volume and there are at least so many points"""


_NOWHERE = "probing point '{}' has no replayed point of its name or within {:g} mm"
_LEFT_OUT = "the replayed point of probing point '{}' was left out: too few of its lengths are correct"


def refuse_lost(network: Network, probing: Table, tolerance: float) -> None:
    """Raise InputError for every probing point with no replayed point of its name or within the tolerance (mm)."""
    _refuse(probing, _matches(network, probing, tolerance), _NOWHERE, tolerance)


def corrected(
    network: Network,
    solution: Solution,
    probing: Table,
    tolerance: float,
    scatter: Correction,
    part: Part | None = None,
) -> tuple[Table, Array]:
    """Return the probing points, corrected by the mover's error at their replayed points, and their covariances.

    A probing point belongs to the replayed point of its name, else to the nearest nominal point within the tolerance.
    Its covariance (3, 3) is `C + (2 r² + p² + g² |d|²) I`. C is that of the reflector's place, r the mover's
    repeatability, which acts at the probing and at the replay, p the standard deviation of the probed point. d leads
    from the replayed point to the probed one; g is the change
    of the mover's error per length from a point to its nearest one (root mean square, each coordinate). Points of a
    part are at 20 degC. Raises InputError that lists every probing point whose replayed point the adjustment left out.
    """
    match = _matches(network, probing, tolerance)
    _refuse(probing, match, _LEFT_OUT, tolerance)
    places, at = solution.blocks[t.POINT].values, probing.stacked("xyz")
    moved = at - (network.nominal[match] - places[match])
    of_place = solution.covariance_or_raise().members(t.POINT)[match]
    gap = np.linalg.norm(at - network.nominal[match], axis=1) * _gradient(network, places)
    own = 2 * scatter.repeatability**2 + scatter.tip**2 + gap**2
    covariance = of_place + own[:, None, None] * np.eye(3)
    if part is not None:
        moved, covariance = part.of_points(moved, covariance)
    columns: dict[str, Values] = {name: probing.columns[name] for name in ("feature", "point")}
    columns |= {name: moved[:, i] for i, name in enumerate("xyz")}
    columns |= {f"s{name}": np.sqrt(covariance[:, i, i]) for i, name in enumerate("xyz")}
    return Table(columns, dict.fromkeys(("x", "y", "z", "sx", "sy", "sz"), "mm")), covariance


def _gradient(network: Network, places: Array) -> float:
    """Return the change of the mover's error per length between nearest points, root mean square of a coordinate."""
    from scipy.spatial import cKDTree

    rows = np.flatnonzero((network.seen > 0) & network.unknown)
    if len(rows) < 2:
        return 0.0
    at = network.nominal[rows]
    distance, nearest = (found[:, 1] for found in cKDTree(at).query(at, k=2))
    apart = distance > 0
    error = at - places[rows]
    change = (error - error[nearest])[apart] / distance[apart, None]
    return float(np.sqrt((change**2).mean())) if apart.any() else 0.0


def _refuse(probing: Table, match: Index, text: str, tolerance: float) -> None:
    lost, names = np.flatnonzero(match < 0).tolist(), probing.texts("point")
    if lost:
        raise InputError([probing.fault_at(row, text.format(names[row], tolerance)) for row in lost])


def distant(network: Network, probing: Table | None, tolerance: float) -> tuple[str, ...]:
    """Return a warning if points were replayed farther than the tolerance from where they were probed."""
    if probing is None:
        return ()
    gap = np.linalg.norm(probing.stacked("xyz") - network.nominal[_matches(network, probing, tolerance)], axis=1)
    far = int((gap > tolerance).sum())
    if not far:
        return ()
    return (
        f"{far} probing points were replayed up to {gap.max():.3g} mm away from where they were probed: "
        "the correction is valid only if the mover's error is the same at both places",
    )


def wrong_entries(network: Network, solution: Solution) -> tuple[str, ...]:
    """Return a warning if the frame of a free network depends on entries of the list of points that look wrong."""
    rows = np.flatnonzero((network.seen > 0) & network.unknown)
    if network.datum is None or len(rows) < _ENOUGH:
        return ()
    error = network.nominal[rows] - solution.blocks[t.POINT].values[rows]
    size = np.linalg.norm(error - np.median(error, axis=0), axis=1)
    far = np.flatnonzero(size > max(_FAR * np.median(size), _PLAIN * np.ptp(network.nominal[rows], axis=0).max()))
    if not far.size:
        return ()
    names = [network.blocks[t.POINT].members[rows[i]] for i in far[np.argsort(-size[far])]]
    return (
        f"the entries of {len(names)} points may be wrong: {listed(names)} lie up to {size.max():.3g} mm from their "
        f"place in the list of points, the others about {np.median(size):.3g} mm; wrong entries turn and shift the "
        "frame: correct them",
    )


def _matches(network: Network, probing: Table, tolerance: float) -> Index:
    """Return the row of the replayed point of each probing point, (n,), or -1 without one."""
    from scipy.spatial import cKDTree

    replayed = np.flatnonzero(network.seen > 0)
    names = network.blocks[t.POINT].members
    place = {names[i]: i for i in replayed.tolist()}
    match = np.array([place.get(name, -1) for name in probing.texts("point")], dtype=np.intp)
    rest = np.flatnonzero(match < 0)
    gap, nearest = cKDTree(network.nominal[replayed]).query(probing.stacked("xyz")[rest])
    match[rest] = np.where(gap <= tolerance, replayed[nearest], -1)
    return match
