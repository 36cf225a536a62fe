"""Closed meshes of triangles: faults, smooth patches, and normals."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
Index = npt.NDArray[np.intp]
_SMOOTH = np.cos(np.radians(35.0))
"""Cosine of the angle between neighbouring triangles up to which they belong to one patch"""
NEXT = np.array([1, 2, 0])
"""Corner at the end of the edge that begins at each corner"""


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
        start, end = self.faces.ravel(), self.faces[:, NEXT].ravel()
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
        ahead = self.corners[:, NEXT] - self.corners
        ahead /= np.maximum(np.linalg.norm(ahead, axis=2), 1e-300)[:, :, None]
        angle = np.arccos(np.clip(-np.einsum("fik,fik->fi", ahead, ahead[:, [2, 0, 1]]), -1, 1))
        weighted = ((angle * self.normals[:, k, None]).ravel() for k in range(3))
        return np.stack([np.bincount(self.faces.ravel(), one, len(self.vertices)) for one in weighted], axis=1)

    def outward(self, face: Index, feature: Index) -> Array:
        """Return the normal of a feature of each triangle (n, 3), not of length 1: face, edge or vertex."""
        edge = 3 * face + np.clip(feature - 1, 0, 2)
        neighbour = self._paired[0][edge]
        of_edge = self.normals[face] + self.normals[np.where(neighbour >= 0, neighbour // 3, face)]
        of_vertex = self._vertex_normals[self.faces[face, np.clip(feature - 4, 0, 2)]]
        kind = np.searchsorted([1, 4], feature, side="right")[:, None]
        return np.where(kind == 0, self.normals[face], np.where(kind == 1, of_edge, of_vertex))
