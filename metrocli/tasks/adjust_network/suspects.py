"""Wrong readings of a network: those whose residuals are beyond chance, and those that contradict its set-ups."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.groups import Group
from metrocli.adjust.robust import FitQuality, as_likely, gross, suspects
from metrocli.adjust.solution import Residuals, Solution
from metrocli.arrays import Index
from metrocli.doubt import MANY_LEFT_OUT, MOST_REJECTED
from metrocli.frozen import dataclass
from metrocli.instruments.tracer import POINT
from metrocli.tasks.adjust_network.groups import GIVEN_POINTS, OF_POINT, is_sighting
from metrocli.tasks.adjust_network.problem import Network

_INNOCENT = 3.0
"""A reading left out at the start is used again if its residual is less than this many standard deviations"""


@dataclass(frozen=True)
class SuspectedReading:
    """A reading whose residual is too large to be due to chance."""

    group: str
    row: int
    """Among the readings of the group that were in use"""
    test: float
    keys: Mapping[str, str]
    points: frozenset[int]
    """Numbers of the points that it concerns"""

    @property
    def name(self) -> str:
        """Its names in a row, such as S1/P004/az."""
        return "/".join(text for text in self.keys.values() if text)


def suspected(of_groups: Mapping[str, Residuals], solution: Solution) -> Iterator[SuspectedReading]:
    """Yield the wrong readings, the worst first; all groups are tested together."""
    # given coordinates are not readings that could be left out: they may hold the frame
    of_groups = {name: residuals for name, residuals in of_groups.items() if not name.startswith(GIVEN_POINTS)}
    names = [name for name, residuals in of_groups.items() for _ in range(residuals.values.shape[1])]
    rows = np.concatenate([np.arange(residuals.values.shape[1]) for residuals in of_groups.values()])
    parts = (
        [getattr(residuals, key) for residuals in of_groups.values()]
        for key in ("values", "sigma", "redundancy", "normalised")
    )
    tested = suspects(
        Residuals(*(np.concatenate(part, axis=1) for part in parts)), FitQuality(solution.cost, solution.dof, True)
    )
    groups = {group.name: group for group in solution.groups}
    for i in np.argsort(-tested.tests, kind="stable").tolist():
        name, row = names[int(tested.rows[i])], int(rows[tested.rows[i]])
        yield _suspect(groups[name], row, float(tested.tests[i]))


def worst_of_points(suspects: Sequence[SuspectedReading]) -> Iterator[SuspectedReading]:
    """Yield suspects that can be left out together, of some that begin with the worst.

    They have at least half of the largest test. Few readings determine a point, and a wrong one moves it against right
    ones. So of each point only the worst is left out, with those that are as likely to be wrong; the others are tested
    again without it.
    """
    largest: dict[int, float] = {}
    for suspect in suspects:
        if suspect.test < suspects[0].test / 2:
            return
        worse = max((largest[point] for point in suspect.points if point in largest), default=suspect.test)
        if as_likely(np.square([worse, suspect.test]))[1]:
            largest |= dict.fromkeys(suspect.points, worse)
            yield suspect


def contradictions(
    network: Network, wrong: Mapping[str, Index], blocks: Mapping[str, Block]
) -> Iterator[SuspectedReading]:
    """Yield readings that contradict the set-ups, tested at values of the blocks."""
    for name, rows in wrong.items():
        group = network.model.group(name)
        tests = np.abs(group.observations.whitened(group.residuals(blocks))).max(axis=0)
        for row in rows.tolist():
            yield _suspect(group, row, float(tests[row]))


def with_gross(wrong: Mapping[str, Index], network: Network, blocks: Mapping[str, Block]) -> dict[str, Index]:
    """Return rows of wrong readings by group, with those of the sightings that are far off at values of the blocks."""
    rows = dict(wrong)
    for group in network.model.readings:
        far = np.flatnonzero(gross(group, blocks)) if is_sighting(group) else ()
        if len(far):
            rows[group.name] = np.union1d(rows.get(group.name, far), far)
    return rows


def misfitting(wrong: Mapping[str, Index], network: Network, blocks: Mapping[str, Block]) -> dict[str, Index]:
    """Return the rows of wrong readings that do not fit the values either; the others can be used again."""
    return {
        name: rows[[suspect.test > _INNOCENT for suspect in contradictions(network, {name: rows}, blocks)]]
        for name, rows in wrong.items()
    }


def _suspect(group: Group, row: int, test: float) -> SuspectedReading:
    index = group.observations.index
    # the mark under a station is not a point of its sightings: all of them would be alike
    points = np.atleast_2d(index.get(OF_POINT, index[POINT]))[:, row]
    keys = {key: texts[row] for key, texts in group.observations.keys.items()}
    return SuspectedReading(group.name, row, test, keys, frozenset(points.tolist()))


def have_one_cause(groups: Iterable[Group], out: Sequence[SuspectedReading]) -> bool:
    """Return whether more than a third of all readings, or of those of one station, were left out as wrong."""
    left = Counter[str]()
    for group in groups:
        left[""] += group.observations.readings.size
        left.update(group.observations.keys.get("station", ()))
    lost = Counter(suspect.keys["station"] for suspect in out if "station" in suspect.keys) + Counter({"": len(out)})
    return any(count > MOST_REJECTED * (count + left[of]) for of, count in lost.items() if count >= MANY_LEFT_OUT)
