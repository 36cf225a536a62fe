"""Meshes of turned parts: a turn about their axis, which only their facets would hold, is open."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from simulated.castings import Array, turn
from tasks.fit_part.test_faults import stl
from tasks.fit_part.test_fit import Metrocli

from metrocli.geometry.triangles import Triangles

RADIUS, LENGTH = 50.0, 200.0


def outline(sides: int, flat: float) -> Array:
    """Corners of the section of a shaft (n, 2), with a flat of some depth [mm] across y where it is not 0."""
    angles = 2 * np.pi * (np.arange(sides) + 0.3) / sides
    half = np.arccos(1 - flat / RADIUS)
    if flat:
        angles = np.concatenate([[half], angles[(angles > half + 0.01) & (angles < 2 * np.pi - half - 0.01)], [-half]])
    return RADIUS * np.stack([-np.sin(angles), np.cos(angles)], axis=1)


def shaft(section: Array) -> Triangles:
    """The shaft as a closed mesh."""
    n = len(section)
    low, high = np.pad(section, ((0, 0), (0, 1))), np.pad(section, ((0, 0), (0, 1)), constant_values=LENGTH)
    high[:, :2] = section
    side = [face for i in range(n) for face in ([i, (i + 1) % n, (i + 1) % n + n], [i, (i + 1) % n + n, i + n])]
    ends = [face for i in range(1, n - 1) for face in ([0, i + 1, i], [n, n + i, n + i + 1])]
    return Triangles(np.concatenate([low, high]), np.array(side + ends))


def on_shaft(section: Array) -> Array:
    """Points 2 to 3 mm off the facets and ends, in a frame turned a little (300, 3)."""
    rng = np.random.default_rng(5)
    start, end = section, np.roll(section, -1, axis=0)
    length = np.linalg.norm(end - start, axis=1)
    facet, share = rng.choice(len(section), 240, p=length / length.sum()), rng.uniform(0, 1, (240, 1))
    outward = (end - start)[facet][:, ::-1] * [1, -1] / length[facet, None]
    side = start[facet] + share * (end - start)[facet] + outward * rng.uniform(2, 3, (240, 1))
    places = [np.column_stack([side, rng.uniform(0, LENGTH, 240)])]
    for z in (-rng.uniform(2, 3, 30), LENGTH + rng.uniform(2, 3, 30)):
        places.append(np.column_stack([rng.uniform(-30, 30, (30, 2)), z]))
    return np.asarray(np.concatenate(places) @ turn(np.array([0.01, -0.02, 0.03])).T + [3, -2, 1])


def job_of(folder: Path, section: Array) -> Path:
    stl(folder / "part.stl", shaft(section).corners)
    rows = [f"P{n},{x:.6f},{y:.6f},{z:.6f},0.02" for n, (x, y, z) in enumerate(on_shaft(section).tolist())]
    (folder / "points.csv").write_text("\n".join(["point,x_mm,y_mm,z_mm,sigma_mm", *rows]) + "\n")
    job = folder / "job.yaml"
    job.write_text(
        "metrocli: 1\njob: fit-part\ninputs: {points: points.csv, nominal: part.stl}\n"
        "overstock: {minimum: 0.5 mm, aim: even}\noutput: part.h5\n"
    )
    return job


@pytest.mark.parametrize("sides", [24, pytest.param(96, marks=pytest.mark.slow)])
def test_the_turn_of_a_shaft_about_its_axis_is_open(sides: int, tmp_path: Path, metrocli: Metrocli) -> None:
    job = job_of(tmp_path, outline(sides, 0.0))
    ran = metrocli("fit-part", job)
    assert ran.code == 4 and "undetermined, since no overstock changes: a turn about the direction z" in ran.err
    ran = metrocli("fit-part", job, "--set", "overstock.aim=least-motion")
    assert ran.code == 0 and "there the part stays where it was" in ran.err


def test_a_flat_determines_it(tmp_path: Path, metrocli: Metrocli) -> None:
    """Its edges are sharper than those between facets, though of less than 35 degrees."""
    ran = metrocli("fit-part", job_of(tmp_path, outline(48, 2.0)))
    assert ran.code == 0, ran.err


def test_normals_between_those_of_the_vertices() -> None:
    section = outline(24, 0.0)
    mesh = shaft(section)
    side = np.flatnonzero(np.abs(mesh.normals[:, 2]) < 0.5)
    middle = mesh.corners[side].mean(axis=1)
    radial = middle * [1, 1, 0] / np.linalg.norm(middle[:, :2], axis=1)[:, None]
    assert np.allclose(mesh.interpolated(side, middle), radial, atol=1e-9)
    assert np.abs(mesh.normals[side] - radial).max() > 0.04
    ends = np.flatnonzero(np.abs(mesh.normals[:, 2]) > 0.5)
    assert np.allclose(mesh.interpolated(ends, mesh.corners[ends].mean(axis=1)), mesh.normals[ends], atol=1e-12)
