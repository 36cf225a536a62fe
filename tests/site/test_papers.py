"""The page of the papers has the published values, and ours as the jobs give them."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from places import DOCS, SHARED

from metrocli.cli.commands import run
from metrocli.formats import hdf5

PAGE = (DOCS / "papers.md").read_text(encoding="utf-8")
PAPERS = SHARED / "papers"


def cells(section: str) -> list[list[str]]:
    """The rows of the table of a section, without its heading."""
    text = PAGE.split(f"## {section}\n")[1].split("\n## ")[0]
    rows = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("|")]
    return rows[2:]


@pytest.mark.skipif(not PAPERS.is_dir(), reason="../shared/papers is absent")
def test_the_published_values_are_those_of_the_papers() -> None:
    kuprin = (PAPERS / "kuprin-xm60-launch-unit.txt").read_text(encoding="utf-8")
    for row, axis in zip(cells("Kuprin et al."), "XYZ", strict=True):
        (first, second) = re.findall(rf"^{axis} \[mm\]\t(\S+)\t(\S+)", kuprin, re.M)
        assert (row[1], row[2], row[4]) == (first[0], first[1], second[1])
    haertig = (PAPERS / "haertig-m3d3-multilateration.txt").read_text(encoding="utf-8")
    for length, *rest in cells("Härtig et al."):
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
