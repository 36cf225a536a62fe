"""A task refuses a file that fits far better when it is read in another way, and states what to write."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from benchmarks.hidden import lengths
from metrocli.diagnosis.corrections import corrections
from metrocli.table import Table

NETWORK = """metrocli: 1
job: multilaterate
inputs: {lengths: lengths.csv, points: points.csv, tracers: tracers.csv}
noise: {constant: %g mm, proportional: %g mm/m}
require: {sigma0: "< 2"}
output: out.h5
"""
Spoil = Callable[[str], str]


@pytest.fixture
def network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A network of lengths from plain formulas, with the listed places of points and tracers."""
    monkeypatch.chdir(tmp_path)
    m = lengths.measurement(np.random.default_rng(58), 9)
    constant, proportional = lengths.NOISE
    Path("job.yaml").write_text(NETWORK % (constant, proportional * 1000))
    rows = [f"P{p},T{t},{length!r}" for p, t, length in zip(m.point, m.tracer, m.length.tolist(), strict=True)]
    Path("lengths.csv").write_text("point,tracer,length_mm\n" + "\n".join(rows) + "\n")
    for name, letter, values in (("point", "P", m.nominal), ("tracer", "T", m.said)):
        places = [f"{letter}{i},{x!r},{y!r},{z!r}" for i, (x, y, z) in enumerate(values.tolist())]
        Path(f"{name}s.csv").write_text(f"{name},x_mm,y_mm,z_mm\n" + "\n".join(places) + "\n")
    return Path("job.yaml")


SPOILT = {
    "y and z of the points": ("points.csv", "y_mm,z_mm", "z_mm,y_mm", "y and z are swapped", "write z for y and y for z"),
    "x and y of the tracers": ("tracers.csv", "x_mm,y_mm", "y_mm,x_mm", "x and y are swapped", "write y for x and x for y"),
    "all three": ("points.csv", "x_mm,y_mm,z_mm", "y_mm,z_mm,x_mm", "x, y, z are in the order", "in the headings"),
    "tracers in um": ("tracers.csv", "x_mm,y_mm,z_mm", "x_um,y_um,z_um", "x_um, y_um and z_um are in mm", "write x_mm, y_mm and z_mm"),
}  # fmt: skip


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=() if name == "y and z of the points" else pytest.mark.slow) for name in SPOILT]
)
def test_a_list_with_a_wrong_heading_is_refused(name: str, network: Path, metrocli: Callable[..., object]) -> None:
    file, old, new, words, write = SPOILT[name]
    Path(file).write_text(Path(file).read_text().replace(old, new))
    ran = metrocli("multilaterate", network)
    assert ran.code == 3, (ran.out, ran.err)
    assert f"{file}: error: " in ran.err or f"{file}: {words}" in ran.err
    assert words in ran.err
    assert write in ran.err
    assert not Path("out.h5").exists()


@pytest.mark.slow
def test_a_mirrored_list_is_refused(network: Path, metrocli: Callable[..., object]) -> None:
    rows = [line.split(",") for line in Path("points.csv").read_text().splitlines()]
    mirrored = [rows[0], *([name, x, str(-float(y)), z] for name, x, y, z in rows[1:])]
    Path("points.csv").write_text("\n".join(",".join(row) for row in mirrored) + "\n")
    ran = metrocli("multilaterate", network)
    assert ran.code == 3, ran.err
    assert "y has the wrong sign" in ran.err
    assert "write y with the other sign" in ran.err


@pytest.mark.slow
def test_gross_errors_alone_are_no_wrong_heading(network: Path, metrocli: Callable[..., object]) -> None:
    rows = Path("lengths.csv").read_text().splitlines()
    for at in range(5, len(rows), 9):
        point, tracer, length = rows[at].split(",")
        rows[at] = f"{point},{tracer},{float(length) + 0.7 * (1 + at % 3)!r}"
    Path("lengths.csv").write_text("\n".join(rows) + "\n")
    assert metrocli("multilaterate", network).code == 6


