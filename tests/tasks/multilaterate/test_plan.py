"""What a plan predicts is what the measurement then states; what cannot be determined is said before it is made."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated.lengths import (
    CORNERS,
    VOLUME,
    Network,
    all_in_one_plane,
    close_together,
    network,
    on_line,
    on_plane,
    places,
    settings,
    without_motion,
)

from metrocli.errors import InputError, UndeterminedError
from metrocli.formats import csv
from metrocli.plan import Plan
from metrocli.settings import KnownQuantity
from metrocli.table import Table
from metrocli.tasks.multilaterate import task as multilaterate
from metrocli.tasks.multilaterate.layout import distance
from metrocli.tasks.shared.part import Part


def candidates(at: np.ndarray) -> Table:
    names = np.array([f"K{i}" for i in range(len(at))])
    return Table({"candidate": names, **dict(zip("xyz", at.T, strict=True))}, dict.fromkeys("xyz", "mm"))


ONE = candidates(CORNERS[6:7] * VOLUME)
"""A place for one more tracer, where a test is not of the 98 that are tried without a list"""


def planned(net: Network, scale: float | None = None, candidates: Table | None = ONE, **more: Any) -> Plan:
    """The plan of a network with the points where they are meant to be."""
    points = replace(net, nominal=net.points).point_table()
    files = {"points": points, "tracers": net.tracer_table(0.0), "candidates": candidates}
    return multilaterate.plan(multilaterate.TASK.job(settings(scale), **files, **more))


@pytest.mark.parametrize(("m", "scale"), [(5, 5e-7), *(pytest.param(m, None, marks=pytest.mark.slow) for m in (4, 8))])
def test_the_measurement_states_what_was_planned(m: int, scale: float | None) -> None:
    net = network(25, m, seed=m, scale=scale or 0.0)
    plan = planned(net, scale)
    result = multilaterate.run(
        multilaterate.TASK.job(settings(scale), net.lengths(), net.point_table(), net.tracer_table())
    )
    listed_at, then = plan.tables["points"], result.tables["points"]
    assert listed_at.stacked(["sx", "sy", "sz"]) == pytest.approx(then.stacked(["sx", "sy", "sz"]), rel=2e-3)
    worst = np.sqrt(np.linalg.eigvalsh(result.arrays["points_covariance"])[:, -1])
    assert listed_at.numbers("worst") == pytest.approx(worst, rel=2e-3)
    # tests of lengths refer to the noise that was found, if it is larger than planned
    noise = max(1.0, float(str(result.statistics["sigma0"])))
    for name, factor in (("redundancy", 1.0), ("detectable", noise), ("moves_point", noise)):
        told, found = factor * plan.tables["reliability"].numbers(name), result.tables["residuals"].numbers(name)
        sound = plan.tables["reliability"].numbers("redundancy") > 1e-3
        assert sound.mean() > 0.8
        assert told[sound] == pytest.approx(found[sound], rel=5e-2)
    stated = {e.name: e.std for e in result.estimates}
    lines = 0
    for figure in plan.figures:
        if " - " in figure.name:
            lines += 1
            assert figure.std == pytest.approx(distance(result, *figure.name.split(" - ")).std, rel=5e-3)
        else:
            assert figure.std == pytest.approx(stated[figure.name], rel=5e-3)
    assert lines >= 5


@pytest.mark.slow
def test_the_growth_of_a_part_is_planned_as_it_is_stated() -> None:
    net, part = network(30, 4, seed=2), Part(KnownQuantity(24.0, 0.5), KnownQuantity(12e-6, 1e-6))
    bare, job = settings(), replace(settings(), part=part)
    points, tracers = replace(net, nominal=net.points).point_table(), net.tracer_table(0.0)
    without, plan = (
        multilaterate.plan(multilaterate.TASK.job(one, points=points, tracers=tracers)) for one in (bare, job)
    )
    size = 1 + 4 * 12e-6
    spread = np.sqrt((4 * 1e-6) ** 2 + (12e-6 * 0.5) ** 2 + (1e-6 * 0.5) ** 2)
    at = net.points / size
    own = without.tables["points"].stacked(["sx", "sy", "sz"]) / size
    assert plan.tables["points"].stacked("xyz") == pytest.approx(at, abs=1e-9)
    assert plan.tables["points"].stacked(["sx", "sy", "sz"]) == pytest.approx(np.hypot(own, spread * at), rel=1e-6)
    for before, after in zip(without.figures, plan.figures, strict=True):
        length, std = before.value / size, before.std / size
        if " - " in after.name:
            assert (after.value, after.std) == pytest.approx((length, np.hypot(std, spread * length)), rel=1e-6)
    assert any("grown by 48 um/m ± 7.2" in note for note in plan.notes), plan.notes
    probed = replace(job, inputs=replace(job.inputs, probing=Path("probing.csv")))
    replayed = multilaterate.plan(multilaterate.TASK.job(probed, points=points, tracers=tracers))
    assert replayed.tables["points"].stacked("xyz") == pytest.approx(net.points)
    assert any("come to the corrected points" in note for note in replayed.notes)


def test_what_is_known_beforehand_counts() -> None:
    net = network(30, 4, seed=1)
    sigma = np.where(np.arange(30) < 4, 1e-4, np.nan)
    plan = multilaterate.plan(
        multilaterate.TASK.job(
            settings(datum="points"),
            points=net.point_table(sigma=sigma),
            tracers=net.tracer_table(0.0),
            candidates=ONE,
        )
    )
    then = multilaterate.run(
        multilaterate.TASK.job(settings(datum="points"), net.lengths(), net.point_table(sigma=sigma))
    )
    stated = then.tables["points"].stacked(["sx", "sy", "sz"])
    assert plan.tables["points"].stacked(["sx", "sy", "sz"]) == pytest.approx(stated, rel=1e-2)


def test_what_is_read_may_be_listed() -> None:
    """Points that a tracer does not see, and some that nobody reads: those of the job's lengths, whatever their values."""
    net = network(40, 6, seed=9)
    net.readings[:15, 2] = net.readings[30:, 4] = np.nan
    net.readings[[7, 20]] = np.nan
    zero = net.lengths()
    zero.columns["length"][:] = 0.0  # type: ignore[index]
    plan = planned(net, lengths=zero)
    result = multilaterate.run(multilaterate.TASK.job(settings(), net.lengths(), net.point_table()))
    listed_at, then = plan.tables["points"], result.tables["points"]
    assert listed_at.texts("point") == then.texts("point") and len(listed_at) == 38
    assert listed_at.stacked(["sx", "sy", "sz"]) == pytest.approx(then.stacked(["sx", "sy", "sz"]), rel=2e-3)
    assert any("2 points have no length: P7, P20" in line for line in plan.warnings)
    readings = np.column_stack([net.readings, np.where(np.isnan(net.readings).all(axis=1), np.nan, 1.0)])
    more = replace(net, tracers=np.vstack([net.tracers, CORNERS[6] * VOLUME]), readings=readings)
    with_it = planned(more, lengths=more.lengths()).tables["points"].stacked(["sx", "sy", "sz"])
    assert plan.tables["candidates"].numbers("rms")[0] == pytest.approx(np.sqrt((with_it**2).mean()), rel=1e-6)


