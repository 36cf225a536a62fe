"""Meshes from files in three formats, and files that are none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from metrocli.errors import InputError
from metrocli.formats import own_files as meshes

CORNERS = np.array([[0.0, 0, 0], [10, 0, 0], [0, 10, 0], [0, 0, 10]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


def stl() -> str:
    lines = ["solid part"]
    for face in FACES:
        lines += ["facet normal 0 0 0", "outer loop"]
        lines += [f"vertex {x} {y} {z}" for x, y, z in CORNERS[face]]
        lines += ["endloop", "endfacet"]
    return "\n".join([*lines, "endsolid part", ""])


def obj() -> str:
    lines = [f"v {x} {y} {z}" for x, y, z in CORNERS] + ["f " + " ".join(str(k + 1) for k in face) for face in FACES]
    return "\n".join(lines) + "\n"


def ply() -> str:
    head = (
        f"ply\nformat ascii 1.0\nelement vertex {len(CORNERS)}\nproperty float x\nproperty float y\nproperty float z\n"
    )
    head += f"element face {len(FACES)}\nproperty list uchar int vertex_indices\nend_header\n"
    rows = [f"{x} {y} {z}" for x, y, z in CORNERS] + ["3 " + " ".join(map(str, face)) for face in FACES]
    return head + "\n".join(rows) + "\n"


@pytest.mark.parametrize(
    ("name", "text"), [("a.stl", stl()), ("b.stl", stl().upper()), ("a.obj", obj()), ("a.ply", ply())]
)
def test_a_tetrahedron_is_read(name: str, text: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    mesh = meshes.read(tmp_path / name)
    assert len(mesh.vertices) == 4 and len(mesh.faces) == 4
    assert mesh.volume == pytest.approx(1000 / 6)
    assert not mesh.open_edges.size


def test_what_is_no_mesh_is_refused_with_its_file(tmp_path: Path) -> None:
    for name, text in (("a.stl", ""), ("b.ply", "ply\nnonsense"), ("c.obj", "v 1 2 3\n")):
        (tmp_path / name).write_text(text)
        with pytest.raises(InputError) as error:
            meshes.read(tmp_path / name)
        assert name in str(error.value)


def test_a_binary_stl_that_is_cut_off(tmp_path: Path) -> None:
    rows = np.zeros(len(FACES), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
    rows["corners"] = CORNERS[FACES]
    whole = bytes(80) + np.uint32(len(FACES)).tobytes() + rows.tobytes()
    (tmp_path / "a.stl").write_bytes(whole)
    assert len(meshes.read(tmp_path / "a.stl").faces) == 4
    (tmp_path / "a.stl").write_bytes(whole[:-60])
    with pytest.raises(InputError, match="the file is cut off: 2 of its 4 triangles are there"):
        meshes.read(tmp_path / "a.stl")
