"""The nearest point of a mesh of triangles, with its signed distance.

The signed distance is to the nearest point of any triangle; its sign comes from the normal of the face, edge or vertex
where that point lies (Baerentzen and Aanaes 2005). Beyond the rim of an open mesh it is the height above the plane
through that point, so that the surface goes on. Method: docs/algorithms/overstock-fit.md.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from metrocli.arrays import Array, Index, Mask
from metrocli.frozen import dataclass
from metrocli.geometry.triangles import NEXT, Triangles

_CELLS = 20_000
"""Long triangles are divided until no cell is larger than one of so many equal cells of the whole surface"""
_PAIRS = 100_000
"""Pairs of point and triangle in one chunk"""
_CLEAR = 0.05
"""How far a point may move before triangles near it are sought anew, relative to the largest radius of a cell"""
_TOUCHING = 1e-6
"""Distance from an edge [mm] below which a point lies on it, and its distance has no second derivative"""
_NEARLY = 0.3
"""How much farther than the nearest cell the one of a quick answer may be, relative to it"""


@dataclass(frozen=True)
class Near:
    """All triangles that are nearest to a point, or nearly so."""

    points: Array
    row: Index
    """Point of each pair, in order (k,)"""
    face: Index
    """Triangle of each pair (k,)"""
    clear: float
    """How far a point may move with its nearest triangle still among these"""


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
    feature: Index
    """Where the nearest point lies: 0 for the face, 1 to 3 for its edges and 4 to 6 for its vertices (n,)"""
    margin: Array
    """How much farther every other triangle is, at least (n,)"""
    near: Near


@dataclass(frozen=True)
class Search:
    """The search for the triangles of a mesh that are nearest to points."""

    mesh: Triangles

    @cached_property
    def _tree(self) -> tuple[Any, Index, float]:
        """Return a k-d tree of the centres of small cells, the triangle of each cell, and the largest cell radius."""
        from scipy.spatial import cKDTree

        # three times the side of a square of that area, so that usual triangles are not divided
        size = float(np.sqrt(self.mesh.areas.sum() / max(_CELLS, len(self.mesh.faces)))) * 3
        cells, owner = self.mesh.corners, np.arange(len(self.mesh.faces))
        small, owners = [], []
        while len(cells):
            edge = np.linalg.norm(cells[:, NEXT] - cells, axis=2)
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
        # not balanced: cells of a mesh lie evenly, and the tree is built in less time
        return cKDTree(centre, balanced_tree=False), np.concatenate(owners), reach

    @cached_property
    def _place_in_tree(self) -> Index:
        """Return the place of each cell in the order of the tree, where cells near each other follow each other."""
        return np.argsort(self._tree[0].indices)

    def quick(self, points: Array) -> tuple[Array, Array]:
        """Return signed distances (n,) and normals (n, 3) from a triangle that is nearest or nearly so."""
        tree, owner, _ = self._tree
        face = owner[tree.query(points, eps=_NEARLY)[1]]
        return self._of(points, face)[:2]

    def may_be_within(self, points: Array, limit: float) -> Mask:
        """Return whether a triangle may be nearer to points (n, 3) than a limit: not where no cell is near."""
        tree, _, reach = self._tree
        return np.asarray(np.isfinite(tree.query(points, distance_upper_bound=limit + reach)[0]))

    def nearest(self, points: Array, before: Nearest | None = None) -> Nearest:
        """Return the nearest triangle of each point (n, 3).

        `before` is what was found for the same points at places nearby. Where no other triangle can have come nearer
        since, its triangle is taken; where one that was nearly as near can, these are compared.
        """
        if before is not None and np.array_equal(points, before.points):
            return before
        face, margin = np.zeros(len(points), dtype=np.intp), np.full(len(points), -1.0)
        near = Near(points, face[:0], face[:0], _CLEAR * self._tree[2])
        if before is not None:
            near, face = before.near, before.face.copy()
            # point and triangle distances can each change by the move: 2 of it use up what was left of the margin
            # (docs/algorithms/overstock-fit.md)
            margin = before.margin - 2 * np.linalg.norm(points - before.points, axis=1)
            away = np.linalg.norm(points - near.points, axis=1)
            again = (margin < 0) & (away < near.clear)
            pairs = again[near.row]
            row = (np.cumsum(again) - 1)[near.row[pairs]]
            best, least, second, _ = self._compared(points[again], row, near.face[pairs])
            # a triangle that is not among these is farther by at least twice what the point has left to move
            face[again], margin[again] = best, np.minimum(second - least, 2 * (near.clear - away[again]))
        search = np.flatnonzero(margin < 0)
        if search.size:
            near = self._sought(points, search, near, face, margin)
        distance, normal, feature = self._of(points, face)
        return Nearest(points, distance, normal, face, feature, margin, near)

    def bend(self, nearest: Nearest) -> Array:
        """Return the second derivative of the distance by each point (n, 3, 3): of points beyond an edge or a corner.

        There the distance d is that from a line or a point: `(I - e e' - n n')/d` with the edge e and the gradient n.
        """
        bend = np.zeros((len(nearest.points), 3, 3))
        off = np.flatnonzero((nearest.feature > 0) & (np.abs(nearest.distance) > _TOUCHING))
        across = self.mesh.across(nearest.face[off], nearest.feature[off])
        some = across.any(axis=(1, 2))
        off, across = off[some], across[some]
        normal = nearest.normal[off]
        bend[off] = (across - normal[:, :, None] * normal[:, None, :]) / nearest.distance[off, None, None]
        return bend

    def _sought(self, points: Array, search: Index, near: Near, face: Index, margin: Array) -> Near:
        """Fill in the nearest triangles of the points to search, and their margins; return what is near to all."""
        tree, owner, reach = self._tree
        cell = tree.query(points[search])[1]
        # points near each other one after the other: what they have in common is then still in the cache
        order = np.argsort(self._place_in_tree[cell])
        search, cell = search[order], cell[order]
        # twice: this much may point and triangle each come nearer before triangles are sought anew
        bound = np.sqrt(self._square(points[search], owner[cell])) + 2 * near.clear
        # a triangle with no cell in the ball is farther than the bound
        radius = bound + reach
        counts = tree.query_ball_point(points[search], radius, return_length=True)
        others = np.ones(len(points), dtype=bool)
        others[search] = False
        others = others[near.row]
        rows, faces = [near.row[others]], [near.face[others]]
        for part in np.split(np.arange(len(search)), np.flatnonzero(np.diff(np.cumsum(counts) // _PAIRS)) + 1):
            chosen = search[part]
            row, nearest = self._inside(points[chosen], radius[part])
            best, least, second, size = self._compared(points[chosen], row, nearest)
            face[chosen], margin[chosen] = best, np.minimum(second, bound[part]) - least
            kept = size <= (least + 2 * near.clear)[row]
            rows.append(chosen[row[kept]])
            faces.append(nearest[kept])
        row = np.concatenate(rows)
        order = np.argsort(row, kind="stable")
        # the places at which they were sought: `clear` counts from there, also over many small moves
        base = near.points.copy()
        base[search] = points[search]
        return Near(base, row[order], np.concatenate(faces)[order], near.clear)

    def _compared(self, points: Array, row: Index, face: Index) -> tuple[Index, Array, Array, Array]:
        """Return the nearest triangle of each point among pairs ordered by points, and its distance.

        And the distance of the second nearest one, inf without, and the distance of each pair.
        """
        size = np.sqrt(self._square(points[row], face))
        if not len(points):
            return face, size, size, size
        first = np.searchsorted(row, np.arange(len(points)))
        least = np.minimum.reduceat(size, first)
        # backwards, so that of equal distances the first one is written last and stays: the same triangle in each run
        nearest = np.flatnonzero(size == least[row])[::-1]
        best = np.empty(len(points), dtype=np.intp)
        best[row[nearest]] = nearest
        others = size.copy()
        others[best] = np.inf
        return face[best], least, np.minimum.reduceat(others, first), size

    def _inside(self, points: Array, radius: Array) -> tuple[Index, Index]:
        """Return the pairs of a point and a triangle that has a cell within the radius, each once, by points."""
        tree, owner, _ = self._tree
        lists = tree.query_ball_point(points, radius)
        counts = np.fromiter(map(len, lists), dtype=np.intp, count=len(points))
        face = owner[np.concatenate(lists).astype(np.intp)]
        row = np.repeat(np.arange(len(points)), counts)
        # divided triangles have several cells, and would be compared with themselves as the second nearest
        if len(owner) > len(self.mesh.faces):
            row, face = np.divmod(np.unique(row * len(self.mesh.faces) + face), len(self.mesh.faces))
        return row, face

    @cached_property
    def _flat(self) -> Array:
        """Return each triangle in a frame of its own (f, 15): corner a at (0, 0), b at (x, 0), c at (x, y).

        A row is corner a (3), the frame (3, 3), then x of b, x of c, y of c. The frame has the direction of the first
        edge, the one square to it in the plane, and the normal. One row is looked up faster than four arrays.
        """
        a, b, c = np.moveaxis(self.mesh.corners, 1, 0)
        long = np.linalg.norm(b - a, axis=1)
        first = (b - a) / np.maximum(long, 1e-300)[:, None]
        # a triangle without area has any direction beside its first edge
        beside = np.eye(3)[np.abs(first).argmin(axis=1)]
        normal = np.where((self.mesh.areas > 0)[:, None], self.mesh.normals, np.cross(first, beside))
        across = np.cross(normal, first)
        across /= np.maximum(np.linalg.norm(across, axis=1), 1e-300)[:, None]
        shape = np.stack([long, ((c - a) * first).sum(axis=1), ((c - a) * across).sum(axis=1)], axis=1)
        return np.concatenate([a, first, across, normal, shape], axis=1)

    def _edges(self, points: Array, face: Index) -> tuple[Array, Mask, list[Array], list[Array]]:
        """Return the height of each point above the plane of its triangle, and whether it is above the inside.

        And for each edge the squared distance in the plane, and the part of the edge at which it is reached.
        """
        flat = self._flat.take(face, axis=0)
        x, y, height = np.einsum("nij,nj->in", flat[:, 3:12].reshape(-1, 3, 3), points - flat[:, :3])
        b, cx, cy = flat[:, 12:].T
        # without height it has no inside, and its edges give the distance
        gaps, parts, inside = [], [], cy > 0
        for ax, ay, dx, dy in ((0.0, 0.0, b, 0.0), (b, 0.0, cx - b, cy), (cx, cy, -cx, -cy)):
            fx, fy = x - ax, y - ay
            part = np.clip((fx * dx + fy * dy) / np.maximum(dx * dx + dy * dy, 1e-300), 0.0, 1.0)
            gaps.append((fx - part * dx) ** 2 + (fy - part * dy) ** 2)
            parts.append(part)
            inside &= dx * fy - dy * fx >= 0  # on the inner side of the edge
        return height, inside, gaps, parts

    def _square(self, points: Array, face: Index) -> Array:
        """Return the squared distance of each point from its triangle."""
        height, inside, gaps, _ = self._edges(points, face)
        return np.asarray(height**2 + np.where(inside, 0.0, np.minimum(np.minimum(gaps[0], gaps[1]), gaps[2])))

    def _foot(self, points: Array, face: Index) -> tuple[Array, Index, Array]:
        """Return the squared distance of each point from its triangle, and where the nearest point lies.

        That is its feature, 0 for the face, 1 to 3 for the edges and 4 to 6 for the vertices, and the part of the edge.
        """
        height, inside, gaps, parts = self._edges(points, face)
        nearest = np.where(gaps[0] <= np.minimum(gaps[1], gaps[2]), 0, np.where(gaps[1] <= gaps[2], 1, 2))
        at = np.choose(nearest, parts)
        feature = np.where(at <= 0, 4 + nearest, np.where(at >= 1, 4 + (nearest + 1) % 3, 1 + nearest))
        flat = np.where(inside, 0.0, np.choose(nearest, gaps))
        return height**2 + flat, np.where(inside, 0, feature), at

    def _of(self, points: Array, face: Index) -> tuple[Array, Array, Index]:
        """Return the signed distance of each point from its triangle, its outward unit gradient, and the feature."""
        square, feature, part = self._foot(points, face)
        outward = self.mesh.outward(face, feature)
        on_face = feature == 0
        size = np.sqrt(square)
        edge = np.where(feature < 4, np.clip(feature - 1, 0, 2), feature - 4)
        ends = self.mesh.faces[face[:, None], np.stack([edge, NEXT[edge]], axis=1)]
        start, end = self.mesh.vertices[ends[:, 0]], self.mesh.vertices[ends[:, 1]]
        away = points - start - np.where((feature < 4)[:, None], part[:, None] * (end - start), 0.0)
        height = np.einsum("nk,nk->n", away, outward)
        sign = np.where(height < 0, -1.0, 1.0)
        rim = self.mesh.at_rim(face, feature)
        # on an edge itself the direction is 0/0: the normal of the feature takes its place
        clear = (size > 1e-9) & ~rim
        direction = np.where(clear[:, None], sign[:, None] * away / np.maximum(size, 1e-300)[:, None], outward)
        gradient = np.where(on_face[:, None], self.mesh.normals[face], direction)
        length = np.maximum(np.linalg.norm(gradient, axis=1), 1e-300)
        return np.where(rim, height / length, sign * size), gradient / length[:, None], feature
