"""Nominal surfaces of a part: ideal ones, and meshes with the patches that a fit uses of them."""

from __future__ import annotations

from dataclasses import field, replace
from functools import cached_property

import numpy as np

from metrocli.adjust.medians import medians_of
from metrocli.arrays import Array, Index, Mask
from metrocli.frozen import dataclass
from metrocli.geometry.nearest_triangles import Nearest, Search
from metrocli.geometry.surfaces import Shape, Surfaces
from metrocli.geometry.triangles import Triangles
from metrocli.tasks.fit_part.levels import OUTLIER_LIMIT, robust_step, scatter_of
from metrocli.tasks.fit_part.stock import Apart, Stock

_ROUNDS = 20
_LEVELLED = 2
"""Robust steps before each round: the patches need not be parallel to the raw surfaces where the search ended"""
_BESIDE = 2.0
"""How far a point may be from its own patch, relative to the largest overstock: it may lie beyond two edges"""
_EACH = 500
"""Points of each patch from which the levels are found, at most"""


def on_own_patches(stock: Stock, patches: Apart, to_part: Array) -> tuple[Stock, Mask]:
    """Return points on patches that are alone, each on the one nearby whose level it has, and which have one (n,).

    The levels are medians after a robust step of the pose (6,) in which each patch has its own. With some points of
    each patch both are found anew until no point changes its patch. Then all points follow.
    """
    alone, count = replace(stock, nominal=patches), len(patches.names)
    some = alone.of(_some_of_each(alone.surface))
    for _ in range(_ROUNDS):
        for _ in range(_LEVELLED):
            local = some.at(to_part)
            step, _ = robust_step(local.rows, local.overstock, some.surface, count)
            to_part = local.moved(to_part, step)
        level = medians_of(some.at(to_part).overstock, some.surface, count)
        surface = _of_nearest_level(some, patches, to_part, level)
        if np.array_equal(surface, some.surface):
            break
        some = replace(some, surface=surface)
    patched = replace(alone, surface=_of_nearest_level(alone, patches, to_part, level))
    deviation = patched.at(to_part).overstock - level[patched.surface]
    return patched, np.abs(deviation) <= OUTLIER_LIMIT * scatter_of(
        deviation, patched.surface, count, np.zeros(len(deviation))
    )


def _some_of_each(surface: Index) -> Index:
    """Return the rows of some points of each surface, drawn at random."""
    order = np.random.default_rng(1).permutation(len(surface))
    order = order[np.argsort(surface[order], kind="stable")]
    # the number of each point among those of its surface, whose first one the search finds
    place = np.arange(len(order)) - np.searchsorted(surface[order], surface[order])
    return np.sort(order[place < _EACH])


def _of_nearest_level(stock: Stock, patches: Apart, to_part: Array, level: Array) -> Index:
    """Return the patch of each point (n,) from whose level (S,) it is least far; nan is that of one without points."""
    local = stock.at(to_part)
    row, patch = patches.beside(local.points, stock.surface, _BESIDE * float(np.abs(local.overstock).max()))
    beside = patches.shape(local.points[row], patch).distance
    # its own patch first: a stable order keeps a point there where another patch is as near
    row, patch = np.append(np.arange(len(local.points)), row), np.append(stock.surface, patch)
    deviation = np.abs(np.append(local.overstock, beside) - level[patch])
    order = np.lexsort((deviation, row))
    _, first = np.unique(row[order], return_index=True)
    return np.asarray(patch[order[first]])


