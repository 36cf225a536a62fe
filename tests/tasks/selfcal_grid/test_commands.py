"""From files to files: the sample project, simulation with effects, the plan, the map, the export."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from metrocli.formats import csv, hdf5
from metrocli.table import TEXT, WHOLE, Column, Columns

Metrocli = Callable[..., Any]
ERRORS = Columns((*(Column(k, WHOLE) for k in "ijk"), *(Column(f"e{a}", "length") for a in "xyz")))


@pytest.fixture
def project(tmp_path: Path, metrocli: Metrocli, monkeypatch: pytest.MonkeyPatch) -> Path:
    assert metrocli("init", tmp_path / "cube", "--sample", "ball-cube").code == 0
    monkeypatch.chdir(tmp_path / "cube")
    return tmp_path / "cube"


def test_the_sample_holds_the_truth(project: Path, metrocli: Metrocli) -> None:
    ran = metrocli("run", project)
    assert ran.code == 0, ran.err
    true = csv.read(project / "data" / "true_machine_error.csv", ERRORS).stacked(["ex", "ey", "ez"])
    found = hdf5.read(project / "results" / "views.h5")[0].tables["machine_error"]
    share = (found.stacked(["ex", "ey", "ez"]) - true) / found.stacked(["s_ex", "s_ey", "s_ez"])
    assert np.abs(share).max() < 4.5
    assert np.sqrt((share**2).mean()) == pytest.approx(1.0, abs=0.15)
    scaled = hdf5.read(project / "results" / "scaled.h5")[0]
    assert scaled.statistics["undetermined"] == 12
    with_scale = scaled.tables["machine_error"]
    off = (with_scale.stacked(["ex", "ey", "ez"]) - true) / with_scale.stacked(["s_ex", "s_ey", "s_ez"])
    assert np.abs(off).max() < 4.5
    # the machine that the README tells of
    assert np.linalg.norm(true, axis=1).max() == pytest.approx(0.017, rel=1e-9)
    assert abs((65.0 * found.stacked("ijk") * true).sum()) < 1e-9


def test_the_map_and_a_point_agree_with_the_sites(project: Path, metrocli: Metrocli) -> None:
    assert metrocli("selfcal-grid", "jobs/views.yaml", "--quiet").code == 0
    result = hdf5.read(project / "results" / "views.h5")[0]
    sites, mapped = result.tables["machine_error"], result.tables["map"]
    row = np.flatnonzero((sites.stacked("ijk") == 0).all(axis=1))[0]
    assert mapped.texts("point")[0] == "centre"
    for name in ("ex", "ey", "ez", "s_ex", "s_ey", "s_ez"):
        assert mapped.numbers(name)[0] == pytest.approx(sites.numbers(name)[row], rel=1e-9)
    shown = json.loads(metrocli("show", "results/views.h5", "--at", "120 mm", "120 mm", "120 mm", "--json").out)
    at = {one["name"]: one for one in shown}
    for name in ("ex", "ey", "ez", "smooth_ex", "smooth_ey", "smooth_ez"):
        assert at[name]["value"] == pytest.approx(mapped.numbers(name)[2], rel=1e-9)
        assert at[name]["std"] == pytest.approx(mapped.numbers(f"s_{name}")[2], rel=1e-6)
    assert metrocli("show", "results/views.h5", "--at", "140 mm", "0 mm", "0 mm").code == 2


def bent(places: np.ndarray) -> np.ndarray:
    """A polynomial that the smooth form can be, of third order."""
    x, y, z = places.T / 130.0
    return np.asarray(0.01 * np.stack([x * x + 0.5 * y * z, y**3 - x * z, x * y * z - z * z], axis=1))


def waved(places: np.ndarray) -> np.ndarray:
    """One that it cannot be: a fourth order would meet it at all five sites of a line, and be off between them."""
    x, y, z = places.T / 130.0
    return bent(places) + 0.003 * np.sin(3 * np.stack([y, z, x], axis=1) + 1)


@pytest.mark.alike
@pytest.mark.parametrize("field", [bent, waved])
@pytest.mark.parametrize("noise", [5e-3, 5e-4, 5e-5])
def test_between_sites_both_forms_are_off_as_their_uncertainties_say(
    field: Callable[[np.ndarray], np.ndarray], noise: float
) -> None:
    """A machine error known also between the sites; where the noise hides what a form misses, and where it does not."""
    from simulated.grid import PITCH, Grid, grid, in_gauge

    from metrocli.table import Table
    from metrocli.tasks.selfcal_grid import task as selfcal_grid

    one = grid(5, seed=20)
    r = one.balls * PITCH
    machine, artefact = in_gauge(r, field(r), one.artefact)
    moved = Grid(5, "1234", one.balls, machine, artefact, one.mountings)
    rng = np.random.default_rng(3)
    places = rng.uniform(-129, 129, (300, 3))
    points = Table(
        {"point": np.arange(300).astype(str), **dict(zip("xyz", places.T, strict=True))}, dict.fromkeys("xyz", "mm")
    )
    result = selfcal_grid.run(
        selfcal_grid.TASK.job(moved.settings(noise, leave_one_out="no"), moved.read(rng, noise), None, points)
    )
    basis = np.concatenate([np.ones((125, 1)), r], axis=1)
    # what the gauge took away is linear in the place
    removed = np.linalg.lstsq(basis, field(r) - machine, rcond=None)[0]
    true = field(places) - np.concatenate([np.ones((300, 1)), places], axis=1) @ removed
    found = result.tables["map"]
    for form in ("", "smooth_"):
        share = (found.stacked([f"{form}e{a}" for a in "xyz"]) - true) / found.stacked([f"s_{form}e{a}" for a in "xyz"])
        assert 0.65 < np.sqrt((share**2).mean()) < 1.35, form
        assert np.abs(share).max() < 5
    if field is bent:
        smoothed = found.stacked(["smooth_ex", "smooth_ey", "smooth_ez"])
        assert np.sqrt(((smoothed - true) ** 2).mean()) < 0.3 * noise


def test_effects_are_planted_and_found(project: Path, metrocli: Metrocli) -> None:
    planted = (
        "artefact-expansion:view=3,scale=80um/m",
        "drift-in-view:view=2,vx=0um/h,vy=0um/h,vz=30um/h",
        "moved-ball:ball=1 0 -2,from_view=3,dx=0.1mm,dy=0mm,dz=-0.05mm",
    )
    options = [word for text in planted for word in ("--effect", text)]
    ran = metrocli("simulate", "jobs/views.yaml", "--out", "new", "--seed", "5", "--set", "noise=0.5 um", *options)
    assert ran.code == 0, ran.err
    effects = '[{name: artefact-expansion, view: "3"}, {name: drift-in-view, view: "2"}, {name: moved-ball, ball: [1, 0, -2], from_view: "3"}]'
    job = (
        (project / "jobs" / "views.yaml")
        .read_text()
        .replace("noise: 5 um", f"effects: {effects}\nnoise: 0.5 um")
        .replace("../data/views.csv", "../new/views.csv")
    )
    (project / "jobs" / "more.yaml").write_text(job.replace("../results/views.h5", "../results/more.h5"))
    ran = metrocli("selfcal-grid", "jobs/more.yaml", "--json")
    assert ran.code == 0, ran.err
    found = json.loads(ran.out)["estimates"]
    truth = json.loads((project / "new" / "truth.json").read_text())
    names = [name for name in found if name.startswith(("artefact", "drift", "moved"))]
    assert len(names) == 7
    for name in [*names, "2.x", "4.gamma"]:
        assert abs(found[name]["value"] - truth[name]) < 4 * found[name]["std"], name


@pytest.mark.slow
def test_a_ball_that_moved_is_told_with_its_view_and_the_extended_job_has_it(project: Path, metrocli: Metrocli) -> None:
    planted = "moved-ball:ball=1 0 -2,from_view=3,dx=0.05mm,dy=0mm,dz=-0.05mm"
    assert metrocli("simulate", "jobs/views.yaml", "--out", "new", "--seed", "5", "--effect", planted).code == 0
    job = (project / "jobs" / "views.yaml").read_text().replace("../data/views.csv", "../new/views.csv")
    (project / "jobs" / "moved.yaml").write_text(job)
    data = json.loads(metrocli("diagnose", "jobs/moved.yaml", "--json").out)
    assert [one["where"] for one in data["effects"]] == [{"ball": "1 0 -2", "from_view": "3"}]
    assert set(data["effects"][0]["parameters"]) == {"dx", "dy", "dz"}
    ran = metrocli("diagnose", data["extended_job"], "--json")
    assert (ran.code, json.loads(ran.out)["effects"]) == (0, []), ran.err


def test_an_effect_that_the_views_absorb_is_refused(project: Path, metrocli: Metrocli) -> None:
    """A ball displaced in the only view that sees it beside the first: nothing tells it from a wrong place of the site."""
    rows = (project / "data" / "views.csv").read_text().splitlines()
    kept = [row for row in rows if row.split(",")[0] in ("view", "1", "2")]
    (project / "data" / "views.csv").write_text("\n".join(kept) + "\n")
    job = (
        (project / "jobs" / "views.yaml")
        .read_text()
        .replace("noise: 5 um", 'effects: [{name: moved-ball, ball: [0, 0, 1], from_view: "2"}]\nnoise: 5 um')
    )
    (project / "jobs" / "views.yaml").write_text(job)
    ran = metrocli("selfcal-grid", "jobs/views.yaml")
    assert ran.code == 4
    assert "these views do not determine moved-ball.0 0 1" in ran.err


def test_the_plan_says_what_other_views_would_give(project: Path, metrocli: Metrocli) -> None:
    (project / "data" / "views.csv").unlink()
    ran = metrocli("plan", "jobs/views.yaml", "--out", "planned")
    assert ran.code == 0, ran.err
    assert "13 directions undetermined" in ran.out
    sets = csv.read(
        project / "planned" / "view_sets.csv", Columns((Column("views", TEXT), Column("undetermined", TEXT)))
    )
    worth = dict(zip(sets.texts("views"), sets.texts("undetermined"), strict=True))
    assert worth["planned"] == "13"
    assert worth["without '4'"] == "27"
    assert worth["without '3'"] == "18"
    assert worth["without '2'"] == "31"
    sheet = csv.read(
        project / "planned" / "views_to_measure.csv",
        Columns((Column("view", TEXT), *(Column(k, WHOLE) for k in "ijk"), *(Column(a, "length") for a in "xyz"))),
    )
    assert len(sheet) == 475
    row = np.flatnonzero(
        (np.array(sheet.texts("view")) == "2")
        & (sheet.numbers("i") == 2)
        & (sheet.numbers("j") == 1)
        & (sheet.numbers("k") == 0)
    )[0]
    assert [sheet.numbers(a)[row] for a in "xyz"] == [-65.0, 130.0, 0.0]


def test_simulated_lengths_are_those_of_the_simulated_artefact(project: Path, metrocli: Metrocli) -> None:
    truth = "simulation={machine_error: 17 um, artefact_error: 0.2 mm}"
    ran = metrocli("simulate", "jobs/scaled.yaml", "--out", "new", "--seed", "4", "--set", truth)
    assert ran.code == 0, ran.err
    given = ("--set", "inputs={views: ../new/views.csv, lengths: ../new/lengths.csv}", "--output", "results/new.h5")
    ran = metrocli("selfcal-grid", "jobs/scaled.yaml", *given)
    assert ran.code == 0, ran.err
    assert ran.err == ""
    true = csv.read(project / "new" / "true_machine_error.csv", ERRORS).stacked(["ex", "ey", "ez"])
    found = hdf5.read(project / "results" / "new.h5")[0].tables["machine_error"]
    share = (found.stacked(["ex", "ey", "ez"]) - true) / found.stacked(["s_ex", "s_ey", "s_ez"])
    assert np.sqrt((share**2).mean()) == pytest.approx(1.0, abs=0.35)


@pytest.mark.parametrize("size", [pytest.param(5, marks=pytest.mark.slow), 13])
def test_the_plan_knows_the_lengths(size: int, project: Path, metrocli: Metrocli) -> None:
    """They fix the scale, in the sets of views that are tried on a smaller grid too."""
    half = size // 2
    (project / "data" / "lengths.csv").write_text(
        f"i1,j1,k1,i2,j2,k2,length_mm,sigma_mm\n{-half},0,0,{half},0,0,{65 * 2 * half},0.001\n"
    )
    ran = metrocli("plan", "jobs/scaled.yaml", "--out", "planned", "--set", f"grid.size=[{size}, {size}, {size}]")
    assert ran.code == 0, ran.err
    assert "12 directions undetermined" in ran.out
    assert "the scale is that of the lengths" in ran.out
    sets = csv.read(
        project / "planned" / "view_sets.csv", Columns((Column("views", TEXT), Column("undetermined", TEXT)))
    )
    worth = dict(zip(sets.texts("views"), sets.texts("undetermined"), strict=True))
    assert worth["planned"] == "12"
    # without the turn about x the scale along z stays open, and the two kinds of field that planes across z can have
    assert worth["without '3'"] == "17"


def test_a_view_beside_the_grid_cannot_be_planned(project: Path, metrocli: Metrocli) -> None:
    for command in ("plan", "simulate"):
        (project / "data" / "views.csv").unlink(missing_ok=True)
        ran = metrocli(
            command, "jobs/views.yaml", "--out", "planned", "--set", "views=[{name: a}, {name: b, shift: [5, 0, 0]}]"
        )
        assert ran.code == 3, ran.err
        assert "view 'b' brings no ball to a site of the grid" in ran.err
        assert not (project / "planned").exists()


@pytest.mark.parametrize(
    ("keep", "least"),
    [("12", 90), *(pytest.param(*one, marks=pytest.mark.slow) for one in (("124", 290), ("123", 370)))],
)
def test_diagnosis_of_few_views_sees_what_they_determine(
    keep: str, least: int, project: Path, metrocli: Metrocli
) -> None:
    """What the views leave open is held: it is not an effect's, takes no reading away, and hides no metres."""
    rows = (project / "data" / "views.csv").read_text().splitlines()
    kept = [row for row in rows if row.split(",")[0] in ("view", *keep)]
    (project / "data" / "views.csv").write_text("\n".join(kept) + "\n")
    ran = metrocli("diagnose", "jobs/views.yaml", "--json")
    assert ran.code == 0, ran.err
    found = json.loads(ran.out)
    assert found["verdict"] == "clean"
    low, high = found["noise"]["interval"]
    # 95 % of sigma0 with so many degrees of freedom
    assert high - low < 1.2 * 4 / np.sqrt(2 * least)
    hiding = [one for one in found["candidates"] if one.get("hides")]
    assert len(hiding) > 10
    assert all(one["hides"]["unit"] == "um" for one in hiding)
    # the middle ball stands at one place of the machine in all turned views, so its move is seen least
    assert all(one["hides"]["value"] < 200 for one in hiding)
    assert all(one["hides"]["value"] < 100 for one in hiding if one["where"] != {"ball": "0 0 0"})


