"""The ideal part of a job: surfaces or mesh, with the faults that a mesh can have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from metrocli.arrays import Array
from metrocli.errors import InputError
from metrocli.geometry.surfaces import Surface, Surfaces, cone, cylinder, plane, sphere
from metrocli.geometry.triangles import Triangles
from metrocli.tasks.fit_part.nominals import OfMesh, OfSurfaces
from metrocli.tasks.fit_part.settings import CONE, CYLINDER, PLANE, SIZES, NominalFile, SurfaceEntry
from metrocli.words import listed

_NEAR = 1.6
"""Ratio of the sizes of points and mesh up to which they are taken as alike"""
_NEARBY, _COVERED = 20.0, 0.95
"""Largest ratio of two units that is near 1, and the part of an ideal part that its points then span at least"""
_LOCAL = 0.01
"""Ratio of the sizes of points and mesh down to which the points may be those of a small part of the mesh"""
_LARGER = 3.0
"""Ratio of the sizes of points and mesh above which the points are not on that part"""
_SHOWN = 3


def ideal(nominal: NominalFile | Triangles, unit: str = "mm") -> OfSurfaces | OfMesh:
    """Return the ideal part; raises InputError if a mesh is open or inverted, or if surfaces have a unit of a mesh."""
    if isinstance(nominal, NominalFile):
        if unit != "mm":
            raise InputError("nominal_unit: this is of a mesh; surfaces are listed with their units: leave it out")
        return OfSurfaces(Surfaces.of([_surface(surface) for surface in nominal.surfaces]))
    mesh = replace(nominal, vertices=nominal.vertices * SIZES[unit])
    _must_be_closed(mesh)
    return OfMesh(mesh)


def _surface(entry: SurfaceEntry) -> Surface:
    point, sign = np.array(entry.point), -1.0 if entry.material == "outside" else 1.0
    along = np.array(entry.normal or entry.axis or (0.0, 0.0, 1.0))
    if entry.type == PLANE:
        return plane(entry.name, point, along)
    if entry.type == CYLINDER:
        return cylinder(entry.name, point, along, entry.radius or 0.0, sign)
    if entry.type == CONE:
        return cone(entry.name, point, along, entry.half_angle or 0.0, sign)
    return sphere(entry.name, point, entry.radius or 0.0, sign)


def _must_be_closed(mesh: Triangles) -> None:
    opened, doubled = mesh.open_edges, mesh.doubled_edges
    if opened.size or doubled.size:
        places = [_edge_in_words(mesh, int(edge)) for edge in np.concatenate([opened, doubled])[:_SHOWN]]
        what = (
            f"{opened.size} edges have no neighbour that runs the other way"
            if opened.size
            else f"{doubled.size} edges are used twice in one direction"
        )
        raise InputError(
            f"the mesh of the ideal part is open: {what}, e.g. {listed(places)}; "
            "close its holes and make all triangles face outwards, so that inside and outside are known"
        )
    if mesh.volume <= 0:
        raise InputError(
            f"the mesh of the ideal part is inverted: its volume is {mesh.volume:.4g} mm^3, "
            "since its triangles face into the material; turn all triangles over (flip normals) and export it again"
        )


def _edge_in_words(mesh: Triangles, edge: int) -> str:
    face, k = divmod(edge, 3)
    ends = mesh.vertices[mesh.faces[face, [k, (k + 1) % 3]]]
    return " to ".join("(" + ", ".join(f"{value:g}" for value in end) + ")" for end in ends)


def must_be_of_one_size(mesh: Triangles, points: Array, unit: str) -> None:
    """Raise InputError if points and mesh differ in size by the ratio of two units, or the points are far larger.

    Points may lie on a small part of the mesh, so those of a tenth of its size or so need all three extents alike.
    """
    middle = mesh.corners.mean(axis=1)
    # by area: a mesh has most of its triangles where it bends
    weight = mesh.areas / mesh.areas.sum()
    of_mesh = float(np.sqrt(weight @ ((middle - weight @ middle) ** 2).sum(axis=1)))
    of_points = float(np.sqrt(((points - points.mean(axis=0)) ** 2).sum(axis=1).mean()))
    span, reach = np.ptp(mesh.vertices, axis=0), np.ptp(points, axis=0)
    extents = np.sort(reach) / np.maximum(np.sort(span), 1e-300)

    def alike(ratio: float) -> bool:
        extents_of_part = (extents if _LOCAL < ratio <= _NEARBY else np.array([of_points / of_mesh])) / ratio
        # a mesh that is ten times too small is smaller than the raw part in each extent
        if 1 < ratio <= _NEARBY and extents_of_part.min() < _COVERED:
            return False
        return bool((np.abs(np.log(np.maximum(extents_of_part, 1e-300))) < np.log(_NEAR)).all())

    causes = [
        f"the coordinates of the mesh are in {name}, not in {unit}: write `nominal_unit: {name}`"
        for name, size in SIZES.items()
        if name != unit and alike(size / SIZES[unit])
    ] + [
        f"the coordinates of the points are in {name}, though they are read as mm: multiply them by {size:g}"
        for name, size in SIZES.items()
        if name != "mm" and alike(1 / size)
    ]
    if not causes and of_points > _LARGER * of_mesh:
        causes = ["expected points on the part: check `nominal_unit`, and name coded targets in `targets`"]
    if causes:
        of_part, measured = (" x ".join(f"{value:.4g}" for value in sides) for sides in (span / SIZES[unit], reach))
        raise InputError(
            f"the mesh of the ideal part spans {of_part} {unit}, the measured points {measured} mm: "
            + "; or ".join(causes)
        )