@dataclass(frozen=True)
class OfSurfaces:
    """Ideal geometry from planes, cylinders, cones and spheres without limits."""

    surfaces: Surfaces

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the surfaces."""
        return self.surfaces.names

    @property
    def middle(self) -> Array:
        """Middle of the points that the surfaces are given by (3,)."""
        origin = self.surfaces.origin
        return np.asarray((origin.max(axis=0) + origin.min(axis=0)) / 2)

    def shape(self, points: Array, surface: Index) -> Shape:
        """Return distance, normal and curvature at points (n, 3), each on the surface of its index (n,)."""
        return self.surfaces.shape(points, surface)

    def smooth_normals(self, points: Array, surface: Index) -> Array:
        """Return the normals at points (n, 3), each on the surface of its index (n,)."""
        return self.shape(points, surface).normal

    def nearest(self, points: Array, levels: Array | float = 0.0) -> Index:
        """Return the surface of each point (n, 3): the one whose overstock is nearest to its level (S,)."""
        return self.surfaces.nearest(points, levels)

    def quick(self, points: Array, surface: Index | None) -> tuple[Array, Array]:
        """Return distances and normals at points (B, n, 3), each on its surface (n,), or on the nearest if None."""
        return self.surfaces.distances(points, self.surfaces.nearest(points) if surface is None else surface)

    def off_centre(self, points: Array, surface: Index | None) -> float:
        """Return how far the points of the planes are from the point that the nominal gives of each [mm].

        Root mean square over the planes, in their planes.
        """
        if surface is None:
            return 0.0
        gaps = []
        for number in np.unique(surface):
            if self.surfaces.sine[number] == -1.0:
                gap = points[surface == number].mean(axis=0) - self.surfaces.origin[number]
                axis = self.surfaces.axis[number]
                gaps.append(float(((gap - axis * (gap @ axis)) ** 2).sum()))
        return float(np.sqrt(np.mean(gaps))) if gaps else 0.0

    def apart(self) -> None:
        """Return None: surfaces without limits do not know each other."""

    def reversed(self, surface: int) -> OfSurfaces:
        """Return the geometry with the material of one surface on the other side."""
        return OfSurfaces(self.surfaces.reversed(surface))


@dataclass(frozen=True)
class OfMesh:
    """Ideal geometry from a closed mesh of triangles; its surfaces are the smooth patches of the mesh."""

    triangles: Triangles
    before: dict[int, Nearest] = field(default_factory=dict, compare=False, repr=False)
    """The last answer for each number of points"""

    @cached_property
    def names(self) -> tuple[str, ...]:
        """`face-1`, `face-2`, ...: the smooth patches of the mesh, the largest first."""
        return tuple(f"face-{n + 1}" for n in range(self.triangles.patches))

    @cached_property
    def _search(self) -> Search:
        return Search(self.triangles)

    @property
    def middle(self) -> Array:
        """Middle of the mesh (3,)."""
        corners = self.triangles.vertices
        return np.asarray((corners.max(axis=0) + corners.min(axis=0)) / 2)

    def shape(self, points: Array, surface: Index) -> Shape:
        """Return distance, normal and curvature at points (n, 3); triangles have one at edges and corners alone."""
        nearest = self._nearest(points)
        return Shape(nearest.distance, nearest.normal, self._search.bend(nearest))

    def smooth_normals(self, points: Array, surface: Index) -> Array:
        """Return the normals of the smooth surface that the triangles stand for, at points (n, 3)."""
        nearest = self._nearest(points)
        return self.triangles.interpolated(nearest.face, points - nearest.distance[:, None] * nearest.normal)

    def nearest(self, points: Array, levels: Array | float = 0.0) -> Index:
        """Return the patch of the triangle nearest to each point (n, 3)."""
        return np.asarray(self.triangles.patch[self._nearest(points).face], dtype=np.intp)

    def _nearest(self, points: Array) -> Nearest:
        """Return the nearest triangles; a fit asks for the same points again and again, a little moved."""
        nearest = self._search.nearest(points, self.before.get(len(points)))
        self.before[len(points)] = nearest
        return nearest

    def may_be_within(self, points: Array, limit: float) -> Mask:
        """Return whether the mesh may be nearer to points (n, 3) than a limit."""
        return self._search.may_be_within(points, limit)

    def apart(self) -> OfPatches:
        """Return the ideal geometry in which a point knows its own patch only."""
        triangles = self.triangles
        return OfPatches(self.names, triangles.separated(), triangles.separation, triangles.neighbours)

    def quick(self, points: Array, surface: Index | None) -> tuple[Array, Array]:
        """Return distances and normals at points (B, n, 3) from a triangle nearby."""
        distance, normal = self._search.quick(points.reshape(-1, 3))
        return distance.reshape(points.shape[:-1]), normal.reshape(points.shape)

    def off_centre(self, points: Array, surface: Index | None) -> float:
        """Return 0: the surfaces of a mesh have limits."""
        return 0.0


@dataclass(frozen=True)
class OfPatches:
    """The patches of a mesh, each alone: beyond its edges it goes on, and no other patch holds its points.

    Patches are moved apart along x, and points with them, so that one search finds the nearest triangles of all.
    """

    names: tuple[str, ...]
    triangles: Triangles
    """Patch k is moved by k times the separation along x"""
    separation: float
    neighbours: Index
    """Pairs of patches that meet at an edge, both ways and in order (k, 2)"""

    @cached_property
    def _mesh(self) -> OfMesh:
        return OfMesh(self.triangles)

    def shape(self, points: Array, surface: Index) -> Shape:
        """Return distance and normal at points (n, 3), each on the patch of its index (n,)."""
        return self._mesh.shape(self._moved(points, surface), surface)

    def smooth_normals(self, points: Array, surface: Index) -> Array:
        """Return the normals of the smooth surface that the triangles stand for, at points (n, 3)."""
        return self._mesh.smooth_normals(self._moved(points, surface), surface)

    def apart(self) -> None:
        """Return None: they are."""

    def beside(self, points: Array, surface: Index, limit: float) -> tuple[Index, Index]:
        """Return pairs (k,) of a point (n, 3) and another patch that may be within a limit of it.

        Patches are reached from that of the point (n,), from neighbour to neighbour within the limit.
        """
        # a pair of point and patch as one number: sets of pairs are then sets of numbers
        count, seen = len(self.names), np.arange(len(points)) * len(self.names) + surface
        nearby, reached = seen[:0], seen
        while reached.size:
            reached = np.setdiff1d(self._next_to(*np.divmod(reached, count)), seen)
            seen = np.concatenate([seen, reached])
            row, patch = np.divmod(reached, count)
            reached = reached[self._mesh.may_be_within(self._moved(points[row], patch), limit)]
            nearby = np.concatenate([nearby, reached])
        row, patch = np.divmod(nearby, count)
        return row, patch

    def _next_to(self, row: Index, patch: Index) -> Index:
        """Return the pairs of rows and the neighbours of their patches, each as row times the number of patches."""
        first, last = (np.searchsorted(self.neighbours[:, 0], patch, side) for side in ("left", "right"))
        pair = np.repeat(np.arange(len(row)), last - first)
        # each pair has the run of neighbours from its first to its last, counted on
        place = np.arange(len(pair)) + np.repeat(first - np.cumsum(last - first) + last - first, last - first)
        return np.asarray(row[pair] * len(self.names) + self.neighbours[place, 1])

    def _moved(self, points: Array, surface: Index) -> Array:
        return np.asarray(points + self.separation * surface[:, None] * np.eye(3)[0])