BEYOND: dict[str, tuple[Callable[[], Network], str]] = {
    "three tracers": (lambda: network(30, 3), "there are 3 tracers; positions from length changes need 4 or more"),
    "four in a plane": (lambda: on_plane(4), "the 4 tracers stand in one plane"),
    "five in a plane": (lambda: on_plane(5), "the 5 tracers stand in one plane"),
    "points on a line": (lambda: on_line(5), "the points lie on a line: add points away from it"),
    "everything in a plane": (all_in_one_plane, "the points lie in one plane: add points out of it"),
    "few points": (lambda: network(9, 4, seed=1), "too few points: 9, where 4 tracers need 10"),
    "at one place": (close_together, "tracers T0 and T1 stand nearly at one place"),
}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if number > 1 else ()) for number, name in enumerate(BEYOND)]
)
def test_a_layout_that_cannot_carry_the_answer_is_refused_before_it_is_measured(name: str) -> None:
    make, words = BEYOND[name]
    with pytest.raises(UndeterminedError, match=words) as told:
        planned(make())
    assert "one more tracer" in str(told.value)


@pytest.mark.slow
def test_one_more_tracer_mends_a_plane_of_four_and_nothing_mends_a_line_of_points() -> None:
    with pytest.raises(UndeterminedError, match="would serve best at .98 places tried.:\n  C"):
        planned(on_plane(4), candidates=None)
    with pytest.raises(UndeterminedError, match="one more tracer alone would not help: 98 places were tried"):
        planned(on_line(5), candidates=None)


