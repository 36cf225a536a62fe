"""Spatial networks of GNU Gama become the same network, whatever their axes and angles."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated.network import Array, marks

from metrocli.formats import hdf5

Metrocli = Callable[..., Any]
JOB = """\
metrocli: 1
job: adjust-network
inputs: {readings: readings.csv, stations: stations.csv, points: points.csv, heights: heights.csv}
instruments: {TS1: {type: total-station}}
output: result.h5
"""


def dms(degrees: float) -> str:
    whole, rest = divmod(degrees, 1.0)
    minutes, seconds = divmod(rest * 60, 1.0)
    return f"{int(whole)}-{int(minutes)}-{seconds * 60:.9f}"


def xml(axes: str, clockwise: bool, sexagesimal: bool) -> tuple[str, Array]:
    """A network in m, with fixed points 0 to 2, and its true points."""
    x, height, target, seen = marks(np.random.default_rng(41), 9)
    sign = {"e": (0, 1), "w": (0, -1), "n": (1, 1), "s": (1, -1)}
    place = {
        name: [sign[letter][1] * row[sign[letter][0]] for row in x] for name, letter in zip("xy", axes, strict=True)
    }
    lines = []
    for i in range(3):
        at = f'x="{place["x"][i] / 1000:.12g}" y="{place["y"][i] / 1000:.12g}" z="{x[i, 2] / 1000:.12g}"'
        lines.append(f'<point id="{i}" {at} fix="xyz"/>')
    lines += [f'<point id="{i}" adj="xyz"/>' for i in range(3, 9)]
    for s in range(4):
        lines.append(f'<obs from="{4 + s}" from_dh="{height[s] / 1000:.12g}">')
        for k in np.flatnonzero(np.isfinite(seen[s, :, 0])):
            a, e, d = seen[s, k]
            turn = np.remainder(-a if clockwise else a, 2 * np.pi)
            for tag, angle in (("direction", turn), ("z-angle", np.pi / 2 - e)):
                value = dms(np.degrees(angle)) if sexagesimal else f"{angle * 200 / np.pi:.11f}"
                spread = 'stdev="3.24"' if sexagesimal else 'stdev="10"'
                lines.append(f'<{tag} to="{k}" val="{value}" {spread} to_dh="{target[k] / 1000:.12g}"/>')
            lines.append(f'<s-distance to="{k}" val="{d / 1000:.12g}" stdev="2" to_dh="{target[k] / 1000:.12g}"/>')
        lines.append("</obs>")
    rise = (x[8, 2] - x[0, 2]) / 1000
    lines.append(f'<height-differences><dh from="0" to="8" val="{rise:.12g}" stdev="0.5"/></height-differences>')
    angles = "left-handed" if clockwise else "right-handed"
    body = "\n".join(lines)
    name = "http://www.gnu.org/software/gama/gama-local"
    head = f'<gama-local xmlns="{name}"><network axes-xy="{axes}" angles="{angles}"><points-observations>'
    return f"{head}\n{body}\n</points-observations></network></gama-local>", x


@pytest.mark.alike
@pytest.mark.parametrize(
    ("axes", "clockwise", "sexagesimal"), [("ne", True, False), ("en", False, True), ("sw", True, True)]
)
def test_a_network_is_the_same(
    axes: str, clockwise: bool, sexagesimal: bool, tmp_path: Path, metrocli: Metrocli
) -> None:
    text, x = xml(axes, clockwise, sexagesimal)
    (tmp_path / "net.gkf").write_text(text)
    assert metrocli("import", tmp_path / "net.gkf", "--from", "gama-xml", "--out", tmp_path).code == 0
    (tmp_path / "job.yaml").write_text(JOB)
    ran = metrocli("adjust-network", tmp_path / "job.yaml")
    assert ran.code == 0, ran.err
    result = hdf5.read(tmp_path / "result.h5")[0]
    points = result.tables["points"]
    order = [int(name) for name in points.texts("point")]
    assert np.abs(points.stacked("xyz") - x[order]).max() < 1e-3
    assert result.statistics["chi2"] < 1e-3
    sigma = result.tables["residuals"]
    az = [s for s, q in zip(sigma.numbers("sigma"), sigma.texts("quantity"), strict=True) if q == "az"]
    assert az == pytest.approx([np.pi / 200 / 1000] * len(az))


def test_what_is_not_read_is_named(tmp_path: Path, metrocli: Metrocli) -> None:
    text, _ = xml("ne", True, False)
    (tmp_path / "net.gkf").write_text(text.replace("s-distance", "distance").replace('stdev="10"', "", 1))
    ran = metrocli("import", tmp_path / "net.gkf", "--from", "gama-xml", "--out", tmp_path)
    assert ran.code == 3
    assert "<distance> in the set from 4 is not read" in ran.err
    assert "has no stdev" in ran.err
    (tmp_path / "bad.gkf").write_text("<network>")
    assert metrocli("import", tmp_path / "bad.gkf", "--from", "gama-xml", "--out", tmp_path).code == 3


NET = "<gama-local><network><parameters sigma-apr='0.5'/><points-observations>{}</points-observations></network></gama-local>"


def test_a_levelled_way_has_the_noise_of_its_length(tmp_path: Path, metrocli: Metrocli) -> None:
    path = tmp_path / "net.gkf"
    points = "".join(f'<point id="{name}" x="{i}" y="0" z="0" adj="xyz"/>' for i, name in enumerate("AB"))
    ways = '<dh from="A" to="B" val="1.25" dist="4"/><dh from="B" to="A" val="-1.25" stdev="2"/>'
    path.write_text(NET.format(f"{points}<height-differences>{ways}</height-differences>"))
    assert metrocli("import", path, "--from", "gama-xml", "--out", tmp_path).code == 0
    rows = (tmp_path / "heights.csv").read_text().splitlines()[2:]
    assert [float(row.split(",")[3]) for row in rows] == [1.0, 2.0]


def test_a_fixed_point_without_one_coordinate_is_not_lost(tmp_path: Path, metrocli: Metrocli) -> None:
    path = tmp_path / "net.gkf"
    path.write_text(NET.format('<point id="504" x="1" y="2" fix="xy" adj="z"/>'))
    ran = metrocli("import", path, "--from", "gama-xml", "--out", tmp_path)
    assert ran.code == 3 and "point 504 is fixed and lacks a coordinate" in ran.err


def plane(rng: np.random.Generator, angles: bool) -> tuple[str, Array]:
    """A plane network in m with noise, and its points: 0 and 1 fixed, the others without coordinates."""
    places = rng.uniform(0, 300, (6, 2)) + 20000
    lines = [f'<point id="{i}" x="{x:.9f}" y="{y:.9f}" fix="xy"/>' for i, (x, y) in enumerate(places[:2])]
    lines += [f'<point id="{i}" adj="xy"/>' for i in range(2, 6)]
    for i in range(6):
        lines.append(f'<obs from="{i}">')
        others = [k for k in range(6) if k != i]
        away = places[others] - places[i]
        bearing = np.arctan2(away[:, 0], away[:, 1]) * 200 / np.pi
        length = np.linalg.norm(away, axis=1) + rng.normal(0, 2e-3, 5)
        if angles:
            turns = np.remainder(bearing[1:] - bearing[:-1] + rng.normal(0, 1e-3, 4), 400)
            ends = zip(others[:-1], others[1:], turns, strict=True)
            lines += [f'<angle bs="{a}" fs="{b}" val="{turn:.9f}" stdev="10"/>' for a, b, turn in ends]
        else:
            turns = np.remainder(bearing - bearing[0] + rng.normal(0, 1e-3, 5), 400)
            lines += [f'<direction to="{k}" val="{t:.9f}" stdev="10"/>' for k, t in zip(others, turns, strict=True)]
        lines += [f'<distance to="{k}" val="{d:.9f}" stdev="2"/>' for k, d in zip(others, length, strict=True)]
        lines += ['<direction to="unlisted" val="7" stdev="10"/>', "</obs>"]
    body = f"<points-observations>{''.join(lines)}</points-observations>"
    text = f'<gama-local><network axes-xy="en" angles="left-handed">{body}</network></gama-local>'
    return text, places


@pytest.mark.parametrize(("angles", "dof"), [(False, 30 + 30 - 6 - 8), (True, 24 + 30 - 8)])
def test_a_plane_network_is_at_one_height(angles: bool, dof: int, tmp_path: Path, metrocli: Metrocli) -> None:
    text, places = plane(np.random.default_rng(5), angles)
    (tmp_path / "net.gkf").write_text(text)
    ran = metrocli("import", tmp_path / "net.gkf", "--from", "gama-xml", "--out", tmp_path)
    assert ran.code == 0, ran.err
    assert "6 observations of points without fix or adj are left out" in (tmp_path / "readings.csv").read_text()
    (tmp_path / "job.yaml").write_text(JOB + "ranges: {x: 90 km, y: 90 km}\n")
    ran = metrocli("adjust-network", tmp_path / "job.yaml")
    assert ran.code == 0, ran.err
    result = hdf5.read(tmp_path / "result.h5")[0]
    points = result.tables["points"]
    found = points.stacked("xyz")[[points.texts("point").index(str(i)) for i in range(6)]]
    spread = points.stacked(["sx", "sy"])[[points.texts("point").index(str(i)) for i in range(2, 6)]]
    z = (found[2:, :2] - 1000 * places[2:]) / spread
    assert np.abs(found[:, 2]).max() < 1e-9 and np.abs(z).max() < 4 and np.sqrt(np.mean(z**2)) > 0.3
    assert result.statistics["dof"] == dof
    assert 0.5 < result.statistics["chi2"] / dof < 1.7
