"""Second places that fit lengths as well: the mirror image of a tracer or a point in the plane of what it is read with.

Lengths to ends in one plane, or nearly in one, do not distinguish its two sides. Nor do three lengths.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from metrocli.adjust.model.chain import Chain
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.solution import Solution, residuals_of
from metrocli.arrays import Array, Index, Mask
from metrocli.errors import UndeterminedError
from metrocli.frozen import dataclass
from metrocli.instruments import tracer as t
from metrocli.tasks.shared.uncontrolled import Hidden

_STEPS = 40
"""Gauss-Newton steps at most"""
_CHI_SQUARE = 10.83
"""Increase of chi-square up to which a second place fits as well: 0.1 % of chance, one degree of freedom"""
_APART = 6.0
"""Standard uncertainties of a place from which a second one is another solution and not the same"""
_FLAT = 0.3
"""Ends whose thickness is below this share of their extent may let a mirror image fit"""
_DECIDED = 0.5
"""A listed place decides if its distance from the solution is below this share of that from the mirror image"""
_MOST_LISTED = 5
"""Most mirror images that a table lists"""
_TINY = 1e-300
"""Divisor in the place of 0"""
_OTHERS = {"point": "tracers"}
"""What is in the plane that mirrors a member: the other ends of its lengths"""


def coordinates(place: Array) -> str:
    """Return a place for a message: "(1.5, -20, 310) mm"."""
    return f"({', '.join(f'{value:.5g}' for value in place)}) mm"


@dataclass(frozen=True)
class NetworkLengths:
    """Adjusted lengths from members, such as points, to their other ends, such as tracers."""

    noun: str
    names: Sequence[str]
    of: Index
    """Member of each length, (n,)"""
    ends: Array
    """Place of the other end of each length, (n, 3)"""
    residuals: Array
    """Length less that of the adjusted places, (n,)"""
    sigma: Array
    """Standard deviation of each length, with that of its other end, (n,)"""
    places: Array
    """Adjusted places, (members, 3)"""
    std: Array
    """Their standard uncertainties, (members, 3)"""
    free: Mask
    """(members, 3)"""
    listed: Array
    """Places that files list, (members, 3), nan where they list none"""
    offset: Mask
    """Members whose lengths share an unknown offset, (members,)"""

    def selected(self, members: Mask) -> NetworkLengths:
        """Return the lengths of some of the members."""
        rows, number = members[self.of], np.cumsum(members) - 1  # the new number of each member that is kept
        return NetworkLengths(
            self.noun,
            [name for name, kept in zip(self.names, members, strict=True) if kept],
            number[self.of[rows]],
            self.ends[rows],
            self.residuals[rows],
            self.sigma[rows],
            self.places[members],
            self.std[members],
            self.free[members],
            self.listed[members],
            self.offset[members],
        )


@dataclass(frozen=True)
class Mirrored:
    """A member with a second place that fits its lengths."""

    noun: str
    name: str
    member: int
    solved: Array
    other: Array
    gain: float
    """Chi-square of the solved place less that of the other one"""
    decided: bool
    """Whether the list of places decides for the solved place"""

    @property
    def better(self) -> bool:
        """Whether the other place fits better than by chance."""
        return self.gain > _CHI_SQUARE

    @property
    def words(self) -> str:
        """Both places, for a message."""
        return f"{self.noun} {self.name} at {coordinates(self.solved)} or {coordinates(self.other)}"


def of_tracers(solution: Solution, group: Group, listed_at: Array) -> NetworkLengths:
    """Return the lengths of a group as those from tracers, which are `listed_at` places, to the ends of its chain."""
    block, observations = solution.blocks[t.TRACER], group.observations
    residuals = residuals_of(solution, group)
    noun = next(key for key in observations.keys if key in ("tracer", "station"))
    links = list(group.chain.links)
    length = next(i for i, link in enumerate(links) if isinstance(link, t.LengthFrom))
    ends = Chain(tuple(links[:length])).predict(solution.blocks, observations).T
    # the point at the other end is uncertain too: its coordinate along the beam counts like noise
    sigma = np.hypot(residuals.sigma[0], _spread(solution, observations))
    return NetworkLengths(
        noun,
        block.members,
        observations.index[t.TRACER],
        np.ascontiguousarray(ends),
        residuals.values[0],
        sigma,
        block.values[:, :3],
        solution.std(t.TRACER)[:, :3],
        block.free[:, :3],
        listed_at,
        block.free[:, 3],
    )


def of_points(solution: Solution, group: Group, nominal: Array) -> NetworkLengths:
    """Return the lengths of a group as those from points to tracers; `nominal` are the listed places of the points."""
    block, observations = solution.blocks[t.POINT], group.observations
    residuals, tracer = residuals_of(solution, group), observations.index[t.TRACER]
    return NetworkLengths(
        block.noun,
        block.members,
        observations.index[t.POINT],
        solution.blocks[t.TRACER].values[tracer, :3],
        residuals.values[0],
        residuals.sigma[0],
        block.values,
        solution.std(t.POINT),
        block.free,
        nominal,
        np.zeros(len(block.members), dtype=bool),
    )


def _spread(solution: Solution, observations: Observations) -> Array | float:
    """Return the standard uncertainty of a coordinate of the point of each length, (n,); 0 if it is not an unknown."""
    if t.POINT not in solution.blocks or not solution.blocks[t.POINT].free.any():
        return 0.0
    return np.asarray(np.sqrt((solution.std(t.POINT) ** 2).mean(axis=1))[observations.index[t.POINT]])


def must_be_decided(places: Sequence[Mirrored], sigma0: float) -> None:
    """Raise UndeterminedError, with the misfit, if a place and its mirror image fit alike, and no list decides."""
    if undecided := [place for place in places if not place.decided]:
        noun, other = undecided[0].noun, _OTHERS.get(undecided[0].noun, "points")
        raise UndeterminedError(
            f"two places fit the lengths alike, mirror images in the plane of the {other}:\n"
            + "\n".join(f"  {place.words}" for place in undecided[:3])
            + f"\n  what decides: a place in `inputs: {noun}s` that is near one of them, or lengths to {other} away "
            "from that plane",
            sigma0,
        )


def hidden_by(places: Sequence[Mirrored]) -> Iterator[Hidden]:
    """Yield what no residual shows: places that only the list decides for, not their mirror images."""
    for place in places[:_MOST_LISTED]:
        apart = float(np.linalg.norm(place.other - place.solved))
        other = _OTHERS.get(place.noun, "points")
        yield Hidden(
            f"mirror image of {place.noun} {place.name} in the plane of the {other} (its listed place decides)",
            f"the other side of the plane, {coordinates(place.other)}",
            apart,
            f"lengths to {other} away from that plane",
        )


def mirrored(network: NetworkLengths, noise: float = 1.0) -> list[Mirrored]:
    """Return the members with a second place whose chi-square is at most 10.83 larger (0.1 %) than that of the first.

    `noise` is a factor on the standard deviations. Members whose ends are far from one plane are not tried.
    """
    count = len(network.places)
    lengths = np.bincount(network.of, minlength=count)
    normal, thin, centre = _planes(network, lengths)
    height = ((network.places - centre) * normal).sum(axis=1)
    tried = ((thin < _FLAT) | (lengths <= 3)) & (lengths > 0) & network.free.any(axis=1) & (np.abs(height) > 0)
    if not tried.any():
        return []
    few = network.selected(tried)
    # ends are never exactly in one plane, so the mirrored place is a start and not yet the second solution
    start = few.places - 2 * (height[:, None] * normal)[tried] * few.free
    other, gain = _refined(few, start, noise)
    apart = np.linalg.norm(other - few.places, axis=1)
    from_first, from_other = (np.linalg.norm(few.listed - place, axis=1) for place in (few.places, other))
    # nearer to the first than to the image, or within its std, it is the same (docs/decisions/170-mirror-images.md)
    second = (apart > _APART * np.linalg.norm(few.std, axis=1)) & (np.linalg.norm(other - start, axis=1) < apart)
    members, ambiguous = np.flatnonzero(tried), (gain > -_CHI_SQUARE) & second & np.isfinite(apart)
    return [
        Mirrored(
            network.noun,
            few.names[i],
            int(members[i]),
            few.places[i],
            other[i],
            float(gain[i]),
            bool(from_first[i] < _DECIDED * from_other[i]),
        )
        for i in np.flatnonzero(ambiguous).tolist()
    ]


def _sums(of: Index, left: Array, right: Array, weight: Array, count: int) -> Array:
    """Return the weighted sums of products of columns over the lengths of each member, (m, a, b)."""
    sums = np.empty((count, left.shape[1], right.shape[1]))
    weighted = [weight * a for a in left.T]
    for i, j in np.ndindex(sums.shape[1:]):
        # of columns with themselves the sums are symmetric
        sums[:, i, j] = sums[:, j, i] if left is right and j < i else np.bincount(of, weighted[i] * right[:, j], count)
    return sums


def _planes(network: NetworkLengths, lengths: Index) -> tuple[Array, Array, Array]:
    """Return unit normal (m, 3), relative thickness (m,) and centre (m, 3) of the plane nearest to each member's ends.

    Coordinates that are given are not a direction of the normal. Ends that are surely far from a plane have none: a
    normal of zeros, and a thickness below the true one.
    """
    count = len(lengths)
    each = np.maximum(lengths, 1)[:, None]
    centre = np.stack([np.bincount(network.of, axis, count) for axis in network.ends.T], axis=1) / each
    away = network.ends - centre[network.of]
    scatter = _sums(network.of, away, away, np.ones(len(away)), count)
    given = ~network.free
    scatter[given[:, :, None] | given[:, None, :]] = 0.0
    largest = np.maximum(scatter.max(axis=(1, 2)), _TINY)
    # a given coordinate gets a large eigenvalue, so that it is never the normal
    scatter[:, range(3), range(3)] += np.where(given, 1e3 * largest[:, None], 0.0)
    # det = e1 e2 e3, and e2 e3 is at most the square of half the trace: `e1 >= 4 det / trace^2`, so that most members
    # need no vectors
    a, b, c = np.moveaxis(scatter, 2, 0)
    trace = np.einsum("mii->m", scatter)
    thin: Array = 2 * np.sqrt(np.maximum((np.cross(a, b) * c).sum(axis=1), 0.0) / largest) / np.maximum(trace, _TINY)
    normal = np.zeros((count, 3))
    near = (thin < _FLAT) | (lengths <= 3)
    values, vectors = np.linalg.eigh(scatter[near])
    normal[near], thin[near] = vectors[:, :, 0], np.sqrt(np.maximum(values[:, 0], 0.0) / largest[near])
    return normal, thin, np.asarray(centre)


def _refined(network: NetworkLengths, start: Array, noise: float) -> tuple[Array, Array]:
    """Return the places (m, 3) of least chi-square near a start, and by how much it is below that of `network.places`.

    Damped Gauss-Newton steps of all members at once; each has its own damping.
    """
    count, of = len(start), network.of
    weight = 1 / (noise * network.sigma) ** 2
    unknown = np.column_stack([network.free, network.offset]).astype(float)
    # the reading itself, from the adjusted length and its residual: no chain is needed
    read = np.linalg.norm(network.places[of] - network.ends, axis=1) + network.residuals

    def misfit(state: Array) -> tuple[Array, Array, Array]:
        away = state[of, :3] - network.ends
        distance = np.maximum(np.linalg.norm(away, axis=1), 1e-12)
        miss = read + state[of, 3] - distance
        cost: Array = np.bincount(of, weight * miss**2, count).astype(float)
        return miss, away / distance[:, None], cost  # the second is the derivative by the place

    before = misfit(np.column_stack([network.places, np.zeros(count)]))[2]
    state, damping = np.column_stack([start, np.zeros(count)]), np.full(count, 1e-6)
    miss, towards, cost = misfit(state)
    for _ in range(_STEPS):
        columns = np.column_stack([towards, -np.ones(len(of))]) * unknown[of]
        normal, right = _sums(of, columns, columns, weight, count), _sums(of, columns, miss[:, None], weight, count)
        size = np.maximum(normal[:, range(4), range(4)].max(axis=1), _TINY)
        # what is fixed gets a pivot of the same size: its column is 0, and its step stays 0
        normal[:, range(4), range(4)] += (damping * size)[:, None] + (1 - unknown) * size[:, None]
        moved = state + np.linalg.solve(normal, right)[:, :, 0]
        new_miss, new_towards, new_cost = misfit(moved)
        better = new_cost <= cost
        converged = np.abs(cost - new_cost).max() <= 1e-9 * (1 + cost.max())
        damping = np.clip(np.where(better, damping / 10, damping * 10), 1e-12, 1e6)
        state, cost = np.where(better[:, None], moved, state), np.where(better, new_cost, cost)
        rows = better[of]
        miss, towards = np.where(rows, new_miss, miss), np.where(rows[:, None], new_towards, towards)
        if converged:
            break
    return state[:, :3], before - cost