@pytest.mark.slow
def test_diagnosis_needs_more_readings_than_unknowns(project: Path, metrocli: Metrocli) -> None:
    rows = (project / "data" / "views.csv").read_text().splitlines()
    (project / "data" / "views.csv").write_text("\n".join(row for row in rows if row[0] not in "23") + "\n")
    ran = metrocli("diagnose", "jobs/views.yaml")
    assert ran.code == 4
    assert "no more readings than unknowns" in ran.err


@pytest.mark.slow
def test_a_view_of_one_ball_is_no_disturbed_datum(project: Path, metrocli: Metrocli) -> None:
    rows = (project / "data" / "views.csv").read_text().splitlines()
    kept = [row for row in rows if row[0] != "4" or row.startswith("4,0,0,0,")]
    (project / "data" / "views.csv").write_text("\n".join(kept) + "\n")
    ran = metrocli("diagnose", "jobs/views.yaml")
    assert ran.code == 0, ran.err
    assert "verdict: clean" in ran.out
    assert "datum" not in ran.out


def test_the_correction_is_minus_the_error(project: Path, metrocli: Metrocli) -> None:
    assert metrocli("selfcal-grid", "jobs/views.yaml", "--quiet").code == 0
    assert metrocli("export", "results/views.h5", "--to", "csv", "--out", "export").code == 0
    wanted = Columns((*(Column(a, "length") for a in "xyz"), *(Column(f"add_{a}", "length") for a in "xyz")))
    table = csv.read(project / "export" / "correction.csv", wanted)
    sites = hdf5.read(project / "results" / "views.h5")[0].tables["machine_error"]
    assert np.allclose(table.stacked("xyz"), 65.0 * sites.stacked("ijk"))
    assert np.allclose(table.stacked(["add_x", "add_y", "add_z"]), -sites.stacked(["ex", "ey", "ez"]))


