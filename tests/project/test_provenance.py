"""Where results come from, what changed between two, and the same again."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import pytest
from places import SAMPLES

from metrocli.project.provenance.lineage import AS_READ, CHANGED, Origin, shortened
from metrocli.result import Estimate
from metrocli.units import rounded

HEAD = "metrocli: 1\njob: straight-line\nnoise: 0.1 mm\n"
FIRST = HEAD + "inputs: {readings: ../readings.csv}\noutput: ../results/first.h5\n"
SECOND = HEAD + "inputs: {readings: ../more.csv, known: ../results/first.h5}\noutput: ../results/second.h5\n"


@pytest.fixture
def project(job: Path, metrocli: Callable[..., Any]) -> Path:
    """Two jobs that have run; the second uses the result of the first."""
    Path("jobs").mkdir()
    Path("jobs/first.yaml").write_text(FIRST)
    Path("jobs/second.yaml").write_text(SECOND)
    shutil.copy("readings.csv", "more.csv")
    Path("metrocli.yaml").write_text("jobs: [jobs/first.yaml, jobs/second.yaml]\n")
    assert metrocli("run").code == 0
    return Path()


def test_the_lineage_goes_back_to_the_measurements(project: Path, metrocli: Callable[..., Any]) -> None:
    sha = hashlib.sha256(Path("readings.csv").read_bytes()).hexdigest()[:12]
    assert metrocli("lineage", "results/second.h5").out.splitlines() == [
        "results/second.h5  straight-line, done, metrocli 0.1.0",
        "  job jobs/second.yaml",
        f"  more.csv  sha256 {sha}",
        "  results/first.h5  straight-line, done, metrocli 0.1.0",
        "    job jobs/first.yaml",
        f"    readings.csv  sha256 {sha}",
    ]
    data = json.loads(metrocli("lineage", "results/second.h5", "--to", "json").out)
    assert [one["path"] for one in data["inputs"]] == ["more.csv", "results/first.h5"]
    mermaid = metrocli("lineage", "results/second.h5", "--to", "mermaid").out
    assert mermaid.startswith("graph LR\n")
    assert mermaid.count("-->") == 3
    assert metrocli("lineage", "results/second.h5", "--to", "dot").out.count("->") == 3


def test_the_lineage_names_what_is_no_longer_what_was_read(project: Path, metrocli: Callable[..., Any]) -> None:
    Path("more.csv").write_text("point,x_mm,y_mm\na,1,2\n")
    Path("readings.csv").unlink()
    out = metrocli("lineage", "results/second.h5").out
    assert next(line for line in out.splitlines() if "more.csv" in line).endswith("CHANGED SINCE")
    assert next(line for line in out.splitlines() if "readings.csv" in line).endswith("MISSING")


def test_many_images_are_one_line() -> None:
    images = [Origin(Path(f"img/{n}.png"), f"{n}", AS_READ) for n in range(5)]
    others = [Origin(Path("img/5.png"), "5", CHANGED), Origin(Path("img/poses.csv"), "6", AS_READ)]
    found = shortened(Origin(Path("r.h5"), "", AS_READ, origins=(*images, *others)))
    assert {(str(one.path), one.files, one.state) for one in found.origins} == {
        ("img/*.png", 5, AS_READ), ("img/5.png", 1, CHANGED), ("img/poses.csv", 1, AS_READ)}  # fmt: skip


def test_a_difference_names_what_moved_and_why(project: Path, metrocli: Callable[..., Any]) -> None:
    shutil.copy("results/first.h5", "before.h5")
    assert "the same, bit for bit" in metrocli("diff", "before.h5", "results/first.h5").out
    Path("jobs/first.yaml").write_text(FIRST.replace("0.1 mm", "0.2 mm"))
    Path("readings.csv").write_text(Path("readings.csv").read_text().replace("3900", "3950"))
    metrocli("run")
    out = metrocli("diff", "before.h5", "results/first.h5").out
    assert "setting noise: 0.1 mm -> 0.2 mm" in out
    assert "input ../readings.csv changed (61 bytes" in out
    found = json.loads(metrocli("diff", "before.h5", "results/first.h5", "--json").out)
    with h5py.File("before.h5") as a, h5py.File("results/first.h5") as b:
        (first, second) = (file["parameters"][()] for file in (a, b))
    slope = next(one for one in found["moved"] if one["name"] == "slope")
    assert slope["stds"] == pytest.approx(abs(second["value"][0] - first["value"][0]) / first["std"][0])
    assert found["same"] is False
    row = next(line.split() for line in out.splitlines() if line.startswith("slope"))
    assert row[1:3] == [rounded(one, slope["std"])[0] for one in (slope["before"], slope["after"])]


def test_a_result_is_made_again_bit_for_bit(project: Path, metrocli: Callable[..., Any]) -> None:
    before = Path("results/second.h5").read_bytes()
    ran = metrocli("rerun", "results/second.h5", "--output", "again.h5")
    assert (ran.code, ran.out) == (0, "results/second.h5: the same again, bit for bit\n")
    assert Path("results/second.h5").read_bytes() == before
    with h5py.File("again.h5") as again, h5py.File("results/second.h5") as first:
        for name in ("parameters", "covariance", "residuals"):
            assert again[name][()].tobytes() == first[name][()].tobytes()


def test_the_job_of_the_result_counts_and_not_its_file(project: Path, metrocli: Callable[..., Any]) -> None:
    Path("jobs/first.yaml").write_text("something else\n")
    assert metrocli("rerun", "results/first.h5").code == 0


def test_an_input_that_changed_is_named(project: Path, metrocli: Callable[..., Any]) -> None:
    Path("readings.csv").write_text("# a comment changes nothing\n" + Path("readings.csv").read_text())
    assert metrocli("rerun", "results/first.h5").code == 0
    Path("readings.csv").write_text(Path("readings.csv").read_text().replace("3900", "3950"))
    ran = metrocli("rerun", "results/first.h5")
    assert (ran.code, "input ../readings.csv changed" in ran.err) == (3, True)


def test_another_outcome_is_stated(project: Path, metrocli: Callable[..., Any], monkeypatch: Any) -> None:
    def a_last_digit_off(name: str, value: float, std: float, unit: str) -> Estimate:
        return Estimate(name, value * (1 + 1e-15), std, unit)

    monkeypatch.setattr("straight_line.task.Estimate", a_last_digit_off)
    ran = metrocli("rerun", "results/first.h5")
    assert (ran.code, "is another one" in ran.out) == (6, True)


@pytest.mark.alike
@pytest.mark.parametrize("workers", [2, 1])
def test_monte_carlo_is_the_same_with_any_workers(workers: int, tmp_path: Path, metrocli: Callable[..., Any]) -> None:
    shutil.copytree(SAMPLES / "gauge-block", tmp_path / "g", ignore=shutil.ignore_patterns("results"))
    assert metrocli("report-uncertainty", tmp_path / "g/jobs/gum.yaml").code == 0
    assert metrocli("rerun", tmp_path / "g/results/gum.h5", "--workers", workers).code == 0


def test_the_standards_of_results_below_are_stated(project: Path, metrocli: Callable[..., Any]) -> None:
    """The first job states certificates of its readings and of a standard that is not a file; the second rests on both."""
    stated = "certificate: {references: {../readings.csv: PTB-1, ball plate: NPL-2}}\n"
    Path("jobs/first.yaml").write_text(FIRST + stated)
    own = "certificate: {references: {../more.csv: LAB-3, ball plate: NPL-9}}\n"
    Path("jobs/second.yaml").write_text(SECOND + own)
    assert metrocli("run").code == 0
    assert metrocli("report", "results/second.h5").code == 0
    text = Path("results/second.html").read_text(encoding="utf-8")
    for line in (
        "../more.csv: certificate LAB-3",
        "../readings.csv: certificate PTB-1",
        "ball plate: certificate NPL-9",
    ):
        assert line in text
    assert "NPL-2" not in text
    # a result that was replaced since is not what this one rests on
    Path("jobs/first.yaml").write_text(FIRST.replace("0.1 mm", "0.2 mm") + stated)
    assert metrocli("run", "--only", "jobs/first.yaml").code == 0
    assert metrocli("report", "results/second.h5").code == 0
    assert "PTB-1" not in Path("results/second.html").read_text(encoding="utf-8")
