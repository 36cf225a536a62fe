"""A part with a notch: its mesh, points on raw parts that lack material, and what planes leave together, by plain formulas."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.optimize import linprog

from metrocli.geometry.rotations import rotation_from_vector
from metrocli.geometry.triangles import Triangles
from metrocli.tasks.fit_part.nominals import OfMesh

Array = npt.NDArray[np.float64]
CORNERS = np.array([[0, 0], [100, 0], [100, 50], [65, 50], [65, 25], [35, 25], [35, 50], [0, 50]], dtype=float)
CAP = np.array([[0, 1, 4], [0, 4, 5], [1, 2, 3], [1, 3, 4], [0, 5, 6], [0, 6, 7]])
DEPTH, EACH = 70.0, 20
ENDS = np.array([[12.0, 12], [50, 12], [88, 12], [17, 40], [83, 40]])
"""Places on both ends"""


def notched() -> Triangles:
    """A block with a notch along z."""
    n = len(CORNERS)
    vertices = np.concatenate([np.column_stack([CORNERS, np.full(n, z)]) for z in (0.0, DEPTH)])
    here, ahead = np.arange(n), np.roll(np.arange(n), -1)
    walls = [np.column_stack([here, ahead, ahead + n]), np.column_stack([here, ahead + n, here + n])]
    return Triangles(vertices, np.concatenate([CAP[:, ::-1], CAP + n, *walls]))


def planes() -> tuple[Array, Array]:
    """A point and the outward normal of each wall, then of both ends (10, 3)."""
    along = np.roll(CORNERS, -1, axis=0) - CORNERS
    along /= np.linalg.norm(along, axis=1)[:, None]
    normal = np.column_stack([along[:, 1], -along[:, 0], np.zeros(len(along))])
    at = np.column_stack([CORNERS, np.zeros(len(CORNERS))])
    return np.vstack([at, [0, 0, 0], [0, 0, DEPTH]]), np.vstack([normal, [0, 0, -1], [0, 0, 1]])


def raw(seed: int, missing: tuple[float, float], to_edges: float) -> tuple[Array, Array]:
    """Points on the raw part, some surfaces of which are too low, and the plane of each.

    They keep a share `to_edges` of the sides free.
    """
    rng, (at, normal) = np.random.default_rng(seed), planes()
    level = rng.uniform(1.0, 2.0, len(at))
    level[rng.choice(len(at), 2 + seed % 3, replace=False)] -= rng.uniform(*missing)
    places = []
    for here, ahead in zip(CORNERS, np.roll(CORNERS, -1, axis=0), strict=True):
        share, height = rng.uniform(to_edges, 1 - to_edges, (EACH, 1)), rng.uniform(to_edges, 1 - to_edges, EACH)
        places.append(np.column_stack([here + share * (ahead - here), DEPTH * height]))
    places += [np.column_stack([ENDS, np.full(len(ENDS), z)]) for z in (0.0, DEPTH)]
    of = np.repeat(np.arange(len(at)), [len(one) for one in places])
    off = level[of] + 0.1 * rng.normal(size=len(of))
    return np.concatenate(places) + off[:, None] * normal[of], of


def largest_least(points: Array, of: Array) -> float:
    """The largest least overstock of points over their planes: linear programmes, each about the pose before."""
    (at, normal), least, reach = planes(), -np.inf, 0.1
    while len(of) and reach > 1e-5:
        off = ((points - at[of]) * normal[of]).sum(axis=1)
        least = max(least, float(off.min()))
        rows = np.concatenate([normal[of], np.cross(points, normal[of])], axis=1)
        limits = [(-100 * reach, 100 * reach)] * 3 + [(-reach, reach)] * 3 + [(None, None)]
        step = linprog(np.append(np.zeros(6), -1.0), np.column_stack([-rows, np.ones(len(of))]), off, bounds=limits).x
        points, reach = points @ rotation_from_vector(step[3:6]).T + step[:3], reach / 3
    return least


def plane_of(nominal: OfMesh, name: str) -> int:
    """The plane of a patch: that whose wall has the same middle."""
    corners = nominal.triangles.corners[nominal.triangles.patch == nominal.names.index(name)].reshape(-1, 3)
    walls = (CORNERS + np.roll(CORNERS, -1, axis=0)) / 2
    ends = np.column_stack([np.full((2, 2), [50.0, 25.0]), [0.0, DEPTH]])
    middles = np.vstack([np.column_stack([walls, np.full(len(walls), DEPTH / 2)]), ends])
    return int(np.linalg.norm(middles - (corners.max(axis=0) + corners.min(axis=0)) / 2, axis=1).argmin())
