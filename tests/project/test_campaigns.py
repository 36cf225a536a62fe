"""One job text for many parts: `for: {part: parts.csv}`."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import pytest

HEAD = "metrocli: 1\njob: straight-line\n"
JOB = (
    HEAD
    + """\
for: {part: ../parts.csv}
title: Gear {part} of {customer}
noise: "{noise} mm"
inputs: {readings: "../data/{part}.csv"}
output: ../results/{part}.h5
"""
)
PARTS = "part,customer,noise\nA1,Müller,0.1\nA2,Smith,0.2\n012,Müller,0.1\n"


@pytest.fixture
def project(job: Path) -> Path:
    """Three parts, each with its readings."""
    Path("jobs").mkdir()
    Path("data").mkdir()
    Path("jobs/gear.yaml").write_text(JOB)
    Path("parts.csv").write_text(PARTS)
    for n, part in enumerate(("A1", "A2", "012")):
        Path(f"data/{part}.csv").write_text(Path("readings.csv").read_text().replace("3900", f"{3900 + n}"))
    Path("metrocli.yaml").write_text("jobs: [jobs/gear.yaml]\n")
    return Path()


def ran(done: Any) -> list[str]:
    return [line.split(": ")[0].partition("[")[2][:-1] for line in done.out.splitlines() if ": ran" in line]


def test_each_part_has_its_result(project: Path, metrocli: Callable[..., Any]) -> None:
    assert metrocli("check", ".").out.splitlines() == [
        f"jobs/gear.yaml[{one}]: no faults" for one in ("A1", "A2", "012")
    ]
    done = metrocli("run")
    assert (done.code, ran(done)) == (0, ["A1", "A2", "012"]), done.err
    with h5py.File("results/A2.h5") as file:
        assert file.attrs["title"] == "Gear A2 of Smith"
        text = file["job"].asstr()[()]
    assert 'noise: "0.2 mm"\n' in text
    assert "for:" not in text
    assert metrocli("rerun", "results/A2.h5").code == 0
    assert [line.split(": ")[1] for line in metrocli("status").out.splitlines()] == ["up to date"] * 3


def test_check_lists_the_files_outside_the_project_of_each_part(
    project: Path, metrocli: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory
) -> None:
    elsewhere = Path("data/A1.csv").rename(tmp_path_factory.mktemp("elsewhere") / "A1.csv")
    Path("parts.csv").write_text(f"part,customer,noise,at\nA1,Smith,0.1,{elsewhere}\nA2,Smith,0.2,../data/A2.csv\n")
    Path("jobs/gear.yaml").write_text(JOB.replace("../data/{part}.csv", "{at}"))
    rows = json.loads(metrocli("check", ".", "--json").out)["jobs"]
    assert rows == [
        {"job": "jobs/gear.yaml[A1]", "outside": [str(elsewhere)]},
        {"job": "jobs/gear.yaml[A2]", "outside": []},
    ]


def test_values_with_the_marks_of_yaml_are_recorded_as_they_are(project: Path, metrocli: Callable[..., Any]) -> None:
    Path("parts.csv").write_text(PARTS.replace("Smith", "x: y #3").replace("012,Müller", '012,"a ""b"" \\ \x85\ufeff"'))
    assert metrocli("run").code == 0
    for part in ("A1", "A2", "012"):
        assert metrocli("rerun", f"results/{part}.h5").code == 0
    Path("parts.csv").write_text(Path("parts.csv").read_text().replace("#3", "#4"))
    assert "title: Gear A2 of x: y #3 -> Gear A2 of x: y #4" in metrocli("status").out


def test_only_the_part_that_changed_runs(project: Path, metrocli: Callable[..., Any]) -> None:
    metrocli("run")
    Path("parts.csv").write_text(PARTS.replace("Smith", "Smythe"))
    assert ran(metrocli("run")) == ["A2"]
    Path("parts.csv").write_text("# a new part\n" + PARTS.replace("Smith", "Smythe") + "A3,Li,0.1\n")
    Path("data/A3.csv").write_text(Path("readings.csv").read_text())
    assert ran(metrocli("run", "--jobs", 2)) == ["A3"]
    assert ran(metrocli("run", "--only", "jobs/gear.yaml[A1]", "--force")) == ["A1"]
    assert ran(metrocli("run", "--only", "jobs/gear.yaml", "--force")) == ["A1", "A2", "012", "A3"]


def test_a_job_of_a_part_uses_the_result_of_that_part(project: Path, metrocli: Callable[..., Any]) -> None:
    Path("jobs/second.yaml").write_text(
        HEAD + "for: {part: [A1, A2]}\nnoise: 0.1 mm\noutput: ../results/second-{part}.h5\n"
        'inputs: {readings: ../readings.csv, known: "../results/{part}.h5"}\n'
    )
    Path("metrocli.yaml").write_text("jobs: [jobs/second.yaml, jobs/gear.yaml]\n")
    assert metrocli("run").code == 0
    Path("data/A1.csv").write_text(Path("data/A1.csv").read_text().replace("3100", "3111"))
    done = metrocli("run")
    assert [line for line in done.out.splitlines() if ": ran" in line][1].startswith("jobs/second.yaml[A1]: ran")
    assert len(ran(done)) == 2


def test_all_estimates_in_one_table(project: Path, metrocli: Callable[..., Any]) -> None:
    metrocli("run")
    Path("parts.csv").write_text(PARTS.replace("A2,Smith,0.2", "A2,Smith,0.3"))
    assert metrocli("gather", ".", "--out", "table.csv").out == "table.csv: 3 results\n"
    rows = list(csv.DictReader(Path("table.csv").read_text(encoding="utf-8").splitlines()))
    assert [(row["part"], row["customer"], row["up_to_date"]) for row in rows] == [
        ("A1", "Müller", "yes"), ("A2", "Smith", "no"), ("012", "Müller", "yes")]  # fmt: skip
    for row in rows:
        with h5py.File(f"results/{row['part']}.h5") as file:
            found = {one["name"].decode(): (one["value"], one["std"]) for one in file["parameters"][()]}
        assert (float(row["offset_mm"]), float(row["offset.std_mm"])) == found["offset"]
        assert (float(row["slope_rad"]), float(row["slope.std_rad"])) == found["slope"]
    Path("table.csv").write_text("mine\n")
    assert metrocli("gather", ".", "--out", "table.csv").code == 3
    assert len(json.loads(metrocli("gather", ".", "--out", "other.csv", "--json").out)["rows"]) == 3
    other = metrocli("gather", ".", "--out", "table.json")
    assert other.code == 2 and "name it table.csv" in other.err and not Path("table.json").exists()


def test_a_column_of_the_list_does_not_hide_one_of_the_results(project: Path, metrocli: Callable[..., Any]) -> None:
    head, *rows = PARTS.splitlines()
    more = [f"{head},status,sigma0,job,offset_mm,slope", *(f"{row},painted,9,J7,77,66" for row in rows)]
    Path("parts.csv").write_text("\n".join(more) + "\n")
    metrocli("run")
    metrocli("gather", ".", "--out", "table.csv")
    row = next(csv.DictReader(Path("table.csv").read_text(encoding="utf-8").splitlines()))
    with h5py.File("results/A1.h5") as file:
        offset = dict(zip(file["parameters"]["name"], file["parameters"]["value"], strict=True))[b"offset"]
        sigma0 = file["statistics"].attrs["sigma0"]
    assert (row["job"], row["status"], float(row["sigma0"])) == ("jobs/gear.yaml[A1]", "done", sigma0)
    assert float(row["offset_mm"]) == offset
    assert {row[f"for.{name}"] for name in ("status", "sigma0", "job", "offset_mm", "slope")} == {
        "painted", "9", "J7", "77", "66"}  # fmt: skip


FAULTS = {
    "no such column": (JOB.replace("{customer}", "{custmer}"), PARTS, "jobs/gear.yaml:4:8: error: title: no part has '{custmer}'"),
    "column of parts missing": (JOB, PARTS.replace("part,", "prt,"), "parts.csv:1"),
    "two parts of a name": (JOB, PARTS + "A1,x,0.1\nA2,x,1\n", "parts.csv:6:1: error: the part 'A2' is there twice"),
    "a part twice in a list": (JOB.replace("../parts.csv", "[A1, A1]"), PARTS, "jobs/gear.yaml:3:18: error: the part"),
    "a column twice": (JOB, PARTS.replace("customer", "noise"), "parts.csv:1:1: error: the column 'noise' is there tw"),
    "a part that leads elsewhere": (JOB, PARTS + "../x,x,0.1\n", "the part '../x' cannot be part of a file name"),
    "one output for all": (JOB.replace("/{part}.h5", "/all.h5"), PARTS, "write the part in braces into the output"),
    "a value that does not fit": (JOB, PARTS.replace("0.2", "0.2 mm"), "jobs/gear.yaml:5:8: error: noise: 'mm mm' after 0.2"),
    "the part whose value does not fit": (JOB, PARTS.replace("0.2", "0.2 mm"), "(for A2, parts.csv:3)"),
    "the part whose file is not there": (JOB.replace("../parts.csv", "[A1, B2]").replace(" of {customer}", "")
                                         .replace("{noise}", "1"), PARTS, "data/B2.csv (for B2)"),
    "no list": (JOB.replace("../parts.csv", "../none.csv"), PARTS, "none.csv: error: there is no such file"),
    "an empty list": (JOB.replace("../parts.csv", "[]"), PARTS, "this is not a list of names"),
    "two names": (JOB.replace("{part: ../parts.csv}", "{part: [a], b: [c]}"), PARTS, "this is not a list of parts"),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
def test_faults_have_their_place(name: str, project: Path, metrocli: Callable[..., Any]) -> None:
    job, parts, message = FAULTS[name]
    Path("jobs/gear.yaml").write_text(job)
    Path("parts.csv").write_text(parts)
    for command in (("run",), ("check", "."), ("check", "jobs/gear.yaml")):
        done = metrocli(*command)
        if name != "one output for all" or command[-1] != "jobs/gear.yaml":
            assert (done.code, message in done.err) == (3, True), done.err
    assert not Path("results").exists()


def test_a_single_command_names_what_to_use(project: Path, metrocli: Callable[..., Any]) -> None:
    done = metrocli("straight-line", "jobs/gear.yaml")
    assert (done.code, "name one part: 'jobs/gear.yaml[PART]', in quotes" in done.err) == (3, True)


def test_commands_of_one_job_take_a_part(project: Path, metrocli: Callable[..., Any]) -> None:
    done = metrocli("straight-line", "jobs/gear.yaml[A2]")
    assert (done.code, Path("results/A2.h5").is_file(), Path("results/A1.h5").exists()) == (0, True, False), done.err
    assert metrocli("check", "jobs/gear.yaml[A2]").out == "jobs/gear.yaml[A2]: no faults\n"
    assert metrocli("run", "--only", "jobs/gear.yaml[A2]").out.startswith("jobs/gear.yaml[A2]: up to date")


def test_a_part_that_the_job_does_not_have_is_refused(project: Path, metrocli: Callable[..., Any]) -> None:
    done = metrocli("straight-line", "jobs/gear.yaml[A7]")
    assert (done.code, "the job has no part 'A7'\n       allowed: A1, A2, 012" in done.err) == (3, True), done.err
    done = metrocli("straight-line", "line.yaml[A1]")
    assert (done.code, "it has no 'for:'" in done.err) == (3, True), done.err


def test_the_extended_job_of_a_part_has_its_name(project: Path, metrocli: Callable[..., Any]) -> None:
    from metrocli.project.job import load

    assert [load(Path(f"jobs/gear.yaml{part}")).stem for part in ("[A1]", "[012]")] == ["gear.A1", "gear.012"]
    assert load(Path("line.yaml")).stem == "line"


def test_parts_without_an_output_have_a_result_each(project: Path, metrocli: Callable[..., Any]) -> None:
    """Each part that ran alone had replaced the result of another, and a project refused them."""
    Path("jobs/gear.yaml").write_text(JOB.replace("output: ../results/{part}.h5\n", ""))
    for part in ("A1", "A2"):
        assert metrocli("straight-line", f"jobs/gear.yaml[{part}]").code == 0
    assert sorted(path.name for path in Path("jobs/results").glob("*.h5")) == ["gear.A1.h5", "gear.A2.h5"]
    done = metrocli("run")
    assert (done.code, ran(done)) == (0, ["012"]), done.err


def test_a_part_of_another_kind_is_named_with_what_to_use(project: Path, metrocli: Callable[..., Any]) -> None:
    done = metrocli("multilaterate", "jobs/gear.yaml[A2]")
    assert (done.code, 'metrocli straight-line "jobs/gear.yaml[A2]"' in done.err) == (2, True), done.err


def test_the_plan_of_a_part_has_its_name(tmp_path: Path, metrocli: Callable[..., Any]) -> None:
    metrocli("init", tmp_path / "p", "--sample", "machine-methods")
    path = tmp_path / "p" / "jobs" / "six-dof.yaml"
    path.write_text(f"{path.read_text()}for: {{part: [v1.2]}}\n")
    assert metrocli("plan", f"{path}[v1.2]").code == 0
    assert [folder.name for folder in path.parent.glob("*.plan")] == ["six-dof.v1.2.plan"]
