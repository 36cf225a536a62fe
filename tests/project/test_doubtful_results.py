"""Results that must not be used: when a result is doubtful, what carries it, and who refuses it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from metrocli.doubt import chi_bound, doubts_of
from metrocli.formats import hdf5
from metrocli.record import CriterionVerdict
from metrocli.result import Result
from metrocli.table import Table

HEAD = "metrocli: 1\njob: straight-line\nnoise: 30 um\n"
"""The readings of the tests' job scatter by 95 um about their line, with 2 degrees of freedom: sigma0 = 3.16"""
FIRST = HEAD + "inputs: {readings: ../readings.csv}\noutput: ../results/first.h5\n"
SECOND = (
    "metrocli: 1\njob: straight-line\nnoise: 0.1 mm\n"
    "inputs: {readings: ../readings.csv, known: ../results/first.h5}\noutput: ../results/second.h5\n"
)


def found(sigma0: float, dof: int, *verdicts: CriterionVerdict, **statistics: Any) -> tuple[str, ...]:
    result = Result("straight-line", "", (), np.zeros((0, 0)), {"sigma0": sigma0, "dof": dof, **statistics})
    return doubts_of(result, verdicts)


def test_the_bound_of_chance_is_that_of_tables() -> None:
    # chi-square tables: 13.816 for 2 degrees of freedom, 149.449 for 100, at 99.9 %
    assert chi_bound(2, 0.999) == pytest.approx(np.sqrt(13.8155 / 2), rel=1e-5)
    assert chi_bound(100, 0.999) == pytest.approx(np.sqrt(149.449 / 100), rel=1e-5)


@pytest.mark.parametrize(
    ("sigma0", "dof", "required", "doubtful"),
    [
        (2.1, 100, [], True),
        (1.9, 100, [], False),
        (2.5, 2, [], False),  # chance exceeds 2.63 in 0.1 % of cases
        (2.7, 2, [], True),
        (4.9, 100, ["< 5"], False),
        (5.1, 100, ["< 5"], True),
        (1.6, 100, ["< 1.5"], True),
        (1.2, 100, ["< 1.1"], False),  # not met, but within chance
        (3.0, 100, ["> 0.5"], True),  # no upper limit is required
        (0.2, 100, [], False),
        (float("nan"), 0, [], False),
    ],
)
def test_when_residuals_make_a_result_doubtful(sigma0: float, dof: int, required: list[str], doubtful: bool) -> None:
    compare = {"<": lambda a, b: a < b, ">": lambda a, b: a > b}
    verdicts = [
        CriterionVerdict("sigma0", text, sigma0, "", compare[text[0]](sigma0, float(text[1:]))) for text in required
    ]
    assert bool(found(sigma0, dof, *verdicts)) == doubtful


@pytest.mark.parametrize(("rejected", "doubtful"), [(0, False), (50, False), (51, True)])
def test_more_than_a_third_left_out_is_doubtful(rejected: int, doubtful: bool) -> None:
    assert bool(found(1.0, 50, rejected=rejected, readings=100, observations=200)) == doubtful


@pytest.mark.parametrize(("rejected", "dof", "doubtful"), [(1, 0, True), (1, 1, False), (0, 0, False)])
def test_outliers_that_leave_nothing_controlled_are_doubtful(rejected: int, dof: int, doubtful: bool) -> None:
    assert bool(found(1.0, dof, rejected=rejected, readings=20)) == doubtful


def depleted(names: list[str], quantity: dict[str, list[str]], out: int, **statistics: Any) -> tuple[str, ...]:
    """Doubts about readings of which the first ones are left out."""
    tables = {
        name: Table.of({"station": np.array(names)[rows], **{key: np.array(q)[rows] for key, q in quantity.items()}})
        for name, rows in (("rejected", slice(None, out)), ("residuals", slice(out, None)))
    }
    return doubts_of(Result("straight-line", "", (), np.zeros((0, 0)), statistics, tables=tables), ())


def test_a_station_without_a_third_of_its_readings_is_named() -> None:
    names = ["S1"] * 15 + ["S2"] * 15
    assert depleted(names, {}, 5) == ()
    assert depleted(names, {}, 6)[0].startswith("6 of 15 readings of station S1 are left out as outliers: ")
    # few readings may each be wrong by themselves
    assert depleted(["S1"] * 6 + ["S2"] * 15, {}, 4) == ()


def test_a_station_without_its_readings_of_one_quantity_is_named_with_it() -> None:
    names, quantity = ["S1"] * 15 + ["S2"] * 15, ["d"] * 5 + ["az"] * 5 + ["el"] * 5 + ["d"] * 15
    found = depleted(names, {"quantity": quantity}, 5)
    assert found[0].startswith("5 of 15 readings of station S1 are left out as outliers (5 of 5 d): ")


