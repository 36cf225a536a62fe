"""Closed meshes of triangles: faults, smooth patches, and the nearest point with its signed distance.

The signed distance is to the nearest point of any triangle; its sign comes from the normal of the face, edge or vertex
where that point lies (Baerentzen and Aanaes 2005). Method: docs/algorithms/overstock-fit.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
_SMOOTH = np.cos(np.radians(35.0))
"""Cosine of the angle between neighbouring triangles up to which they belong to one patch"""
_CELLS = 20_000
"""Long triangles are divided until no cell is larger than one of so many equal cells of the whole surface"""
_PAIRS = 100_000
"""Pairs of point and triangle in one chunk"""
_FARTHER = 0.25
"""Radius beyond what is needed, relative to the size of a cell, so that the margin of a triangle is known"""
_NEXT = np.array([1, 2, 0])


@dataclass(frozen=True)
class Nearest:
    """The nearest triangles of points."""

    points: Array
    distance: Array
    """Signed distance, positive outside (n,)"""
    normal: Array
    """Its gradient, of length 1 (n, 3)"""
    face: Index
    """Nearest triangle (n,)"""
    margin: Array
    """How much farther every other triangle is, at least (n,)"""


@dataclass(frozen=True)
class Triangles:
    """A mesh: vertices (m, 3) and faces (f, 3), counter-clockwise as seen from outside."""

    vertices: Array
    faces: Index

    @cached_property
    def corners(self) -> Array:
        """(f, 3, 3): corner, coordinate."""
        return self.vertices[self.faces]

    @cached_property
    def _crossed(self) -> Array:
        a, b, c = np.moveaxis(self.corners, 1, 0)
        return np.cross(b - a, c - a)

    @cached_property
    def areas(self) -> Array:
        """Area of each triangle (f,)."""
        return np.asarray(np.linalg.norm(self._crossed, axis=1) / 2)

    @cached_property
    def normals(self) -> Array:
        """Outward normals (f, 3)."""
        return self._crossed / np.maximum(2 * self.areas, 1e-300)[:, None]

    @property
    def volume(self) -> float:
        """Volume, negative if the triangles are seen from inside: the sum of `a.(b x c)/6`."""
        corners = self.corners - self.vertices.mean(axis=0)
        return float(np.einsum("fk,fk->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6)

    @cached_property
    def _paired(self) -> tuple[Index, Index]:
        """Return the neighbour of each edge (3 f,), -1 without one, and edges used wrongly twice or more often.

        Edge e = 3 face + k runs from corner k to the next.
        """
        start, end = self.faces.ravel(), self.faces[:, _NEXT].ravel()
        key = np.minimum(start, end) * len(self.vertices) + np.maximum(start, end)
        order = np.argsort(key, kind="stable")
        ordered = key[order]
        first = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]]))
        counts = np.diff(np.append(first, len(ordered)))
        pair = first[counts == 2]
        one, other = order[pair], order[pair + 1]
        opposite = start[one] == end[other]
        neighbour = np.full(len(start), -1, dtype=np.intp)
        neighbour[one[opposite]], neighbour[other[opposite]] = other[opposite], one[opposite]
        twice = np.concatenate([one[~opposite], order[first[counts > 2]]])
        return neighbour, twice

    @property
    def open_edges(self) -> Index:
        """Edges (3 face + corner) without a neighbour that runs the opposite way: holes, or triangles turned over."""
        return np.flatnonzero(self._paired[0] < 0)

    @property
    def doubled_edges(self) -> Index:
        """Edges that two triangles use in the same direction."""
        return self._paired[1]

    @cached_property
    def patch(self) -> Index:
        """Smooth patch of each triangle (f,), numbered from the largest area."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        neighbour, _ = self._paired
        edge = np.flatnonzero(neighbour >= 0)
        one, other = edge // 3, neighbour[edge] // 3
        smooth = np.einsum("ek,ek->e", self.normals[one], self.normals[other]) > _SMOOTH
        f = len(self.faces)
        links = coo_array((np.ones(int(smooth.sum())), (one[smooth], other[smooth])), shape=(f, f))
        count, label = connected_components(links, directed=False)
        rank = np.empty(count, dtype=np.intp)
        rank[np.argsort(-np.bincount(label, self.areas), kind="stable")] = np.arange(count)
        return np.asarray(rank[label], dtype=np.intp)

    @property
    def patches(self) -> int:
        """Number of smooth patches."""
        return int(self.patch.max()) + 1

    @cached_property
    def _vertex_normals(self) -> Array:
        """Normals of the vertices, the sum of their faces by the angles there, (m, 3), not of length 1."""
        ahead = self.corners[:, _NEXT] - self.corners
        ahead /= np.maximum(np.linalg.norm(ahead, axis=2), 1e-300)[:, :, None]
        angle = np.arccos(np.clip(-np.einsum("fik,fik->fi", ahead, ahead[:, [2, 0, 1]]), -1, 1))
        weighted = ((angle * self.normals[:, k, None]).ravel() for k in range(3))
        return np.stack([np.bincount(self.faces.ravel(), one, len(self.vertices)) for one in weighted], axis=1)

    def _outward(self, face: Index, feature: Index) -> Array:
        """Return the normal of a feature of each triangle (n, 3), not of length 1: face, edge or vertex."""
        edge = 3 * face + np.clip(feature - 1, 0, 2)
        neighbour = self._paired[0][edge]
        of_edge = self.normals[face] + self.normals[np.where(neighbour >= 0, neighbour // 3, face)]
        of_vertex = self._vertex_normals[self.faces[face, np.clip(feature - 4, 0, 2)]]
        kind = np.searchsorted([1, 4], feature, side="right")[:, None]
        return np.where(kind == 0, self.normals[face], np.where(kind == 1, of_edge, of_vertex))

    @cached_property
    def _tree(self) -> tuple[Any, Index, float]:
        """Return a k-d tree of the centres of small cells, the triangle of each cell, and the largest cell radius."""
        from scipy.spatial import cKDTree

        size = float(np.sqrt(self.areas.sum() / max(_CELLS, len(self.faces)))) * 2
        cells, owner = self.corners, np.arange(len(self.faces))
        small, owners = [], []
        while len(cells):
            edge = np.linalg.norm(cells[:, _NEXT] - cells, axis=2)
            longest = edge.argmax(axis=1)
            long = edge.max(axis=1) > size
            small.append(cells[~long])
            owners.append(owner[~long])
            cells, owner, longest = cells[long], owner[long], longest[long]
            row = np.arange(len(cells))
            a, b, c = (cells[row, (longest + k) % 3] for k in range(3))
            middle = (a + b) / 2
            cells = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
            owner = np.concatenate([owner, owner])
        every = np.concatenate(small)
        centre = every.mean(axis=1)
        reach = float(np.sqrt(((every - centre[:, None]) ** 2).sum(axis=2).max()))
        return cKDTree(centre, balanced_tree=False), np.concatenate(owners), reach

    def quick(self, points: Array) -> tuple[Array, Array]:
        """Return signed distances (n,) and normals (n, 3) from a triangle that is nearest or nearly so."""
        tree, owner, _ = self._tree
        face = owner[tree.query(points)[1]]
        distance, normal, _ = self._of(points, face)
        return distance, normal

    def nearest(self, points: Array, before: Nearest | None = None) -> Nearest:
        """Return the nearest triangle of each point (n, 3).

        `before` is what was found for the same points at places nearby: where no other triangle can have come nearer
        since, its triangle is taken.
        """
        tree, owner, reach = self._tree
        if before is None:
            face = owner[tree.query(points)[1]]
            margin, search = np.zeros(len(points)), np.arange(len(points))
        else:
            face = before.face.copy()
            margin = before.margin - 2 * np.linalg.norm(points - before.points, axis=1)
            search = np.flatnonzero(margin < 0)
        radius = np.sqrt(self._square(points[search], face[search])[0]) + (1 + _FARTHER) * reach
        counts = tree.query_ball_point(points[search], radius, return_length=True)
        for rows in np.split(np.arange(len(search)), np.flatnonzero(np.diff(np.cumsum(counts) // _PAIRS)) + 1):
            if rows.size:
                chosen = search[rows]
                face[chosen], margin[chosen] = self._best(points[chosen], radius[rows], owner, tree)
        distance, normal, _ = self._of(points, face)
        return Nearest(points, distance, normal, face, margin)

    def _best(self, points: Array, radius: Array, owner: Index, tree: Any) -> tuple[Index, Array]:
        """Return the nearest triangle of each point among those with a cell inside its radius.

        And by how much nearer it is than any other one, at least.
        """
        lists = tree.query_ball_point(points, radius)
        counts = np.fromiter(map(len, lists), dtype=np.intp, count=len(points))
        faces = owner[np.concatenate(lists).astype(np.intp)]
        row = np.repeat(np.arange(len(points)), counts)
        # cells of one triangle count once
        key = np.unique(row * len(self.faces) + faces)
        row, faces = np.divmod(key, len(self.faces))
        size = np.sqrt(self._square(points[row], faces)[0])
        first = np.searchsorted(row, np.arange(len(points)))
        order = np.lexsort((size, row))
        best = order[first]
        second = order[np.minimum(first + 1, len(order) - 1)]
        alone = row[second] != row[best]
        beyond = radius - self._tree[2] - size[best]  # a cell out of the ball is farther than its centre less its reach
        gap = np.where(alone, beyond, np.minimum(size[second] - size[best], beyond))
        return faces[best], gap

    def _square(self, points: Array, face: Index) -> tuple[Array, tuple[Array, Index]]:
        """Return the squared distance of each point from its triangle, with the nearest point and its feature.

        Feature 0 is the face, 1 to 3 the edges, 4 to 6 the vertices.
        """
        corners = self.corners[face]
        normal = self.normals[face]
        from_a = points - corners[:, 0]
        height = np.einsum("nk,nk->n", from_a, normal)
        edges = corners[:, _NEXT] - corners
        to_point = points[:, None] - corners
        lengths = np.einsum("nik,nik->ni", edges, edges)
        along = np.clip(np.einsum("nik,nik->ni", to_point, edges) / np.maximum(lengths, 1e-300), 0.0, 1.0)
        on_edge = corners + along[:, :, None] * edges
        gaps = ((points[:, None] - on_edge) ** 2).sum(axis=2)
        nearest = gaps.argmin(axis=1)
        row = np.arange(len(points))
        # inside if the point is on the inner side of every edge
        inner = np.einsum("nik,nik->ni", np.cross(edges, to_point), normal[:, None]) >= 0
        inside = inner.all(axis=1) & (self.areas[face] > 0)
        place = np.where(inside[:, None], points - height[:, None] * normal, on_edge[row, nearest])
        at = along[row, nearest]
        feature = np.where(at <= 0, 4 + nearest, np.where(at >= 1, 4 + (nearest + 1) % 3, 1 + nearest))
        feature = np.where(inside, 0, feature)
        return np.where(inside, height**2, gaps[row, nearest]), (place, feature)

    def _of(self, points: Array, face: Index) -> tuple[Array, Array, Index]:
        """Return signed distance, outward unit gradient and triangle."""
        square, (place, feature) = self._square(points, face)
        size = np.sqrt(square)
        outward = self._outward(face, feature)
        away = points - place
        sign = np.where(np.einsum("nk,nk->n", away, outward) < 0, -1.0, 1.0)
        clear = size > 1e-9
        direction = np.where(clear[:, None], sign[:, None] * away / np.maximum(size, 1e-300)[:, None], outward)
        on_face = feature == 0
        gradient = np.where(on_face[:, None], self.normals[face], direction)
        gradient /= np.maximum(np.linalg.norm(gradient, axis=1), 1e-300)[:, None]
        return sign * size, gradient, face
