"""Probe tips, and the joint covariance of the points that they probe."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.table import Table
from metrocli.tasks.shared.lists import sigmas
from metrocli.words import did_you_mean

ANY = -1
"""Tip of a replayed point that no file assigns to one"""


@dataclass(frozen=True)
class Tips:
    """The tips of a job, and the tip of each probing point and of each replayed point."""

    names: tuple[str, ...]
    sigma: Array
    """Standard deviations of the reflector's place from that of each tip (tips, 3) [mm]"""
    probed: Index
    """Tip of each probing point"""
    replayed: Index
    """Tip of each point of the list, or ANY"""


def tips_of(listed: Table | None, probing: Table, points: Table) -> Tips:
    """Return the tips of the points; without a column `tip` in `probing` there is one, for all.

    The tip of a replayed point stands in the column `tip` of the list of points. Without the column it is the tip of
    the probing points of its name. Raises InputError that lists every row without a tip that is known.
    """
    if "tip" not in probing:
        naming = next((table.file for table in (listed, points) if table is not None and "tip" in table), None)
        if naming is not None:
            raise InputError([probing.fault("there is no column 'tip'", f"{naming} names tips: name one a row")])
        everywhere = np.zeros(len(points), dtype=np.intp)
        return Tips(("",), np.zeros((1, 3)), np.zeros(len(probing), dtype=np.intp), everywhere)
    if listed is None:
        raise InputError(
            [probing.fault("the column 'tip' needs a list of tips", "expected `inputs: {tips: tips.csv}`")]
        )
    names, sigma = listed.texts("tip"), sigmas(listed, without=0.0)
    unknown = np.flatnonzero(~np.isfinite(sigma).all(axis=1))
    if unknown.size:
        hint = "expected the standard deviation of the reflector's place from that of the tip, 0 for none"
        raise InputError([listed.fault_at(row, f"tip '{names[row]}' has no sigma", hint) for row in unknown.tolist()])
    probed = _rows(probing, names, listed.file)
    if "tip" in points:
        replayed = _rows(points, names, listed.file)
    else:
        replayed = _by_name(probing, probed, points.texts("point"))
    return Tips(tuple(names), sigma, probed, replayed)


def _rows(table: Table, names: Sequence[str], file: str) -> Index:
    place = {name: row for row, name in enumerate(names)}
    rows = np.array([place.get(name, ANY) for name in table.texts("tip")], dtype=np.intp)
    lost, tips = np.flatnonzero(rows < 0).tolist(), table.texts("tip")
    if lost:
        faults = table.faults_at(
            lost, lambda row: f"{file} has no tip '{tips[row]}'", lambda row: did_you_mean(tips[row], names)
        )
        raise InputError(faults)
    return rows


def _by_name(probing: Table, probed: Index, points: Sequence[str]) -> Index:
    """Return the tip of the probing points of each point's name, or ANY; two tips of one name are a fault."""
    tips: dict[str, int] = {}
    wrong = []
    for row, name in enumerate(probing.texts("point")):
        if name and tips.setdefault(name, int(probed[row])) != probed[row]:
            wrong.append(row)
    replays, names = set(points), probing.texts("point")
    wrong = [row for row in wrong if names[row] in replays]
    if wrong:
        hint = "expected a replay of its own for each tip, of its own name, or a column 'tip' in the list of points"
        raise InputError(
            probing.faults_at(wrong, lambda row: f"point '{names[row]}' is probed with two tips", lambda _: hint)
        )
    return np.array([tips.get(name, ANY) for name in points], dtype=np.intp)
