"""The loop diagnose --until-clean: what it adds, where it ends, and that a law extends a job like an effect."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

import numpy as np
import pytest

from metrocli.cli.commands import run
from metrocli.formats import hdf5
from metrocli.project import diagnosed
from metrocli.project.until_clean import End


@pytest.fixture
def hall(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Path:
    """The sample in which the lengths of LT5 contain 0.9 um for each radian of azimuth."""
    assert run(["init", str(tmp_path / "lab"), "--sample", "laboratory-effects"]) == 0
    capsys.readouterr()
    for name in ("points", "lengths"):  # of three quarters of its places
        rows = (file := tmp_path / f"lab/data/{name}.csv").read_text().splitlines(keepends=True)
        file.write_text("".join(row for row in rows if not re.match(r"P(3[1-9]|40)", row)))
    return tmp_path / "lab"


def test_one_effect_makes_the_job_clean(hall: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["diagnose", str(hall / "jobs" / "hall.yaml"), "--until-clean", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["verdict"], found["end"], found["outliers"]) == ("clean", "clean", [])
    assert found["noise"]["as_declared"] and found["noise"]["interval"][0] < 1 < found["noise"]["interval"][1]
    (step,) = found["steps"]
    assert step["added"] == ["cable-wrap LT5"] and step["holdout_after"] < 0.6 * step["holdout_before"]
    result, _ = hdf5.read(Path(step["result"]))
    assert step["chi2"] == pytest.approx(result.statistics["chi2"])
    assert Path(step["job"]) == hall / "jobs" / "hall.step1.yaml"
    pull = next(one for one in result.estimates if one.name == "cable-wrap.LT5.pull")
    assert abs(pull.value - 0.9e-3) < 2 * pull.std


@pytest.mark.slow
def test_without_the_cause_a_law_makes_it_clean(hall: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (hall / "metrocli.yaml").write_text("project: hall\njobs: [jobs/hall.yaml]\n")
    assert run(["diagnose", str(hall / "jobs" / "hall.yaml"), "--json"]) == 0
    (law,) = json.loads(capsys.readouterr().out)["laws"]
    # only the beams of LT5, above the points, go round: that the others have the same error is as likely
    places = [law["where"], *(other["where"] for other in law["as_likely"] if other["form"] == "azimuth")]
    assert {} in places and {"tracer": "LT5"} in places
    assert run(["diagnose", str(hall / "jobs" / "hall.yaml"), "--until-clean", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["end"] == "clean"
    added = found["steps"][0]["added"]
    assert len(added) == 1 and added[0].startswith("law ") and "azimuth" in added[0]
    job = Path(found["steps"][0]["job"]).read_text()
    assert "cause: unknown" in job and "law-1" in job
    assert run(["multilaterate", str(hall / "jobs" / "hall.yaml"), "--quiet", "--output", str(hall / "before.h5")]) == 0
    results = (hall / "before.h5", Path(found["steps"][0]["result"]))
    before, after = (hdf5.read(path)[0].tables["points"].stacked("xyz") for path in results)
    shift = found["steps"][0]["result_shift"]
    assert shift["unit"] == "um"
    assert shift["value"] == pytest.approx(1e3 * np.linalg.norm(after - before, axis=1).max(), rel=1e-3)


@pytest.mark.slow
def test_a_law_with_which_the_job_cannot_be_adjusted_ends_it(
    hall: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    (hall / "metrocli.yaml").write_text("project: hall\njobs: [jobs/hall.yaml]\n")
    monkeypatch.setattr(diagnosed, "_adjusts", lambda path: False)
    assert run(["diagnose", str(hall / "jobs" / "hall.yaml"), "--until-clean", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["end"], found["steps"]) == (str(End.NOTHING_GAINED), [])
    assert not (hall / "jobs" / "hall.step1.yaml").exists()


def test_with_a_limit_of_extensions_it_ends_there(hall: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["diagnose", str(hall / "jobs" / "hall.yaml"), "--until-clean", "--most", "0"]) == 2
    assert "--most" in capsys.readouterr().err


@pytest.mark.slow
def test_an_interrupted_search_ends_it_with_the_steps_so_far(
    hall: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first search for laws ends; the one after the first step is interrupted as it begins."""
    (hall / "metrocli.yaml").write_text("project: hall\njobs: [jobs/hall.yaml]\n")
    step = hall / "jobs" / "hall.step1.yaml"

    def attended(heeded: Callable[[], None]) -> AbstractContextManager[None]:
        if step.is_file():
            heeded()
        return nullcontext()

    monkeypatch.setattr("metrocli.cli.diagnose.first_interrupt", attended)
    lengths = hall / "data" / "lengths.csv"
    head, *rows = [one for one in lengths.read_text().splitlines() if not one.startswith("#")]
    cells = [row.split(",") for row in rows]
    for number, cell in enumerate(cells):
        load = number // 5 * 7 % 11 * 0.2
        cell[2] = f"{float(cell[2]) + 0.004 * load**2 * (cell[1] == 'LT3'):.6f}"
        cell.append(f"{load:g}")
    lengths.write_text("\n".join([f"{head},load_kN", *map(",".join, cells)]) + "\n")
    assert run(["diagnose", str(hall / "jobs" / "hall.yaml"), "--until-clean"]) == 0
    told = capsys.readouterr().out
    assert "so far (interrupted)" in told.splitlines()[0] and "ended: interrupted" in told
    assert "law a1*load**2 LT3" in told