def test_residuals_know_where_their_readings_were_taken(project: Path, metrocli: Metrocli) -> None:
    """The sites of the sample are 65 mm apart; its mountings and turns displace the readings by little more than 1 mm."""
    assert metrocli("selfcal-grid", "jobs/views.yaml", "--quiet").code == 0
    residuals = hdf5.read(Path("results/views.h5"))[0].tables["residuals"]
    component = np.array(["xyz".index(one) for one in residuals.texts("component")])
    own = residuals.stacked("xyz")[np.arange(len(residuals)), component]
    assert np.abs(residuals.numbers("reading") - own).max() < 2.0
    assert [residuals.units[axis] for axis in "xyz"] == ["mm"] * 3


def test_the_largest_length_error_is_that_of_all_pairs(project: Path, metrocli: Metrocli) -> None:
    assert metrocli("selfcal-grid", "jobs/views.yaml", "--quiet").code == 0
    result = hdf5.read(project / "results" / "views.h5")[0]
    sites = result.tables["machine_error"]
    r, e = 65.0 * sites.stacked("ijk"), sites.stacked(["ex", "ey", "ez"])
    largest = 0.0
    for n in range(len(r)):
        between = np.delete(r - r[n], n, axis=0)
        error = np.einsum("na,na->n", np.delete(e - e[n], n, axis=0), between) / np.linalg.norm(between, axis=1)
        largest = max(largest, float(np.abs(error).max()))
    assert abs(result.statistics["largest_length_error"]["mm"]) == pytest.approx(largest, rel=1e-12)
    assert result.tables["length_error"].numbers("lengths").sum() == 125 * 124 / 2


