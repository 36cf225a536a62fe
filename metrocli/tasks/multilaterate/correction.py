"""Task-specific correction: probing points are corrected by the mover's error at each (Härtig et al. section 2)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from metrocli.adjust.medians import median
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array, Index, Mask, extents
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.instruments import tracer as t
from metrocli.table import Table
from metrocli.tasks.multilaterate.probed.tips import ANY, Tips, tips_of
from metrocli.tasks.multilaterate.problem import TracerNetwork
from metrocli.tasks.multilaterate.settings import Correction, Files, Settings
from metrocli.tasks.shared.joint_covariance import JointCovariance
from metrocli.tasks.shared.part import Part
from metrocli.uncertainty.predicted import COMMON, CORE
from metrocli.words import listed

_ELSEWHERE = 0.2
"""Median distance of probing points from their replayed points, as a share of the extent, that is implausible"""
_FAR, _PLAIN, _ENOUGH = 12.0, 1e-4, 6
"""A list entry is reported as wrong from this multiple of the median deviation of all points, if the deviation also
exceeds this share of the volume and there are at least so many points"""


_NOWHERE = "probing point '{}' has no replayed point of its name or within {:g} mm{}"
_LEFT_OUT = "the replayed point of probing point '{}' was left out: too few of its lengths are correct"
_EMPTY = {COMMON: (0, 3, 0), CORE: (0, 0)}
"""Factors of the covariance between points that are too many for them"""


@dataclass(frozen=True)
class Probing:
    """Probing points to correct, their tips, and what they scatter by."""

    table: Table
    tips: Tips
    tolerance: float
    """Largest distance of a probing point from a replayed point of another name [mm]"""
    scatter: Correction


def probing_of(settings: Settings, files: Files) -> Probing | None:
    """Return the probing points of a job, None without them; raises InputError for tips that do not fit."""
    if files.probing is None:
        if files.tips is not None:
            raise InputError(
                [files.tips.fault("tips need `inputs: probing`", "expected probing points with these tips")]
            )
        return None
    tips = tips_of(files.tips, files.probing, files.points)
    return Probing(files.probing, tips, settings.tolerance, settings.correction)


def refuse_lost(network: TracerNetwork, probing: Probing) -> None:
    """Raise InputError for every probing point with no replayed point of its name or within the tolerance."""
    _refuse(probing, _matches(network, probing), _NOWHERE)


def corrected(
    network: TracerNetwork, solution: Solution, probing: Probing, shared: Mapping[str, Array], part: Part | None = None
) -> tuple[Table, JointCovariance]:
    """Return the probing points, corrected by the mover's error at their replayed points, and their joint covariance.

    A probing point belongs to the replayed point of its name, else to the nearest nominal point of its tip within the
    tolerance. Its covariance (3, 3) is `C + T + (2 r² + p² + g² |d|²) I`. C is that of the reflector's place, T that
    of the reflector against the tip, p the standard deviation of the probed point. r is the mover's repeatability; it
    acts at the probing and at the replay, but r² counts once where C has that of several stops. d leads from the
    replayed point to the probed one; g is the change of the mover's error per length from a point to its nearest one
    of the same tip (root mean square, each coordinate). `shared` are the factors of the covariance between the points
    that are read.
    Points of a part are at 20 degC. Raises InputError that lists every probing point whose replayed point the
    adjustment left out.
    """
    match = _matches(network, probing)
    _refuse(probing, match, _LEFT_OUT)
    table, scatter = probing.table, probing.scatter
    places, at = solution.blocks[t.POINT].values, table.stacked("xyz")
    moved = at - (network.nominal[match] - places[match])
    gap = np.linalg.norm(at - network.nominal[match], axis=1) * _gradient(network, places, probing.tips.replayed)
    own = scatter.repeatability**2 + scatter.tip**2 + gap**2
    returned = np.where(_several_stops(network), 0.0, scatter.repeatability**2)
    joint = _joint(network, solution, probing.tips, match, shared, own, returned)
    if part is not None:
        moved, joint = moved * part.shrinkage, joint.at_reference(part, moved * part.shrinkage)
    covariance = joint.of_points()
    names = {name: table.columns[name] for name in ("feature", "point", "tip") if name in table}
    std = np.sqrt(np.einsum("nkk->nk", covariance))
    return Table.of({**names, "x y z [mm]": moved, "sx sy sz [mm]": std}), joint


def _joint(
    network: TracerNetwork,
    solution: Solution,
    tips: Tips,
    match: Index,
    shared: Mapping[str, Array],
    own: Array,
    returned: Array,
) -> JointCovariance:
    """Return the joint covariance; points of one replay share the error of its place and of the return to it.

    `returned` is the variance of the return to each point of the network.
    """
    replays, replay = np.unique(match, return_inverse=True)
    whole = solution.covariance_or_raise().members(t.POINT)[replays]
    row = np.cumsum(network.seen > 0) - 1
    common, core = (shared[name] if COMMON in shared else np.zeros(shape) for name, shape in _EMPTY.items())
    of_point = common[row[replays]] if COMMON in shared else np.zeros((len(replays), 3, 0))
    left = whole - of_point @ core @ np.swapaxes(of_point, 1, 2) + returned[replays, None, None] * np.eye(3)
    by_tip = np.eye(3 * len(tips.names)).reshape(len(tips.names), 3, -1)[tips.probed]
    size = len(core)
    both = np.zeros((size + by_tip.shape[2],) * 2)
    both[:size, :size], both[size:, size:] = core, np.diag(tips.sigma.ravel() ** 2)
    return JointCovariance(np.concatenate([of_point[replay], by_tip], axis=2), both, replay, left, own)


def _several_stops(network: TracerNetwork) -> Mask:
    """Return the points whose place is the mean of several stops: their covariance has the mover's return already."""
    lengths = network.lengths.observations
    counted = lengths.conditions.get(t.ALONE, np.zeros(lengths.count)) > 0
    if t.STOP in lengths.index:
        counted = counted | (lengths.index[t.STOP] > 0)
    return np.isin(np.arange(len(network.nominal)), lengths.index[t.POINT][counted])


