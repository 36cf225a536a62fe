"""Task-specific correction: a measurement corrected by the mover's error at each point (Härtig et al. section 2)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from metrocli.adjust.observations import Index
from metrocli.adjust.solution import Solution
from metrocli.errors import Fault, InputError
from metrocli.instruments import tracer as t
from metrocli.table import Table
from metrocli.tasks.length_network import Network

if TYPE_CHECKING:
    from metrocli.table import Values


def corrected(network: Network, solution: Solution, probing: Table, tolerance: float) -> Table:
    """Return the probing points with the mover's error at their replayed points taken off, in the shape they came.

    A probing point belongs to the replayed point of its name, else to the nearest nominal point within the tolerance.
    Raises InputError that lists every probing point without a replayed one.
    """
    match = _matches(network, probing, tolerance)
    lost = np.flatnonzero(match < 0)
    if lost.size:
        names = probing.texts("point")
        text = "probing point '{}' has no replayed point of its name or within {:g} mm"
        lines = [probing.lines[row] if probing.lines else None for row in lost]
        raise InputError(
            [
                Fault(text.format(names[row], tolerance), probing.file, line)
                for row, line in zip(lost, lines, strict=True)
            ]
        )
    error = network.nominal[match] - solution.blocks[t.POINT].values[match]
    moved = probing.stacked("xyz") - error
    columns: dict[str, Values] = {name: probing.columns[name] for name in ("feature", "point")}
    columns |= {name: moved[:, i] for i, name in enumerate("xyz")}
    return Table(columns, dict.fromkeys("xyz", "mm"))


def distant(network: Network, probing: Table | None, tolerance: float) -> tuple[str, ...]:
    """Return the warning that points were replayed elsewhere than they were probed, where they were."""
    if probing is None:
        return ()
    gap = np.linalg.norm(probing.stacked("xyz") - network.nominal[_matches(network, probing, tolerance)], axis=1)
    far = int((gap > tolerance).sum())
    if not far:
        return ()
    return (
        f"{far} probing points were replayed up to {gap.max():.3g} mm away from where they were probed: "
        "the correction holds where the mover's error is the same at both places",
    )


def _matches(network: Network, probing: Table, tolerance: float) -> Index:
    """Return the replayed point of each probing point, -1 where there is none."""
    from scipy.spatial import cKDTree

    replayed = np.flatnonzero(network.seen > 0)
    names = network.blocks[t.POINT].members
    place = {names[i]: i for i in replayed.tolist()}
    match = np.array([place.get(name, -1) for name in probing.texts("point")], dtype=np.intp)
    rest = np.flatnonzero(match < 0)
    gap, nearest = cKDTree(network.nominal[replayed]).query(probing.stacked("xyz")[rest])
    match[rest] = np.where(gap <= tolerance, replayed[nearest], -1)
    return match