def test_the_best_place_for_one_more_tracer_is_as_good_as_told() -> None:
    """Measured with the tracer at the best and at the worst of 40 places at random: the errors made are those told."""
    rng = np.random.default_rng(5)
    net = network(30, 4, seed=5)
    around = VOLUME * (
        0.5 + rng.uniform(0.7, 1.5, (40, 1)) * (lambda v: v / np.abs(v).max(axis=1)[:, None])(rng.normal(size=(40, 3)))
    )
    plan = planned(net, candidates=candidates(around))
    table = plan.tables["candidates"]
    assert len(table) == 40
    assert (np.diff(table.numbers("rms")) >= 0).all()
    before = plan.tables["points"].stacked(["sx", "sy", "sz"])
    assert table.numbers("gain_rms") == pytest.approx(1 - table.numbers("rms") / np.sqrt((before**2).mean()), rel=1e-9)
    made = []
    for row in (0, -1):
        tracers = np.vstack([net.tracers, table.stacked("xyz")[row]])
        errors = []
        for _ in range(8):
            more = replace(net, tracers=tracers, dead=np.append(net.dead, 300.0), scale=np.ones(5)).read(rng)
            result = multilaterate.run(multilaterate.TASK.job(settings(), more.lengths(), more.point_table()))
            errors.append(without_motion(places(result.tables["points"]), net.points) - net.points)
        made.append(np.sqrt(np.mean(np.square(errors))))
        assert made[-1] == pytest.approx(table.numbers("rms")[row], rel=0.12)
    assert made[0] < made[1]


def test_a_candidate_beside_a_tracer_is_the_last_choice() -> None:
    net = network(25, 4, seed=2)
    at = np.vstack([net.tracers[1] + [3.0, 0.0, 0.0], CORNERS[5] * VOLUME])
    assert planned(net, candidates=candidates(at)).tables["candidates"].texts("candidate") == ["K1", "K0"]


def test_many_points_are_compared_by_some_of_them_and_planned_by_all() -> None:
    """1000 points: the ranking by 300 of them is that by all; the one known point stays among them."""
    net = network(1000, 4, seed=3)
    sigma = np.full(1000, np.nan)
    sigma[[1, 501, 777, 998]] = 1e-5
    at = VOLUME * [[1.6, 0.5, 0.5], [0.5, 0.5, 2.5], [-0.6, 0.5, 0.5]]
    points = net.point_table(sigma=sigma)
    plan = multilaterate.plan(
        multilaterate.TASK.job(settings(), points=points, tracers=net.tracer_table(0.0), candidates=candidates(at))
    )
    assert len(plan.tables["points"]) == 1000
    names = plan.tables["candidates"].texts("candidate")
    rms = []
    for name in names:
        more = replace(net, tracers=np.vstack([net.tracers, at[int(name[1:])]]), dead=np.zeros(5), scale=np.ones(5))
        alone = multilaterate.plan(
            multilaterate.TASK.job(
                settings(), points=points, tracers=more.tracer_table(0.0), candidates=candidates(at[:1])
            )
        )
        rms.append(np.sqrt((alone.tables["points"].stacked(["sx", "sy", "sz"]) ** 2).mean()))
    assert rms == sorted(rms)
    assert plan.tables["candidates"].numbers("rms") == pytest.approx(rms, rel=0.1)


@pytest.mark.slow
def test_what_a_test_will_not_find_is_told() -> None:
    four, eight = planned(network(30, 4, seed=1)), planned(network(30, 8, seed=1))
    assert any("cannot be identified; a fifth would identify it" in line for line in four.notes)
    assert not any("cannot be identified" in line for line in eight.notes)
    for plan in (four, eight):
        assert any("common error of the refractive index" in line for line in plan.notes)
        moves = plan.tables["reliability"].numbers("moves_point")
        assert np.isfinite(moves).any() and (moves > 0).all()
    assert np.median(eight.tables["reliability"].numbers("moves_point")) < np.median(
        four.tables["reliability"].numbers("moves_point")
    )