def _gradient(network: TracerNetwork, places: Array, tip: Index) -> float:
    """Return the change of the mover's error per length between nearest points, root mean square of a coordinate."""
    changes = [
        _changes(network.nominal[rows], network.nominal[rows] - places[rows])
        for number in np.unique(tip)
        if len(rows := np.flatnonzero((network.seen > 0) & network.unknown & (tip == number))) > 1
    ]
    every = np.concatenate(changes) if changes else np.zeros((0, 3))
    return float(np.sqrt((every**2).mean())) if len(every) else 0.0


def _changes(at: Array, error: Array) -> Array:
    """Return the change of an error per length from each place (n, 3) to its nearest one, where these differ."""
    from scipy.spatial import cKDTree

    distance, nearest = (distances[:, 1] for distances in cKDTree(at).query(at, k=2))
    apart = distance > 0
    return np.asarray((error - error[nearest])[apart] / distance[apart, None])


def _refuse(probing: Probing, match: Index, text: str) -> None:
    lost, names = np.flatnonzero(match < 0).tolist(), probing.table.texts("point")
    tips = [
        f" that replays tip '{probing.tips.names[tip]}'" if probing.tips.names[tip] else ""
        for tip in probing.tips.probed
    ]
    if lost:
        raise InputError(
            [probing.table.fault_at(row, text.format(names[row], probing.tolerance, tips[row])) for row in lost]
        )


def list_offset(network: TracerNetwork, probing: Probing | None) -> float:
    """Return how far the replayed points are from where they were probed, relative to what is plausible.

    Both are readings of one mover, so that a median beyond a fifth of the extent of the points is a mistake in a file.
    """
    if probing is None:
        return 0.0
    extent = float(extents(network.nominal[network.seen > 0]).max()) or 1.0
    gap = _gaps(network, probing)
    return float(median(gap)) / (_ELSEWHERE * extent) if gap.size else 0.0


def _gaps(network: TracerNetwork, probing: Probing) -> Array:
    """Return the distance of each probing point that was replayed from where it was, (n,) mm."""
    match = _matches(network, probing)
    return np.asarray(np.linalg.norm(probing.table.stacked("xyz") - network.nominal[match], axis=1)[match >= 0])


def distant(network: TracerNetwork, probing: Probing | None) -> tuple[str, ...]:
    """Return a warning if points were replayed farther than the tolerance from where they were probed."""
    if probing is None:
        return ()
    gap = _gaps(network, probing)
    far = int((gap > probing.tolerance).sum())
    if not far:
        return ()
    return (
        f"probing points were replayed up to {gap.max():.3g} mm away from where they were probed ({far} of {len(gap)} "
        f"by more than {probing.tolerance:.3g} mm): the correction is valid only if the mover's error is the same at "
        "both places",
    )


def wrong_entries(network: TracerNetwork, solution: Solution) -> tuple[str, ...]:
    """Return why a free network is doubtful whose frame depends on entries of the list of points that look wrong."""
    rows = np.flatnonzero((network.seen > 0) & network.unknown)
    if network.datum is None or len(rows) < _ENOUGH:
        return ()
    error = network.nominal[rows] - solution.blocks[t.POINT].values[rows]
    size = np.linalg.norm(error - median(error.T), axis=1)
    far = np.flatnonzero(size > max(_FAR * median(size), _PLAIN * extents(network.nominal[rows]).max()))
    if not far.size:
        return ()
    names = [network.blocks[t.POINT].members[rows[i]] for i in far[np.argsort(-size[far])]]
    return (
        f"the list of points may be wrong at {listed(names)}: up to {size.max():.3g} mm from the adjusted place, the "
        f"others about {median(size):.3g} mm; a wrong entry turns and shifts the frame: correct it",
    )


def _matches(network: TracerNetwork, probing: Probing) -> Index:
    """Return the row of the replayed point of each probing point, (n,), or -1 without one of its tip."""
    from scipy.spatial import cKDTree

    tips, names = probing.tips, network.blocks[t.POINT].members
    replayed = network.seen > 0
    place = {names[i]: i for i in np.flatnonzero(replayed).tolist()}
    match = np.array([place.get(name, -1) for name in probing.table.texts("point")], dtype=np.intp)
    of_other = (tips.replayed[match] != tips.probed) & (tips.replayed[match] != ANY)
    match[of_other] = -1
    at = probing.table.stacked("xyz")
    for tip in range(len(tips.names)):
        rest = np.flatnonzero((match < 0) & (tips.probed == tip))
        offered = np.flatnonzero(replayed & np.isin(tips.replayed, (tip, ANY)))
        if rest.size and offered.size:
            gap, nearest = cKDTree(network.nominal[offered]).query(at[rest])
            match[rest] = np.where(gap <= probing.tolerance, offered[nearest], -1)
    return match
