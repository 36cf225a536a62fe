"""The command line: what is printed where, exit codes, options."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import pytest
from resealing import resealed

from metrocli import __version__
from metrocli.errors import UndeterminedError

Metrocli = Callable[..., Any]


def test_a_job_prints_its_result(job: Path, metrocli: Metrocli) -> None:
    ran = metrocli("straight-line", job)
    assert (ran.code, ran.err) == (0, "")
    assert "slope   0.000980  ± 0.000045  rad  (0.980 ± 0.045 mm/m)" in ran.out
    assert "offset     1.030  ± 0.084     mm" in ran.out
    assert "observations 4, unknowns 2, dof 2, sigma0 0.9487" in ran.out
    assert "residual [mm]" in ran.out
    assert ran.out.endswith("result: results/line.h5\n")


def test_json_and_nothing_else_on_stdout(job: Path, metrocli: Metrocli) -> None:
    Path("readings.csv").write_text("point,x_mm,y_mm,note\na,0,1,\nb,1,2,\nc,2,4,\n")
    ran = metrocli("straight-line", job, "--json", "--verbose", "--set", "require.sigma0=< 100")
    summary = json.loads(ran.out)
    assert set(summary) >= {"kind", "status", "result", "estimates", "statistics", "warnings", "requirements"}
    assert summary["status"] == "done"
    assert summary["requirements"][0]["met"] is True
    assert "'note' is not used" in summary["warnings"][0]
    assert "warning: " in ran.err
    assert summary == json.loads(metrocli("show", summary["result"], "--json").out)


def test_commands_that_write_files_list_them_in_json(job: Path, metrocli: Metrocli) -> None:
    assert metrocli("straight-line", job, "-q").code == 0
    written = {
        ("report",): ["results/line.html"],
        ("plot", "correlation"): ["results/line.correlation.svg"],
        ("export", "--to", "csv"): ["results/line.residuals.csv"],
    }
    for (command, *more), files in written.items():
        ran = metrocli(command, "results/line.h5", *more, "--json")
        assert (ran.code, ran.err, json.loads(ran.out)["files"]) == (0, "", files)
    assert "correlation" in json.loads(metrocli("plot", "results/line.h5", "--json").out)["figures"]
    again = json.loads(metrocli("rerun", "results/line.h5", "--json").out)
    assert again["same"] is True and again["made_by"] == again["made_again_by"] == __version__


def test_numbers_that_are_none_are_null_in_json() -> None:
    from metrocli.cli.summary import as_json

    assert json.loads(as_json({"a": [float("nan"), float("inf"), 1.0]})) == {"a": [None, None, 1.0]}


def test_quiet_prints_nothing(job: Path, metrocli: Metrocli) -> None:
    ran = metrocli("straight-line", job, "--quiet")
    assert (ran.code, ran.out, ran.err) == (0, "", "")


def test_a_criterion_that_is_not_met(job: Path, metrocli: Metrocli) -> None:
    job.write_text(job.read_text() + "require: {sigma0: '< 0.5', slope.std: ['< 1 mrad', '> 0 rad'], rms.mm: '<= 1'}\n")
    ran = metrocli("straight-line", job)
    assert ran.code == 6
    assert "required sigma0 < 0.5: NOT met (0.948683)" in ran.out
    assert "required slope.std < 1 mrad: met" in ran.out
    assert Path("results/line.h5").exists()
    assert metrocli("straight-line", job, "--quiet").err == "required sigma0 < 0.5: NOT met (0.948683)\n"


@pytest.mark.parametrize(
    ("requirement", "message", "hint"),
    [
        ("{sigma: '< 1'}", "the result has no value 'sigma'", "did you mean 'sigma0'?"),
        ("{slope: '< 1'}", "1 has no unit", "write e.g. '< 1 rad'"),
        ("{slope: '< 1 mm'}", "'mm' is the unit of a length", "allowed: rad"),
        ("{sigma0: '< 1 mm'}", "sigma0 has the unit ''", "write the limit without a unit"),
    ],
)
def test_a_criterion_on_nothing_writes_nothing(
    requirement: str, message: str, hint: str, job: Path, metrocli: Metrocli
) -> None:
    job.write_text(job.read_text() + f"require: {requirement}\n")
    ran = metrocli("straight-line", job)
    assert ran.code == 3
    assert "line.yaml:5:" in ran.err
    assert message in ran.err
    assert hint in ran.err
    assert not Path("results").exists()


def test_set_changes_the_job_and_the_stored_text(job: Path, metrocli: Metrocli) -> None:
    ran = metrocli(
        "straight-line", job, "--set", "noise=0.2 mm", "--set", "limits.range=[0 mm, 1 m]", "--set", "title=a: b"
    )
    assert ran.code == 3  # a title is not a mapping
    ran = metrocli(
        "straight-line", job, "--set", "noise=0.2 mm", "--set", "limits.range=[0 mm, 1 m]", "--set", "title='a: b'"
    )
    assert ran.code == 0
    with h5py.File("results/line.h5") as file:
        text = file["job"].asstr()[()]
        assert file.attrs["title"] == "a: b"
    assert "noise: 0.2 mm\n" in text
    assert "limits:\n  range:\n    - 0 mm\n    - 1 m\n" in text
    Path("again.yaml").write_text(text)
    assert metrocli("straight-line", "again.yaml", "--output", "again.h5").code == 0
    with h5py.File("again.h5") as again, h5py.File("results/line.h5") as first:
        assert again["job"].asstr()[()] == text
        assert (again["parameters"][()] == first["parameters"][()]).all()


@pytest.mark.parametrize(
    ("override", "code", "message"),
    [
        ("noise", 2, "write it as key.path=value"),
        ("=1", 2, "write it as key.path=value"),
        ("noise=0,1 mm", 3, "--set noise=0,1 mm: error: noise: '0,1 mm' has a decimal comma"),
        ("nois=0.1 mm", 3, "--set nois=0.1 mm: error: unknown key 'nois'"),
        ("noise=[", 3, "--set noise=["),
        ("noise=", 3, "there is no value"),
        ("inputs.readings=none.csv", 3, "no such file: none.csv"),
    ],
)
def test_a_wrong_set(override: str, code: int, message: str, job: Path, metrocli: Metrocli) -> None:
    ran = metrocli("straight-line", job, "--set", override)
    assert (ran.code, ran.out) == (code, "")
    assert message in ran.err


def test_a_dry_run_writes_nothing_but_reads_everything(job: Path, metrocli: Metrocli) -> None:
    ran = metrocli("straight-line", job, "--dry-run")
    assert (ran.code, ran.out) == (0, "line.yaml: no faults; would write results/line.h5\n")
    Path("readings.csv").write_text("point,x_mm,y_mm\na,1,nan\n")
    ran = metrocli("straight-line", job, "--dry-run")
    assert (ran.code, "readings.csv:2:5" in ran.err) == (3, True)
    assert not Path("results").exists()


def test_a_question_prints_a_table_and_writes_nothing(job: Path, metrocli: Metrocli) -> None:
    assert metrocli("straight-line", job, "--compare").out.splitlines()[0].split() == ["model", "rms", "[mm]"]
    assert json.loads(metrocli("straight-line", job, "--compare", "--json").out)["units"] == {"rms": "mm"}
    assert not Path("results").exists()


OTHER_KIND = "{path} is a job of the kind straight-line; use: metrocli straight-line {path}"


def test_a_command_on_a_job_of_another_kind(job: Path, metrocli: Metrocli) -> None:
    ran = metrocli("calibrate-camera", job)
    assert ran.code == 2
    assert OTHER_KIND.format(path=job) in ran.err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["strait-line", "line.yaml"], "did you mean 'straight-line'?"),
        (["straight-line"], "Missing argument 'JOB.yaml'"),
        (["straight-line", "line.yaml", "--outptu", "x"], "No such option"),
        (["schema", "strait-line"], "did you mean 'straight-line'?"),
        (["init", "x", "--sample", "none"], "no sample 'none'"),
        (["straight-line", "line.yaml", "--output", "x.csv"], "ends in .h5"),
        (["simulate", "line.yaml"], "Missing option '--out'"),
    ],
)
def test_wrong_use(arguments: list[str], message: str, job: Path, metrocli: Metrocli) -> None:
    ran = metrocli(*arguments)
    assert (ran.code, ran.out) == (2, "")
    assert message in ran.err


def test_data_that_cannot_determine_the_unknowns(job: Path, metrocli: Metrocli) -> None:
    Path("readings.csv").write_text("point,x_mm,y_mm\na,1,2\nb,1,3\n")
    ran = metrocli("straight-line", job)
    assert (ran.code, ran.out) == (UndeterminedError.exit_code, "") == (4, "")
    assert ran.err == "error: slope, offset: all points have the same x; measure at another x\n"
    assert not Path("results").exists()


def test_no_convergence(job: Path, metrocli: Metrocli) -> None:
    ran = metrocli("straight-line", job, "--set", "labels.fail=diverge")
    assert (ran.code, ran.out) == (5, "")


def test_a_defect_is_called_one(job: Path, metrocli: Metrocli) -> None:
    ran = metrocli("straight-line", job, "--set", "labels.fail=bug")
    assert ran.code == 1
    assert "Traceback" in ran.err
    assert "this is a defect of metrocli" in ran.err


def test_an_interrupt(job: Path, metrocli: Metrocli) -> None:
    ran = metrocli("straight-line", job, "--set", "labels.fail=interrupt")
    assert (ran.code, ran.out) == (130, "")
    assert not Path("results").exists()


def test_a_termination_takes_back_what_was_begun(job: Path, metrocli: Metrocli) -> None:
    before = signal.getsignal(signal.SIGTERM)
    ran = metrocli("straight-line", job, "--set", "labels.fail=terminate")
    assert (ran.code, ran.out, ran.err) == (143, "", "terminated\n")
    assert not Path("results").exists()
    assert signal.getsignal(signal.SIGTERM) is before


def test_a_pipe_that_is_closed_is_no_defect() -> None:
    call = [sys.executable, "-m", "metrocli", "schema", "multilaterate"]
    read, written = os.pipe()
    os.close(read)
    ran = subprocess.run(call, stdout=written, stderr=subprocess.PIPE, check=False)
    os.close(written)
    assert (ran.returncode, ran.stderr) == (141, b"")


class TestOutput:
    """What may be replaced."""

    def test_a_result_of_the_same_kind_is_replaced(self, job: Path, metrocli: Metrocli) -> None:
        assert [metrocli("straight-line", job).code for _ in range(2)] == [0, 0]

    def test_a_damaged_result_is_replaced(self, job: Path, metrocli: Metrocli) -> None:
        metrocli("straight-line", job)
        path = Path("results/line.h5")
        path.write_bytes(path.read_bytes()[:100])
        assert metrocli("straight-line", job).code == 0

    @pytest.mark.parametrize("content", ["hello", "kind", "other"])
    def test_anything_else_is_kept_unless_forced(self, content: str, job: Path, metrocli: Metrocli) -> None:
        path = Path("keep.h5")
        if content == "hello":
            path.write_text("hello")
        elif content == "kind":
            metrocli("straight-line", job, "--output", path)
            resealed(path, kind="other")
        else:
            h5py.File(path, "w").close()
        before = path.read_bytes()
        ran = metrocli("straight-line", job, "--output", path)
        assert ran.code == 3
        assert "keep.h5: error: the file exists and is" in ran.err
        assert path.read_bytes() == before
        assert metrocli("straight-line", job, "--output", path, "--force").code == 0

    def test_a_place_that_cannot_be_written(self, job: Path, metrocli: Metrocli) -> None:
        ran = metrocli("straight-line", job, "--output", "readings.csv/x.h5")
        assert (ran.code, ran.out) == (3, "")
        assert "cannot be written" in ran.err
        (Path("folder.h5")).mkdir()
        assert metrocli("straight-line", job, "--output", "folder.h5").code == 3

    def test_the_output_is_not_an_input(self, job: Path, metrocli: Metrocli) -> None:
        metrocli("straight-line", job)
        job.write_text(job.read_text().replace("{", "{known: results/line.h5, "))
        ran = metrocli("straight-line", job)
        assert ran.code == 3
        assert "the output results/line.h5 is one of the inputs" in ran.err


def test_show(job: Path, metrocli: Metrocli) -> None:
    printed = metrocli("straight-line", job).out
    ran = metrocli("show", "results/line.h5")
    assert ran.out == printed + "tables: residuals\n"
    table = metrocli("show", "results/line.h5", "--table", "residuals")
    assert table.out.startswith("point,residual_mm,normalised\na,-0.03")
    assert len(json.loads(metrocli("show", "results/line.h5", "--table", "residuals", "--json").out)["rows"]) == 4
    ran = metrocli("show", "results/line.h5", "--table", "residual")
    assert (ran.code, "did you mean 'residuals'?" in ran.err) == (2, True)
    assert metrocli("show", "readings.csv").code == 3


def test_a_result_as_input_must_be_of_the_right_kind(job: Path, metrocli: Metrocli) -> None:
    metrocli("straight-line", job)
    job.write_text(job.read_text().replace("{", "{known: results/line.h5, "))
    assert metrocli("straight-line", job, "--output", "o.h5").code == 0
    resealed(Path("results/line.h5"), lambda file: file.attrs.modify("kind", "other"), kind="other")
    ran = metrocli("check", job, "--set", "output=o.h5")
    assert ran.code == 3
    assert "line.yaml:3:17: error: inputs.known: results/line.h5 is a result of other" in ran.err


def test_simulate_then_measure(job: Path, metrocli: Metrocli) -> None:
    Path("readings.csv").unlink()
    ran = metrocli("simulate", job, "--out", "sim", "--seed", 3, "--images")
    assert (ran.code, ran.out) == (0, "sim/readings.csv\nsim/img/a.png\nsim/truth.json\n")
    truth = json.loads(Path("sim/truth.json").read_text())
    ran = metrocli("straight-line", job, "--set", "inputs.readings=sim/readings.csv", "--json")
    offset = json.loads(ran.out)["estimates"]["offset"]
    assert abs(offset["value"] - truth["offset"]) < 4 * offset["std"]
    assert metrocli("simulate", job, "--out", "sim").code == 3
    first = Path("sim/readings.csv").read_text()
    assert metrocli("simulate", job, "--out", "sim", "--force", "--seed", 3).code == 0
    assert Path("sim/readings.csv").read_text() == first
    assert metrocli("simulate", job, "--out", "sim", "--force", "--seed", 4).code == 0
    assert Path("sim/readings.csv").read_text() != first


def test_schema_of_every_kind(straight_line: str, metrocli: Metrocli) -> None:
    assert json.loads(metrocli("schema", straight_line).out)["properties"]["job"]["const"] == straight_line


def test_a_plan_needs_no_readings_and_can_be_made_again(job: Path, metrocli: Metrocli) -> None:
    Path("readings.csv").unlink()
    ran = metrocli("plan", job)
    assert (ran.code, ran.err) == (0, "warning: the stylus is not in the plan\n")
    assert "five readings determine the line" in ran.out
    assert "x [mm]" in ran.out
    assert ran.out.splitlines()[-3:] == ["line.plan/places.csv", "line.plan/program.nc", "line.plan/plan.json"]
    assert Path("line.plan/program.nc").read_text() == "G1 X0\n"
    again = metrocli("plan", job, "--json", "--set", "noise=0.2 mm")
    assert json.loads(again.out) == json.loads(Path("line.plan/plan.json").read_text())
    assert json.loads(again.out)["figures"]["slope"]["std"] == pytest.approx(0.2 / 10**0.5)
    assert len(json.loads(again.out)["tables"]["places"]["rows"]) == 5


def test_a_plan_leaves_no_file_of_an_earlier_one(job: Path, metrocli: Metrocli) -> None:
    metrocli("plan", job)
    summary = Path("line.plan/plan.json")
    told = json.loads(summary.read_text())
    summary.write_text(json.dumps(told | {"files": [*told["files"], "line.plan/old.nc", "../readings.csv"]}))
    for name in ("line.plan/old.nc", "line.plan/mine.nc"):
        Path(name).write_text("G0 X0\n")
    assert metrocli("plan", job).code == 0
    assert sorted(path.name for path in Path("line.plan").iterdir()) == [
        "mine.nc",
        "places.csv",
        "plan.json",
        "program.nc",
    ]
    assert Path("readings.csv").exists(), "only files beside plan.json are those of the plan"


def test_a_plan_takes_no_folder_of_others(job: Path, metrocli: Metrocli) -> None:
    Path("mine").mkdir()
    Path("mine/notes.txt").write_text("keep\n")
    ran = metrocli("plan", job, "--out", "mine")
    assert ran.code == 3
    assert "the folder is not empty and holds no plan" in ran.err
    assert metrocli("plan", job, "--out", "mine", "--force").code == 0
    assert Path("mine/notes.txt").read_text() == "keep\n"


def test_a_kind_without_a_plan_says_so(tmp_path: Path, job: Path, metrocli: Metrocli, monkeypatch: Any) -> None:
    from straight_line import task

    monkeypatch.setattr(task, "TASK", replace(task.TASK, plan=None))
    assert metrocli("plan", job).code == 2


def test_set_takes_names_with_points_and_conditions(tmp_path: Path, metrocli: Callable[..., Any]) -> None:
    """Figures have points in their names, whether the job has the key or not; > begins no block of YAML."""
    assert metrocli("init", tmp_path / "p", "--sample", "gauge-block").code == 0
    job, trials = tmp_path / "p/jobs/gum.yaml", "monte_carlo.trials=10000"
    told = metrocli("report-uncertainty", job, "--set", trials, "--set", "require.l.tolerance.conformance=> 0.5").out
    assert "required l.tolerance.conformance > 0.5: met" in told and "required l.U < 100 nm" in told
    told = metrocli("report-uncertainty", job, "--set", trials, "--set", "require.l.mc.std=< 1 mm", "--force").out
    assert "required l.mc.std < 1 mm: met" in told
