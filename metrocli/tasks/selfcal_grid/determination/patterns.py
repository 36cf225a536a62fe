"""Patterns of machine errors that views can leave undetermined, as projectors."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from metrocli.arrays import Array, Index
from metrocli.instruments import ball_grid as bg
from metrocli.tasks.selfcal_grid.problem import GridProblem

Projector = Callable[[Array], Array]
"""Function from fields (sites, 3, k) to the part of them that has the pattern"""


def patterns(problem: GridProblem) -> Iterator[tuple[str, Projector]]:
    """Yield patterns with their projectors, the simplest first."""
    sites = problem.grid.sites
    pairs = _lonely(problem)
    if pairs.any():
        yield (
            "machine errors at sites seen once, by a ball seen once",
            lambda fields: np.asarray(fields * pairs[:, None, None]),
        )
    for a in range(3):
        yield f"another scale along {'xyz'[a]}", _onto(np.eye(3)[a] * sites[:, a, None])
    for a in range(3):
        yield f"another scale across {'xyz'[a]}", _onto((1 - np.eye(3)[a]) * sites)
    for a, b in ((0, 1), (0, 2), (1, 2)):
        shear = np.zeros((len(sites), 3))
        shear[:, a], shear[:, b] = sites[:, b], sites[:, a]
        yield f"the squareness of {'xyz'[a]} and {'xyz'[b]}", _onto(shear)
    for a in range(3):
        twist: Array = np.asarray(np.cross(np.eye(3)[a], sites) * sites[:, a, None], dtype=float)
        yield f"a twist about {'xyz'[a]}: planes across it turn in proportion to {'xyz'[a]}", _onto(twist)
    for a in range(3):
        across = np.delete(np.eye(3), a, axis=0)
        bowl = -sites[:, a, None] * (sites @ across.T) @ across
        bowl[:, a] = ((sites @ across.T) ** 2).sum(axis=1) / 2
        yield f"planes across {'xyz'[a]} bend to bowls, the wider the higher", _onto(bowl)
    for a in range(3):
        for c in (a, (a + 1) % 3, (a + 2) % 3):
            yield f"each plane across {'xyz'[a]} moves by itself along {'xyz'[c]}", _planes(sites[:, [a]], (c,))
    for a in range(3):
        yield f"each line along {'xyz'[a]} moves by itself", _planes(np.delete(sites, a, axis=1), (0, 1, 2))
    turns = _group([view.turn for view in problem.views])
    if len(turns) > 1:
        yield "fields that all rotations of the views carry into themselves", _symmetric(sites, turns)


def _lonely(problem: GridProblem) -> Array:
    """Return the sites (n,) with a single reading, of a ball that has no other reading."""
    index = problem.readings.observations.index
    site, ball = index[bg.MACHINE], index[bg.ARTEFACT]
    alone = (np.bincount(site)[site] == 1) & (np.bincount(ball)[ball] == 1)
    lonely = np.zeros(len(problem.grid.sites), dtype=bool)
    lonely[site[alone]] = True
    return lonely


def _onto(field: Array) -> Projector:
    """Return the projector onto one field (sites, 3)."""
    unit = field / max(float(np.linalg.norm(field)), 1e-300)
    return lambda fields: np.asarray(np.einsum("na,k->nak", unit, np.einsum("na,nak->k", unit, fields)))


def _planes(keys: Index, components: tuple[int, ...]) -> Projector:
    """Return the projector onto fields whose `components` are constant over sites with equal keys."""
    _, label = np.unique(keys, axis=0, return_inverse=True)
    label = label.reshape(-1)
    counts = np.bincount(label)

    def project(fields: Array) -> Array:
        result = np.zeros_like(fields)
        for c in components:
            sums = np.zeros((len(counts), fields.shape[2]))
            np.add.at(sums, label, fields[:, c])
            result[:, c] = (sums / counts[:, None])[label]
        return result

    return project


def _group(turns: list[Array]) -> list[Array]:
    """Return the group of all products of the rotations."""
    group = {np.eye(3).tobytes(): np.eye(3)}
    while True:
        # adding 0 turns -0 into 0: the bytes of equal matrices are then equal
        more = {(a @ b + 0.0).tobytes(): a @ b + 0.0 for a in group.values() for b in turns}
        if not set(more) - set(group):
            return list(group.values())
        group |= more


def _symmetric(sites: Index, turns: list[Array]) -> Projector:
    """Return the projector onto fields with `G(R q) = R G(q)`; sites without all their images stay unchanged."""
    at = np.stack([bg.numbers_at(sites, np.rint(sites @ turn.T).astype(np.intp)) for turn in turns])
    whole = np.asarray((at >= 0).all(axis=0))

    def project(fields: Array) -> Array:
        # `R' G(R q)`: each image is carried back to the site before the mean is taken
        total = sum(np.einsum("ba,nbk->nak", turn, fields[row]) for turn, row in zip(turns, at, strict=True))
        return np.asarray(np.where(whole[:, None, None], total / len(turns), fields))

    return project
