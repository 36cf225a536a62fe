"""Networks written as Comp3D reads them become the same network."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated.network import marks

from metrocli.formats import hdf5

Metrocli = Callable[..., Any]
JOB = """\
metrocli: 1
job: adjust-network
inputs: {readings: readings.csv, stations: stations.csv, points: points.csv, heights: heights.csv}
instruments: {TS1: {type: total-station}}
output: result.h5
"""
GON = 200 / np.pi


def test_a_network_is_the_same(tmp_path: Path, metrocli: Metrocli) -> None:
    x, height, target, seen = marks(np.random.default_rng(43), 9)
    cor = [f"{1 if i == 0 else 0} P{i} {' '.join(f'{v / 1000:.12g}' for v in x[i])} 0 0 0" for i in (0, 1)]
    away = x[5] - x[4]
    obs = [f"8 P4 P5 {np.remainder(np.arctan2(away[0], away[1]) * GON, 400):.11f} 0.0001 * azimuth from the north"]
    for s in range(4):
        code = 7
        for k in np.flatnonzero(np.isfinite(seen[s, :, 0])):
            a, e, d = seen[s, k]
            ends, up = f"P{4 + s} P{k}", f"{height[s] / 1000:.12g} {target[k] / 1000:.12g}"
            obs += [
                f"{code} {ends} {np.remainder(-a * GON, 400):.11f} 0.001 0.0001 * noise grows towards the station",
                f"6 {ends} {100 - e * GON:.11f} 0.001 0 {up}",
                f"3 {ends} {d / 1000:.12g} 0.002 1e-6 {up}",
                f"-3 {ends} 77 0.002 0 {up} * deactivated",
            ]
            code = 5
    obs.append(f"4 P0 P8 {(x[8, 2] - x[0, 2]) / 1000:.12g} 0.0005")
    for name, lines in (("net.obs", obs), ("net.cor", cor)):
        (tmp_path / name).write_text("\n".join(lines))
        ran = metrocli("import", tmp_path / name, "--from", "comp3d", "--out", tmp_path)
        assert ran.code == 0, ran.err
    assert "deactivated observations are left out" in (tmp_path / "readings.csv").read_text()
    (tmp_path / "job.yaml").write_text(JOB)
    ran = metrocli("adjust-network", tmp_path / "job.yaml")
    assert ran.code == 0, ran.err
    result = hdf5.read(tmp_path / "result.h5")[0]
    points = result.tables["points"]
    order = [int(name[1:]) for name in points.texts("point")]
    assert np.abs(points.stacked("xyz") - x[order]).max() < 1e-3
    head, *rows = (line.split(",") for line in (tmp_path / "readings.csv").read_text().splitlines()[2:])
    whole = [dict(zip(head, row, strict=True)) for row in rows]
    for one in (row for row in whole if row["d_m"] and row["hz_gon"]):
        d = float(one["d_m"])
        assert float(one["sigma_d_mm"]) == pytest.approx(2 + 1e-3 * d, rel=1e-6)
        assert float(one["sigma_hz_mgon"]) == pytest.approx(1 + 0.1 / d * GON, rel=1e-6)


def test_what_is_not_read_is_named(tmp_path: Path, metrocli: Metrocli) -> None:
    (tmp_path / "net.obs").write_text("7 A B 0 0.001 0.0001\n11 A @scan.xyz\n3 A\n")
    ran = metrocli("import", tmp_path / "net.obs", "--from", "comp3d")
    assert ran.code == 3
    for words in ("'11' is not read", "this is not an observation", "sigma_rel multiplies a distance"):
        assert words in ran.err
    (tmp_path / "net.cor").write_text("4 A 1 2 3 0 0 0\n")
    ran = metrocli("import", tmp_path / "net.cor", "--from", "comp3d")
    assert ran.code == 3 and "not a point in space" in ran.err
