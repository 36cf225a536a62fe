"""The page of the papers has the published values, and ours as the jobs give them."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from places import DOCS, SAMPLES, SHARED

from benchmarks import machine
from metrocli.cli.commands import run
from metrocli.formats import csv, hdf5
from metrocli.tasks.calibrate_machine.files import PATH

PAGE = (DOCS / "papers.md").read_text(encoding="utf-8")
PAPERS = SHARED / "papers"


def cells(section: str) -> list[list[str]]:
    """The rows of the tables of a section, without their headings."""
    text = PAGE.split(f"## {section}\n")[1].split("\n## ")[0]
    tables = re.findall(r"(?:^\|.*\n)+", text, re.M)
    return [line.strip("| ").split(" | ") for table in tables for line in table.splitlines()[2:]]


@pytest.mark.skipif(not PAPERS.is_dir(), reason="../shared/papers is absent")
def test_the_published_values_are_those_of_the_papers() -> None:
    kuprin = (PAPERS / "kuprin-xm60-launch-unit.txt").read_text(encoding="utf-8")
    for row, axis in zip(cells("Kuprin et al."), "XYZ", strict=True):
        (first, second) = re.findall(rf"^{axis} \[mm\]\t(\S+)\t(\S+)", kuprin, re.M)
        assert (row[1], row[2], row[4]) == (first[0], first[1], second[1])
    haertig = (PAPERS / "haertig-m3d3-multilateration.txt").read_text(encoding="utf-8")
    for length, *rest in cells("Härtig et al.")[:3]:
        expected = "\t".join([length.removesuffix(" mm"), *(f"{float(one) / 1000:.4f}" for one in rest)])
        assert expected in haertig, expected
    sanders = (PAPERS / "sanders-on-the-fly-laser-tracker.txt").read_text(encoding="utf-8")
    for row in cells("Sanders et al."):
        assert f"from {row[1].split()[0]} µm to {row[2]} µm" in sanders


def test_our_values_are_those_of_the_sample(tmp_path: Path) -> None:
    place = tmp_path / "launch"
    assert run(["init", str(place), "--sample", "xm60-launch-unit"]) == 0
    found = []
    for name in ("ideal", "errors"):
        assert run(["locate-launch-unit", str(place / f"jobs/{name}.yaml"), "--quiet"]) == 0
        result, _ = hdf5.read(place / f"results/{name}.h5")
        found.append({one.name: (one.value, 2 * one.std) for one in result.estimates})
    for row, axis in zip(cells("Kuprin et al."), "xyz", strict=True):
        assert float(row[3]) == round(found[0][axis][0], 4)
        value, spread = row[5].split(" ± ")
        digits = len(spread.partition(".")[2])
        assert np.allclose([float(value), float(spread)], np.round(found[1][axis], digits), atol=1e-12), (
            axis,
            found[1],
        )


@pytest.mark.slow
def test_our_errors_of_a_machine_are_those_of_the_benchmark() -> None:
    """Three machines without noise, on the path of the sample: before and after, the largest of the three."""
    path = csv.read(SAMPLES / "otf-tracker" / "data" / "path.csv", PATH)
    job = machine.settings(sampling=0.02)
    found = np.array([machine.measured(job, path, seed, exact=True).left() for seed in (1, 2, 3)])
    for row, before, after in zip(cells("Sanders et al."), found.T[::2], found.T[1::2], strict=True):
        assert f"(ours {before.min():.0f} to {before.max():.0f})" in row[1]
        assert float(row[3]) == float(f"{after.max():.1g}")


def test_our_distances_beside_the_ball_bar_are_those_of_the_sample(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The machine's error from the listed places; U as the command prints it; no pair is nearer to the bar's lengths."""
    place = tmp_path / "gear"
    assert run(["init", str(place), "--sample", "gear-m3d3"]) == 0
    assert run(["multilaterate", str(place / "jobs/tip3.yaml"), "--quiet"]) == 0
    points = hdf5.read(place / "results/tip3.h5")[0].tables["points"]
    names, at = points.texts("point"), points.stacked("xyz")
    read = np.loadtxt(place / "data/points.csv", str, delimiter=",", skiprows=2)
    listed = dict(zip(read[:, 0], read[:, 1:].astype(float), strict=True))
    rows = cells("Härtig et al.")
    every = np.triu(np.linalg.norm(at[:, None] - at, axis=2), 1)
    for (bar, *_), (length, pair, alone, spread) in zip(rows[:3], rows[3:], strict=True):
        i, j = np.unravel_index(np.argmin(np.abs(every - float(bar.removesuffix(" mm")))), every.shape)
        assert pair.split() == [names[i], names[j]] and length == f"{every[i, j]:.4f} mm"
        by_machine = np.linalg.norm(listed[names[i]] - listed[names[j]])
        assert float(alone) == pytest.approx(1000 * (by_machine - every[i, j]), abs=0.051)
        capsys.readouterr()
        assert run(["show", str(place / "results/tip3.h5"), "--distance", names[i], names[j], "--json"]) == 0
        assert spread == f"{2000 * json.loads(capsys.readouterr().out)['std']:.2f}"


def test_our_noise_of_a_ball_grid_is_that_of_the_sample(tmp_path: Path) -> None:
    place = tmp_path / "cube"
    assert run(["init", str(place), "--sample", "ball-cube"]) == 0
    assert run(["selfcal-grid", str(place / "jobs/views.yaml"), "--quiet"]) == 0
    stds = hdf5.read(place / "results/views.h5")[0].tables["machine_error"].stacked(("s_ex", "s_ey", "s_ez"))
    text = PAGE.split("## Dang, Lee and Kim\n")[1]
    stated = re.search(r"our machine error has (\S+) times the noise", text)
    assert stated and stated[1] == f"{np.sqrt(np.mean(stds**2)) / 0.005:.3f}"