def test_an_image_has_no_units() -> None:
    tables = {
        name: Table.of({"image": np.array(["a"] * n + ["b"] * others)})
        for name, n, others in (("rejected", 6, 0), ("residuals", 6, 30))
    }
    (found,) = doubts_of(Result("straight-line", "", (), np.zeros((0, 0)), {}, tables=tables), ())
    assert (
        "6 of 12 readings of image a " in found and "names of targets of this image" in found and "units" not in found
    )


def test_readings_without_a_quantity_are_counted_once() -> None:
    """Lengths of an interferometer, beside sightings, are left out without the name of a quantity."""
    names, quantity = (
        ["I1", "I1", "I1", "S1"] + ["S1"] * 15 + ["I1"] * 6,
        ["", "", "", "az"] + ["az"] * 15 + ["length"] * 6,
    )
    assert depleted(names, {"quantity": quantity}, 4) == ()


def test_readings_of_no_station_are_no_station() -> None:
    """Bars and levelled heights have none."""
    assert depleted([""] * 12 + ["S1"] * 20 + ["S2"] * 20, {}, 6) == ()
    assert len(depleted(["S1", "S2"] * 20 + [""] * 6, {}, 20, rejected=20, readings=26)) == 1


def test_no_station_is_named_where_all_lost_their_readings() -> None:
    (all_of_them,) = depleted(["S1", "S2"] * 20, {}, 20, rejected=20, readings=20)
    assert all_of_them.startswith("20 of 40 readings are left out")


def test_all_stations_are_named_without_their_distances() -> None:
    """They are no more than a third of all readings."""
    names, quantity = ["S1", "S2"] * 15, ["d"] * 10 + ["az"] * 10 + ["el"] * 10
    assert len(depleted(names, {"quantity": quantity}, 10, rejected=10, readings=20)) == 2


def test_an_estimated_noise_is_no_sigma0() -> None:
    assert found(7.0, 100)
    assert not found(7.0, 100, noise_estimated=True)


def test_the_checks_of_a_kind_make_a_result_doubtful_and_warnings_only_if_strict() -> None:
    result = Result(
        "straight-line", "", (), np.zeros((0, 0)), {}, warnings=("a table is long",), doubts=("the line is bent",)
    )
    assert doubts_of(result, ()) == ("the line is bent",)
    assert doubts_of(result, (), strict=True) == ("the line is bent", "a table is long")


def test_a_doubtful_job_is_written_and_ends_with_6(job: Path, metrocli: Callable[..., Any]) -> None:
    job.write_text(job.read_text().replace("0.1 mm", "30 um"))
    ran = metrocli("straight-line", job)
    assert ran.code == 6
    assert "DOUBTFUL: sigma0 = 3.16 where <= 2 is allowed, and chance exceeds 2.63" in ran.out
    quiet = metrocli("straight-line", job, "-q")
    assert (quiet.code, quiet.out) == (6, "")
    assert quiet.err.startswith("DOUBTFUL: sigma0 = 3.16")
    told = metrocli("straight-line", job, "--json")
    summary = json.loads(told.out)
    assert (told.code, summary["status"]) == (6, "doubtful")
    assert summary["doubts"][0].startswith("sigma0 = 3.16")
    with h5py.File("results/line.h5") as file:
        assert file.attrs["status"] == "doubtful"
        assert file.attrs["complete"]
    shown = metrocli("show", "results/line.h5")
    assert shown.code == 0
    assert "DOUBTFUL: sigma0 = 3.16" in shown.out


def test_a_required_sigma0_replaces_the_limit(job: Path, metrocli: Callable[..., Any]) -> None:
    job.write_text(job.read_text().replace("0.1 mm", "30 um") + "require: {sigma0: '< 5'}\n")
    assert metrocli("straight-line", job).code == 0
    with h5py.File("results/line.h5") as file:
        assert file.attrs["status"] == "done"


@pytest.mark.parametrize(
    ("first", "words"),
    [
        (FIRST, "is not fit for use (doubtful): sigma0 = 3.16"),
        (FIRST.replace("30 um", "0.1 mm") + "require: {slope.std: '< 1 urad'}\n", "(requirements not met): required slope.std"),
    ],
)  # fmt: skip
def test_other_jobs_refuse_it_unless_accepted(first: str, words: str, job: Path, metrocli: Callable[..., Any]) -> None:
    Path("jobs").mkdir()
    Path("jobs/first.yaml").write_text(first)
    Path("jobs/second.yaml").write_text(SECOND)
    assert metrocli("straight-line", "jobs/first.yaml").code == 6
    for command in (["straight-line", "jobs/second.yaml"], ["check", "jobs/second.yaml"]):
        refused = metrocli(*command)
        assert refused.code == 3
        assert "jobs/second.yaml:4:44: error: inputs.known: " in refused.err
        assert words in refused.err
        assert "--accept-doubtful" in refused.err
    assert not Path("results/second.h5").exists()
    assert metrocli("check", "jobs/second.yaml", "--accept-doubtful").code == 0
    accepted = metrocli("straight-line", "jobs/second.yaml", "--accept-doubtful")
    assert accepted.code == 0
    assert "accepted by --accept-doubtful" in accepted.err
    result, record = hdf5.read(Path("results/second.h5"))
    assert record.status == "done"
    assert any(words in line for line in result.warnings)