def test_a_tracer_on_a_point_is_refused() -> None:
    net = network(30, 4, seed=1)
    on = replace(net, tracers=np.vstack([net.tracers[:3], net.points[4]]))
    with pytest.raises(InputError, match="tracer T3 stands where point P4 is"):
        planned(on)


JOB = """metrocli: 1
job: multilaterate
inputs: {lengths: not-yet.csv, points: points.csv, tracers: tracers.csv}
noise: {constant: 0.1 um, proportional: 0.1 um/m}
output: o.h5
"""


@pytest.fixture
def job(tmp_path: Path) -> Path:
    net = network(30, 5, seed=1)
    csv.write(tmp_path / "points.csv", net.point_table())
    csv.write(tmp_path / "tracers.csv", net.tracer_table(0.0))
    (tmp_path / "job.yaml").write_text(JOB)
    return tmp_path / "job.yaml"


def test_the_command_plans_without_lengths(job: Path, metrocli: Callable[..., Any]) -> None:
    ran = metrocli("plan", job, "--json")
    assert ran.code == 0, ran.err
    listed_at = json.loads(ran.out)
    assert {Path(name).name for name in listed_at["files"]} >= {"points.csv", "reliability.csv", "candidates.csv"}
    assert all(Path(name).is_file() for name in listed_at["files"])
    assert "T0.x" in listed_at["figures"] and len(listed_at["tables"]["points"]["rows"]) == 30
    assert len((job.parent / "job.plan" / "candidates.csv").read_text().splitlines()) == 1 + 98


def test_the_command_needs_the_tracers(job: Path, metrocli: Callable[..., Any]) -> None:
    job.write_text(JOB.replace(", tracers: tracers.csv", ""))
    ran = metrocli("plan", job)
    assert ran.code == 3 and "where the tracers will stand" in ran.err


def test_the_command_tells_a_layout_that_will_not_do(job: Path, metrocli: Callable[..., Any]) -> None:
    kept = (job.parent / "tracers.csv").read_text().splitlines()[:4]
    (job.parent / "tracers.csv").write_text("\n".join(kept) + "\n")
    ran = metrocli("plan", job)
    assert ran.code == 4 and "there are 3 tracers" in ran.err and "one more tracer would serve best" in ran.err
    assert not job.with_name("job.plan").exists()


def test_candidates_may_be_listed_in_any_unit(job: Path, metrocli: Callable[..., Any]) -> None:
    (job.parent / "candidates.csv").write_text("candidate,x_m,y_m,z_m\ndoor,2,0.3,0.2\nwindow,0.5,-0.5,1.5\n")
    job.write_text(JOB.replace("tracers.csv}", "tracers.csv, candidates: candidates.csv}"))
    ran = metrocli("plan", job)
    assert ran.code == 0, ran.err
    assert "(2 places tried)" in ran.out and "door (2000, 300, 200) mm" in ran.out


def test_an_effect_is_planned_with_the_rest(job: Path, metrocli: Callable[..., Any]) -> None:
    """What it costs the points, and how well it will be known: as the measurement then states."""
    (job.parent / "candidates.csv").write_text("candidate,x_m,y_m,z_m\ndoor,2,0.3,0.2\n")
    more = "effects: [{name: dead-path-drift, tracer: T2}]\nsimulation: {interval: 10 s}\n"
    job.write_text(JOB.replace("tracers.csv}", "tracers.csv, candidates: candidates.csv}") + more)
    ran = metrocli("plan", job, "--json")
    assert ran.code == 0, ran.err
    drift = json.loads(ran.out)["figures"]["dead-path-drift.T2.rate"]
    assert metrocli("simulate", job, "--out", job.parent / "made").code == 0
    made = metrocli("multilaterate", job, "--json", "--set", "inputs.lengths=made/lengths.csv")
    assert made.code == 0, made.err
    assert json.loads(made.out)["estimates"]["dead-path-drift.T2.rate"]["std"] == pytest.approx(drift["std"], rel=1e-2)
