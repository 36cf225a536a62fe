"""Distances from a mesh of a block against the closed formula of a block, and the faults of meshes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from simulated.notch import notched

from metrocli.arrays import Array
from metrocli.formats import own_files as meshes
from metrocli.geometry.nearest_triangles import Search
from metrocli.geometry.triangles import Triangles

SIZE = np.array([60.0, 40.0, 20.0])


def block(cells: int = 1) -> Triangles:
    """A block from 0 to SIZE, each face of cells x cells squares."""
    corners, faces, n = [], [], 0
    step = np.arange(cells + 1) / cells
    a, b = (one.ravel() for one in np.meshgrid(step, step, indexing="ij"))
    at = np.arange((cells + 1) ** 2).reshape(cells + 1, -1)
    p, q, r, s = (one.ravel() for one in (at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]))
    squares = np.concatenate([np.stack([p, q, r], 1), np.stack([p, r, s], 1)])
    for axis in range(3):
        for side in (0.0, 1.0):
            face = np.empty((len(a), 3))
            face[:, axis], face[:, (axis + 1) % 3], face[:, (axis + 2) % 3] = side, a, b
            corners.append(face * SIZE)
            faces.append((squares if side else squares[:, ::-1]) + n)
            n += len(a)
    vertices, index = np.unique(np.concatenate(corners).round(9), axis=0, return_inverse=True)
    return Triangles(vertices, index.ravel()[np.concatenate(faces)])


def distance(points: Array) -> Array:
    """Signed distance from the block."""
    beyond = np.abs(points - SIZE / 2) - SIZE / 2
    return np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(axis=1), 0)


def places(n: int = 3000) -> Array:
    return np.random.default_rng(2).uniform(-0.5, 1.5, (n, 3)) * SIZE


def test_distance_of_coarse_and_fine_blocks() -> None:
    for cells in (1, 9):
        found = Search(block(cells)).nearest(places())
        assert np.allclose(found.distance, distance(places()), atol=1e-9)
        inside = places() - found.distance[:, None] * found.normal
        assert np.allclose(distance(inside), 0, atol=1e-9)
        assert np.allclose(np.linalg.norm(found.normal, axis=1), 1)


def test_an_answer_nearby_gives_the_same_as_a_new_search() -> None:
    search, points = Search(block(9)), places()
    before = search.nearest(points)
    for step in (1e-3, 0.3, 5.0):
        moved = points + np.array([step, -step, step])
        again = search.nearest(moved, before)
        assert np.allclose(again.distance, distance(moved), atol=1e-9)
    assert (before.margin > 1e-3).mean() > 0.3


def test_answers_stay_right_along_a_path_of_small_steps() -> None:
    """Triangles near a point are remembered for a way; beyond it they are sought anew, for some points or for all."""
    search, points = Search(block(9)), places(500)
    rng = np.random.default_rng(7)
    found = search.nearest(points)
    for size in (0.01, 0.02, 0.2, 0.2, 0.5, 0.05, 3.0, 0.1):
        points = points + rng.normal(size=points.shape) * size * rng.uniform(0, 1, (len(points), 1))
        found = search.nearest(points, found)
        assert np.allclose(found.distance, distance(points), atol=1e-9)
        others = search.nearest(points)
        assert (found.margin <= others.margin + 1e-9).all()


def test_a_vertex_is_one_though_rounding_differs(tmp_path: Path) -> None:
    mesh = block(2)
    noise = np.random.default_rng(1).normal(size=mesh.corners.shape) * 1e-12
    lines = ["solid part"]
    for face in (mesh.corners + noise).tolist():
        lines += ["facet normal 0 0 0", "outer loop", *(f"vertex {x!r} {y!r} {z!r}" for x, y, z in face)]
        lines += ["endloop", "endfacet"]
    (tmp_path / "part.stl").write_text("\n".join([*lines, "endsolid part", ""]))
    read = meshes.read(tmp_path / "part.stl")
    assert len(read.vertices) == len(mesh.vertices) and not read.open_edges.size


def test_patches_are_the_faces_of_the_block() -> None:
    mesh = block(5)
    assert mesh.patches == 6
    areas = np.bincount(mesh.patch, mesh.areas)
    assert np.allclose(areas, [2400, 2400, 1200, 1200, 800, 800])
    assert abs(mesh.volume - 48000) < 1e-6


def test_open_and_inverted_meshes() -> None:
    mesh = block(2)
    assert not mesh.open_edges.size and not mesh.doubled_edges.size
    opened = Triangles(mesh.vertices, mesh.faces[1:])
    assert opened.open_edges.size == 3
    turned = mesh.faces.copy()
    turned[0] = turned[0, ::-1]
    assert Triangles(mesh.vertices, turned).doubled_edges.size == 3
    assert Triangles(mesh.vertices, mesh.faces[:, ::-1]).volume < 0


def test_the_curvature_at_edges_and_corners_is_the_difference_of_normals() -> None:
    """Also inside, where a notch has an edge towards the points."""
    for mesh, points in ((block(), places(300)), (notched(), np.array([[30.0, 20.0, 30.0], [70.0, 22.0, 40.0]]))):
        search = Search(mesh)
        found = search.nearest(points)
        steps = 1e-4 * np.eye(3)
        ahead, behind = (np.stack([search.nearest(points + s * one).normal for one in steps], axis=2) for s in (1, -1))
        bend = search.bend(found)
        assert (np.abs(bend).max(axis=(1, 2)) > 1e-3).sum() > len(points) / 3
        assert np.allclose((ahead - behind) / 2e-4, bend, atol=1e-6)


def test_facets_of_a_smooth_patch_have_no_curvature_at_their_edges() -> None:
    """A shaft of 24 facets: only its two rims are edges."""
    about = np.arange(24) * np.pi / 12
    ring = 10 * np.column_stack([np.cos(about), np.sin(about), 0 * about])
    here, ahead = np.arange(24), np.roll(np.arange(24), -1)
    walls = np.concatenate([np.column_stack([here, ahead, ahead + 24]), np.column_stack([here, ahead + 24, here + 24])])
    ends = np.concatenate(
        [np.column_stack([0 * here + 48, ahead, here]), np.column_stack([0 * here + 49, here + 24, ahead + 24])]
    )
    top = np.array([0.0, 0.0, 30.0])
    shaft = Search(Triangles(np.concatenate([ring, ring + top, [0 * top, top]]), np.concatenate([walls, ends])))
    beside, beyond = 1.2 * (ring[:2] + ring[1:3]) / 2, 1.2 * ring[:1]
    assert not shaft.bend(shaft.nearest(np.concatenate([beside, beyond]) + [0, 0, 15.0])).any()
    bend = shaft.bend(shaft.nearest(beside + [0, 0, 32.0]))
    assert bend.any(axis=(1, 2)).all()