def test_the_published_sequence_is_shown_beside(project: Path, metrocli: Metrocli) -> None:
    ran = metrocli("selfcal-grid", "jobs/views.yaml", "--compare", "--json")
    assert ran.code == 0, ran.err
    joint, sequence = (row["noise_gain"] for row in json.loads(ran.out)["rows"])
    assert joint < sequence
    rows = (project / "data" / "views.csv").read_text().splitlines()
    (project / "data" / "views.csv").write_text("\n".join(row for row in rows if row[0] != "3") + "\n")
    ran = metrocli("selfcal-grid", "jobs/views.yaml", "--compare")
    assert ran.code == 4
    assert "cannot be compared" in ran.err


def test_without_noise_the_published_sequence_is_right_but_for_second_order() -> None:
    """It is unbiased: what it differs by is a mounting of some mrad, known to some tenths, times the artefact's error."""
    from simulated.grid import grid

    from metrocli.tasks.selfcal_grid import task as selfcal_grid

    one = grid(5, seed=5)
    table = selfcal_grid.compare(selfcal_grid.TASK.job(one.settings(), one.read(np.random.default_rng(0), noise=0.0)))
    assert table.numbers("rms_machine_error")[0] > 8e-3
    assert table.numbers("rms_difference")[1] < 5e-5


def test_a_ball_that_is_read_again_later_is_a_reading_of_its_own(tmp_path: Path, metrocli: Metrocli) -> None:
    """As `diagnose --next` proposes it: the same view and ball, at another time."""
    metrocli("init", tmp_path / "cube", "--sample", "ball-cube")
    views = tmp_path / "cube" / "data" / "views.csv"
    text = views.read_text()
    row = next(line for line in text.splitlines() if line.startswith("2,")).split(",")
    views.write_text(text + ",".join([*row[:-1], "99000"]) + "\n")
    job = tmp_path / "cube" / "jobs" / "views.yaml"
    assert metrocli("selfcal-grid", job, "--set", "require={}").code == 0
    table = hdf5.read(tmp_path / "cube" / "results" / "views.h5")[0].tables["residuals"]
    rows = list(zip(*(table.texts(name) for name in ("view", "i", "j", "k", "time", "component")), strict=True))
    assert len(set(rows)) == len(rows)
    assert (*row[:4], "99000 s", "x") in rows
    views.write_text(text + ",".join(row) + "\n")
    assert "a second row" in metrocli("check", job).err