def test_each_correction_undoes_its_mistake() -> None:
    rng = np.random.default_rng(5)
    columns = {name: rng.normal(size=4) for name in ("x", "y", "z", "a", "b")}
    headings = {"x": "x_um", "y": "y_um", "z": "z_um", "a": "a_deg", "b": "b_deg"}
    units = {"x": "mm", "y": "mm", "z": "mm", "a": "rad", "b": "rad"}
    found = [(one.words, changed["t"]) for one, changed in corrections({"t": Table(columns, units, headings=headings)})]
    words = [text for text, _ in found]
    assert len(set(words)) == len(words)
    assert {"x_um, y_um and z_um are in mm", "a_deg and b_deg are in rad", "a and b are swapped"} <= set(words)
    stacked = {text: np.asarray([table.numbers(name) for name in "xyz"]) for text, table in found}
    turned = stacked["turned by 90 degrees about z"]
    assert turned == pytest.approx(np.array([columns["y"], -columns["x"], columns["z"]]))
    proper = [
        np.linalg.det(stacked[text] @ np.linalg.pinv(np.asarray([columns[n] for n in "xyz"])))
        for text in words
        if "turned" in text
    ]
    assert proper == pytest.approx(np.ones(9))
    assert stacked["x_um, y_um and z_um are in mm"] == pytest.approx(1000 * np.asarray([columns[n] for n in "xyz"]))


@pytest.mark.slow
def test_poses_in_metres_under_millimetres_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, metrocli: Callable[..., object]
) -> None:
    metrocli("init", tmp_path, "--sample", "xm60-launch-unit")
    monkeypatch.chdir(tmp_path)
    Path("data/table.csv").write_text(Path("data/table.csv").read_text().replace("x_mm,y_mm,z_mm", "x_um,y_um,z_um"))
    ran = metrocli("locate-launch-unit", "jobs/table.yaml")
    assert ran.code == 3, ran.err
    assert "data/table.csv: error: " in ran.err
    # nothing distinguishes which of the two is wrong; numbers of a larger unit than their heading are likelier
    assert "x_um, y_um and z_um are in mm: with this corrected" in ran.err
    assert "as good: data/table.csv: distance_mm is in um" in ran.err


@pytest.mark.slow
def test_an_overload_marker_is_no_wrong_unit(tmp_path: Path, metrocli: Callable[..., object]) -> None:
    """One of four distances is beyond all: all lengths a thousand times smaller would only take it out of the fit."""
    assert metrocli("init", tmp_path / "unit", "--sample", "xm60-launch-unit").code == 0
    file, job = tmp_path / "unit/data/table.csv", tmp_path / "unit/jobs/table.yaml"
    head, *rows = [line.split(",") for line in file.read_text().splitlines() if not line.startswith("#")]
    rows[0][head.index("distance_mm")] = "9999.999"
    file.write_text("\n".join(map(",".join, [head, *rows])) + "\n")
    ran = metrocli("locate-launch-unit", job)
    assert ran.code == 6, (ran.out, ran.err)
    assert "distance of A1" in ran.err
    assert " in um" not in ran.err
    told = metrocli("diagnose", job, "--json")
    assert '"verdict": "mistaken"' not in told.out


@pytest.mark.slow
def test_a_list_in_another_order_makes_the_result_doubtful(tmp_path: Path, metrocli: Callable[..., object]) -> None:
    """Probing points in the reverse order: lengths fit, and each correction is that of another point."""
    assert metrocli("init", tmp_path / "gear", "--sample", "gear-m3d3").code == 0
    file, job = tmp_path / "gear/data/probing.csv", tmp_path / "gear/jobs/tip3.yaml"
    head, *rows = [line.split(",") for line in file.read_text().splitlines() if not line.startswith("#")]
    reverse = [[*row[:2], *other[2:]] for row, other in zip(rows, rows[::-1], strict=True)]
    file.write_text("\n".join(map(",".join, [head, *reverse])) + "\n")
    ran = metrocli("multilaterate", job)
    assert ran.code == 6, (ran.out, ran.err)
    assert "rows in another order" in ran.out + ran.err
