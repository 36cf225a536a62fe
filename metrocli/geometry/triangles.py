"""Closed meshes of triangles: faults, smooth patches, and normals."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from metrocli.arrays import Array, Index, Mask
from metrocli.frozen import dataclass

_SMOOTH = np.radians(35.0)
"""Angle between neighbouring triangles up to which they belong to one patch"""
_FLAT = np.radians(0.1)
"""Angle between neighbouring triangles of a plane, by rounding of its coordinates"""
_FAR_APART = 10.0
"""Distance of patches that are moved apart, relative to the size of the mesh"""
NEXT = np.array([1, 2, 0])
"""Corner at the end of the edge that begins at each corner"""


@dataclass(frozen=True)
class Triangles:
    """A mesh: vertices (m, 3) and faces (f, 3), counter-clockwise as seen from outside.

    Corner k of face f begins edge 3 f + k. The `feature` of a triangle that is nearest to a point is 0 for its face,
    1 to 3 for its edges and 4 to 6 for its vertices, both in the order of the corners.
    """

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
        # about the mean: the sum holds for any origin of a closed mesh, but far from it the terms cancel
        corners = self.corners - self.vertices.mean(axis=0)
        return float(np.einsum("fk,fk->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6)

    @cached_property
    def _paired(self) -> tuple[Index, Index]:
        """Return the neighbour of each edge (3 f,), -1 without one, and the edges of `doubled_edges`."""
        start, end = self.faces.ravel(), self.faces[:, NEXT].ravel()
        key = np.minimum(start, end) * len(self.vertices) + np.maximum(start, end)
        order = np.argsort(key, kind="stable")
        ordered = key[order]
        first = np.flatnonzero(np.concatenate([[True], ordered[1:] != ordered[:-1]]))
        counts = np.diff(np.append(first, len(ordered)))
        pair = first[counts == 2]
        edge, other = order[pair], order[pair + 1]
        # neighbours that are oriented alike run along their edge in opposite ways
        opposite = start[edge] == end[other]
        neighbour = np.full(len(start), -1, dtype=np.intp)
        neighbour[edge[opposite]], neighbour[other[opposite]] = other[opposite], edge[opposite]
        doubled = np.concatenate([edge[~opposite], order[first[counts > 2]]])
        return neighbour, doubled

    @property
    def open_edges(self) -> Index:
        """Edges without a neighbour that runs the opposite way: holes, or triangles turned over."""
        return np.flatnonzero(self._paired[0] < 0)

    @property
    def doubled_edges(self) -> Index:
        """Edges that two triangles use in the same direction, or that more than two use."""
        return self._paired[1]

    @cached_property
    def _edges(self) -> tuple[Index, Index, Array]:
        """Return the two triangles at each edge that has both, and the angle between their normals [rad], (e,) each."""
        neighbour, _ = self._paired
        edge = np.flatnonzero(neighbour > np.arange(len(neighbour)))
        first, second = edge // 3, neighbour[edge] // 3
        cosine = np.einsum("ek,ek->e", self.normals[first], self.normals[second])
        return first, second, np.arccos(np.clip(cosine, -1, 1))

    def _joined(self, smooth: Mask) -> Index:
        """Return a label for each triangle (f,), the same for those that smooth edges (e,) join."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        first, second, _ = self._edges
        f = len(self.faces)
        links = coo_array((np.ones(int(smooth.sum())), (first[smooth], second[smooth])), shape=(f, f))
        return np.asarray(connected_components(links, directed=False)[1], dtype=np.intp)

    @cached_property
    def patch(self) -> Index:
        """Smooth patch of each triangle (f,), numbered from the largest area."""
        label = self._joined(self._edges[2] < _SMOOTH)
        area = np.bincount(label, self.areas)
        rank = np.empty(len(area), dtype=np.intp)
        rank[np.argsort(-area, kind="stable")] = np.arange(len(area))
        return rank[label]

    @cached_property
    def _facets_of(self) -> Index:
        """Return a label of the smooth surface that each triangle is a facet of (f,): finer than the patches.

        Facets of a surface meet at angles alike; where the angle is twice the usual one of the patch, a surface ends.
        """
        first, _, angle = self._edges
        patch = self.patch[first]
        bent = np.flatnonzero((angle > _FLAT) & (angle < _SMOOTH))
        order = bent[np.lexsort((angle[bent], patch[bent]))]
        present, start, counts = np.unique(patch[order], return_index=True, return_counts=True)
        usual = np.zeros(self.patches)
        # the median of each patch: the middle of its sorted angles
        usual[present] = angle[order[start + counts // 2]]
        return self._joined((angle < _FLAT) | (angle < np.minimum(2 * usual[patch], _SMOOTH)))

    @property
    def patches(self) -> int:
        """Number of smooth patches."""
        return int(self.patch.max()) + 1

    @property
    def neighbours(self) -> Index:
        """Pairs of patches that meet at an edge, both ways and in order (k, 2)."""
        first, second = (self.patch[triangle] for triangle in self._edges[:2])
        across = first != second
        keys = np.concatenate(
            [first[across] * self.patches + second[across], second[across] * self.patches + first[across]]
        )
        return np.column_stack(np.divmod(np.unique(keys), self.patches))

    def _angles(self, faces: Index | slice) -> Array:
        """Return the angles of some triangles at their corners (k, 3)."""
        corners = self.corners[faces]
        ahead = corners[:, NEXT] - corners
        ahead /= np.maximum(np.linalg.norm(ahead, axis=2), 1e-300)[:, :, None]
        return np.asarray(np.arccos(np.clip(-np.einsum("fik,fik->fi", ahead, ahead[:, [2, 0, 1]]), -1, 1)))

    @cached_property
    def _vertex_normals(self) -> Array:
        """Normals of the vertices, the sum of their faces by the angles there, (m, 3), not of length 1."""
        # weighted by angle and not by area: how a flat face is divided into triangles then changes nothing
        angle = self._angles(slice(None))
        weighted = ((angle * self.normals[:, k, None]).ravel() for k in range(3))
        return np.stack(
            [np.bincount(self.faces.ravel(), component, len(self.vertices)) for component in weighted], axis=1
        )

    def interpolated(self, face: Index, places: Array) -> Array:
        """Return the normals (n, 3) of the smooth surface that the triangles stand for, at places (n, 3) on triangles.

        They are interpolated between the normals of the vertices, each the sum of the triangles of the surface by their
        angles there.
        """
        used = np.zeros(len(self.vertices), dtype=bool)
        used[self.faces[face]] = True
        # of a large mesh only the triangles around the faces in question
        around = np.flatnonzero(used[self.faces].any(axis=1))
        # a vertex has a normal for each smooth surface that meets there
        keys = self.faces * len(self.faces) + self._facets_of[:, None]
        present, number = np.unique(keys[around], return_inverse=True)
        angle = self._angles(around)
        sums = [np.bincount(number.ravel(), (angle * self.normals[around, k, None]).ravel()) for k in range(3)]
        of_corner = np.stack(sums, axis=1, dtype=np.float64)[np.searchsorted(present, keys[face])]
        of_corner = of_corner / np.maximum(np.linalg.norm(of_corner, axis=2), 1e-300)[:, :, None]
        to_corner = self.corners[face] - places[:, None]
        opposite = np.cross(to_corner[:, NEXT], to_corner[:, NEXT[NEXT]])
        # barycentric: the part of the triangle opposite to each corner
        weight = np.maximum(np.einsum("nik,nk->ni", opposite, self.normals[face]), 0.0)
        normal = np.einsum("ni,nik->nk", weight, of_corner)
        return np.asarray(normal / np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None])

    @cached_property
    def _at_rim(self) -> Mask:
        """Which vertices lie on an edge without a neighbour (m,)."""
        rim = np.zeros(len(self.vertices), dtype=bool)
        face, corner = np.divmod(self.open_edges, 3)
        rim[self.faces[face, corner]] = rim[self.faces[face, NEXT[corner]]] = True
        return rim

    def at_rim(self, face: Index, feature: Index) -> Mask:
        """Return whether a feature of each triangle is an edge without a neighbour, or an end of one (n,)."""
        of_edge = self._paired[0][3 * face + np.clip(feature - 1, 0, 2)] < 0
        of_vertex = self._at_rim[self.faces[face, np.clip(feature - 4, 0, 2)]]
        return np.where(feature == 0, False, np.where(feature < 4, of_edge, of_vertex))

    @cached_property
    def _patches_at(self) -> Index:
        """Number of patches that meet at each vertex (m,)."""
        met = np.unique(self.faces.ravel() * self.patches + np.repeat(self.patch, 3))
        return np.bincount(met // self.patches, minlength=len(self.vertices))

    def across(self, face: Index, feature: Index) -> Array:
        """Return the projection on the directions across a feature of each triangle, where patches meet (n, 3, 3).

        That is `I - e e'` at an edge e between two patches, I at a corner of three, and 0 elsewhere: a smooth patch
        stands for a surface, and its facets have no edges.
        """
        edge = np.clip(feature - 1, 0, 2)
        neighbour = self._paired[0][3 * face + edge]
        at_edge = (feature > 0) & (feature < 4) & (neighbour >= 0)
        at_edge &= self.patch[face] != self.patch[neighbour // 3]
        # of two patches only an edge passes through the vertex, and the distance bends across it alone
        at_corner = (feature > 3) & (self._patches_at[self.faces[face, np.clip(feature - 4, 0, 2)]] > 2)
        along = self.corners[face, NEXT[edge]] - self.corners[face, edge]
        along /= np.maximum(np.linalg.norm(along, axis=1), 1e-300)[:, None]
        along_edge: Array = (at_edge[:, None] * along)[:, :, None] * along[:, None]
        return np.asarray((at_edge | at_corner)[:, None, None] * np.eye(3) - along_edge)

    @cached_property
    def separation(self) -> float:
        """Distance of the patches of `separated`: far more than its points move [mm]."""
        return _FAR_APART * float(np.linalg.norm(np.ptp(self.vertices, axis=0)))

    def separated(self) -> Triangles:
        """Return the mesh with patch k moved by k times the separation along x, so that no two are neighbours."""
        keys, faces = np.unique(self.patch[:, None] * len(self.vertices) + self.faces, return_inverse=True)
        patch, vertex = np.divmod(keys, len(self.vertices))
        moved = self.vertices[vertex] + self.separation * patch[:, None] * np.eye(3)[0]
        return Triangles(moved, np.asarray(faces.reshape(self.faces.shape), dtype=np.intp))

    def outward(self, face: Index, feature: Index) -> Array:
        """Return the normal of a feature of each triangle (n, 3), not of length 1: face, edge or vertex."""
        edge = 3 * face + np.clip(feature - 1, 0, 2)
        neighbour = self._paired[0][edge]
        of_edge = self.normals[face] + self.normals[np.where(neighbour >= 0, neighbour // 3, face)]
        of_vertex = self._vertex_normals[self.faces[face, np.clip(feature - 4, 0, 2)]]
        # 0 for a face, 1 for an edge, 2 for a vertex
        kind = np.searchsorted([1, 4], feature, side="right")[:, None]
        return np.where(kind == 0, self.normals[face], np.where(kind == 1, of_edge, of_vertex))