def test_an_export_refuses_it_unless_accepted_and_then_says_so(job: Path, metrocli: Callable[..., Any]) -> None:
    metrocli("straight-line", job, "--set", "noise=30 um")
    refused = metrocli("export", "results/line.h5", "--to", "csv")
    assert refused.code == 3
    assert "results/line.h5: error: not fit for use (doubtful): sigma0 = 3.16" in refused.err
    assert not list(Path("results").glob("*.csv"))
    accepted = metrocli("export", "results/line.h5", "--to", "csv", "--accept-doubtful")
    assert accepted.code == 0
    assert Path("results/line.residuals.csv").is_file()
    assert Path("results/line.doubtful.txt").read_text().startswith("sigma0 = 3.16")


def test_who_looks_at_its_numbers_is_told(job: Path, metrocli: Callable[..., Any]) -> None:
    """A table, or a difference to another result, has standard uncertainties that the residuals contradict."""
    metrocli("straight-line", job, "--set", "noise=30 um")
    result = "results/line.h5"
    for command in (["show", result, "--table", "residuals"], ["compare", result, result], ["compare", *3 * [result]]):
        shown = metrocli(*command)
        assert shown.code == 0
        assert f"warning: {result} is not fit for use: sigma0 = 3.16" in shown.err


def test_strict_makes_warnings_faults(job: Path, metrocli: Callable[..., Any]) -> None:
    Path("readings.csv").write_text("point,x_mm,y_mm,colour\na,0,1\nb,1,2\nc,2,3.1\n".replace(",1\n", ",1,red\n"))
    Path("readings.csv").write_text("point,x_mm,y_mm,colour\na,0,1,red\nb,1,2,red\nc,2,3.1,red\n")
    plain = metrocli("straight-line", job)
    assert plain.code == 0
    assert "colour" in plain.err
    strict = metrocli("straight-line", job, "--strict")
    assert strict.code == 6
    assert any("colour" in doubt for doubt in hdf5.read_record(Path("results/line.h5"))[1].doubts)
    assert "DOUBTFUL: " in strict.out


def test_a_strict_run_of_a_project_does_not_pass_over_results_with_warnings(
    job: Path, metrocli: Callable[..., Any]
) -> None:
    Path("readings.csv").write_text("point,x_mm,y_mm,colour\na,0,1,red\nb,1,2,red\nc,2,3.1,red\n")
    Path("metrocli.yaml").write_text("jobs: [line.yaml]\n")
    assert metrocli("run").code == 0
    assert metrocli("run", "--strict").code == 6
    assert metrocli("run", "--strict").out.startswith("line.yaml: up to date (doubtful")
    assert metrocli("run", "--force").code == 0


@pytest.fixture
def project(job: Path) -> None:
    """Two jobs, of which the second uses the doubtful result of the first."""
    Path("jobs").mkdir()
    Path("jobs/first.yaml").write_text(FIRST)
    Path("jobs/second.yaml").write_text(SECOND)
    Path("metrocli.yaml").write_text("jobs: [jobs/first.yaml, jobs/second.yaml]\n")


def test_a_project_stops_at_a_doubtful_result(project: None, metrocli: Callable[..., Any]) -> None:
    because = "jobs/first.yaml: its result is doubtful; --accept-doubtful uses it"
    for action in ("ran (there is no result yet) -> results/first.h5", "up to date"):
        ran = metrocli("run")
        assert ran.code == 6
        assert ran.out.splitlines() == [
            f"jobs/first.yaml: {action} (doubtful: do not use this result)",
            f"jobs/second.yaml: not run ({because})",
        ]
        assert "DOUBTFUL: sigma0 = 3.16" in ran.err
    assert Path("results/first.h5").is_file()
    assert not Path("results/second.h5").exists()
    status = metrocli("status").out.splitlines()
    assert status[0].startswith("jobs/first.yaml: up to date (doubtful: sigma0 = 3.16")
    assert status[1] == f"jobs/second.yaml: would not run: {because}"
    assert metrocli("run", "--dry-run").out.splitlines()[1] == status[1]
    assert [one["status"] for one in json.loads(metrocli("status", "--json").out)["jobs"]] == ["doubtful", None]


def test_a_project_that_accepts_it_runs_all(project: None, metrocli: Callable[..., Any]) -> None:
    metrocli("run")
    assert metrocli("status", "--accept-doubtful").out.splitlines()[1].startswith("jobs/second.yaml: would run")
    ran = metrocli("run", "--accept-doubtful")
    assert ran.code == 6  # the first is still doubtful
    assert "jobs/second.yaml: ran" in ran.out
    assert Path("results/second.h5").is_file()
    again = metrocli("run", "--accept-doubtful")
    assert "jobs/second.yaml: up to date" in again.out
