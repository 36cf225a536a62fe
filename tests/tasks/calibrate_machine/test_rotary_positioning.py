"""Rotary axes tested alone by an indexer or an autocollimator: ISO 230-2 by hand, mistakes, effects and plans."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from metrocli.effects.links.motions import waves
from metrocli.formats import hdf5
from metrocli.result import Result

Metrocli = Callable[..., Any]
JOB = """metrocli: 1
job: calibrate-machine
method: six-dof
machine: {axes: {c: {range: [0 deg, 360 deg], knots: 13}}}
inputs: {lines: lines.csv}
noise: {angle: 0.2 arcsec}
output: c.h5
"""
TARGETS = np.arange(0.0, 361.0, 30.0)
RUNS = 5
ARCSEC = np.degrees(3600.0)
"""[arcsec] in a radian"""


def error(c: np.ndarray) -> np.ndarray:
    """Return what an axis errs by [arcsec], once and twice a turn."""
    return 4 * np.sin(np.radians(c) + 0.3) + np.sin(np.radians(2 * c))


def readings(
    targets: np.ndarray = TARGETS, backlash: float = 0.0, ways: Sequence[int] = (1, -1), noise: float = 0.2
) -> list[tuple[float, float]]:
    """Return targets [deg] and deviations [arcsec] of five runs in each way, in the order of travel, with a zero off."""
    rng, rows = np.random.default_rng(31), []
    for _ in range(RUNS):
        for way in ways:
            along = targets[::way]
            read = error(along) + 1.7 + way * backlash / 2 + noise * rng.normal(size=len(along))
            rows += list(zip(along.tolist(), read.tolist(), strict=True))
    return rows


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Write a job and its lines in the working folder."""
    monkeypatch.chdir(tmp_path)

    def written(
        rows: Sequence[tuple[float, ...]], head: str = "c_deg,ec_arcsec", job: str = JOB, letter: str = "c"
    ) -> None:
        cells = [f"L1,{letter},{','.join(f'{cell:.12g}' for cell in row)}" for row in rows]
        Path("job.yaml").write_text(job)
        Path("lines.csv").write_text("\n".join([f"line,axis,{head}", *cells, ""]))

    return written


def solved(metrocli: Metrocli, *more: str, code: int = 0) -> Result:
    ran = metrocli("calibrate-machine", "job.yaml", "--force", *more)
    assert ran.code == code, ran.err
    return hdf5.read(Path("c.h5"))[0]


def by_hand(rows: Sequence[tuple[float, float]]) -> dict[str, float]:
    """Return the figures of ISO 230-2 [arcsec] with loops over targets and runs."""
    n = len(TARGETS)
    runs = [rows[i : i + n] for i in range(0, len(rows), n)]
    top, bottom, middles, gaps, repeats, means = [], [], [], [], [], []
    for target in TARGETS:
        sides = []
        for way in (0, 1):
            read = [value for run in runs[way::2] for at, value in run if at == target]
            mean = sum(read) / len(read)
            s = (sum((value - mean) ** 2 for value in read) / (len(read) - 1)) ** 0.5
            sides.append((mean, s))
            top.append(mean + 2 * s)
            bottom.append(mean - 2 * s)
            means.append(mean)
        (up, s_up), (down, s_down) = sides
        gaps.append(up - down)
        middles.append((up + down) / 2)
        repeats.append(max(2 * s_up + 2 * s_down + abs(up - down), 4 * s_up, 4 * s_down))
    return {
        "A": max(top) - min(bottom),
        "R": max(repeats),
        "B": max(map(abs, gaps)),
        "B_mean": sum(gaps) / n,
        "E": max(means) - min(means),
        "M": max(middles) - min(middles),
    }


def test_figures_are_those_of_the_formulas(write: Any, metrocli: Metrocli) -> None:
    rows = readings(backlash=1.6)
    write(rows, job=JOB + "effects: [{name: backlash, axis: c}]\n")
    result = solved(metrocli)
    figures = result.tables["positioning"]
    for name, value in by_hand(rows).items():
        assert ARCSEC * figures.numbers(name)[0] == pytest.approx(value, rel=1e-9), name
    # a difference of two means of five readings, and the mean of such differences at 13 targets, with k = 2
    assert ARCSEC * figures.numbers("U_B")[0] == pytest.approx(2 * 0.2 * np.sqrt(2 / 5))
    assert ARCSEC * figures.numbers("U_B_mean")[0] == pytest.approx(2 * 0.2 * np.sqrt(2 / 5 / 13))
    assert result.warnings == ()
    targets = result.tables["positioning_targets"]
    assert np.allclose(np.degrees(targets.numbers("angle")), TARGETS)
    (width,) = [one for one in result.estimates if one.name == "backlash.c.width"]
    assert abs(ARCSEC * width.value - 1.6) < 3 * ARCSEC * width.std


def test_the_table_is_the_error_of_the_axis(write: Any, metrocli: Metrocli) -> None:
    """It is 0 at 0 and the same at 360 deg; only the positioning is reported, and nothing of a volume."""
    write(readings())
    result = solved(metrocli)
    table = result.tables["tables/ECC"]
    value, std = ARCSEC * table.numbers("value"), ARCSEC * table.numbers("std")
    assert np.abs(value[[0, -1]]).max() < 1e-12 and np.allclose(np.degrees(table.numbers("position")), TARGETS)
    true = error(TARGETS) - error(TARGETS[:1])
    assert np.abs(value - true)[1:-1].max() < 3.5 * std.max() and std.max() < 0.1
    assert result.tables["errors"].texts("error") == ["ECC"]
    assert "volume" not in result.tables and "rotary_motion" not in result.tables


def test_uncertainties_are_honest(write: Any, metrocli: Metrocli) -> None:
    """Eleven free entries of a table with one zero: chi2 of six tables with their covariance has 66 degrees of freedom."""
    chi2 = 0.0
    for seed in range(6):
        rng = np.random.default_rng(700 + seed)
        write([(at, value + 0.2 * rng.normal()) for at, value in readings(noise=1e-4)])
        result = solved(metrocli)
        rows = [i for i, name in enumerate(result.tables["tables_entries"].texts("error")) if name == "ECC"][1:-1]
        off = result.tables["tables/ECC"].numbers("value")[1:-1] - (error(TARGETS) - error(TARGETS[:1]))[1:-1] / ARCSEC
        chi2 += off @ np.linalg.solve(result.arrays["tables_covariance"][np.ix_(rows, rows)], off)
    assert 0.5 < chi2 / 66 < 1.5


@pytest.mark.parametrize(
    ("head", "factors"),
    [
        ("c_gon,ec_mdeg", (1 / 0.9, 1 / 3.6)),
        ("c_rad,ec_urad", (np.pi / 180, 1e6 / ARCSEC)),
        ("c_deg,ec_deg", (1.0, 1 / 3600)),
    ],
)
def test_any_unit_of_angle_gives_the_same(write: Any, metrocli: Metrocli, head: str, factors: Any) -> None:
    rows = readings()
    write([(at * factors[0], value * factors[1]) for at, value in rows], head)
    figures = solved(metrocli).tables["positioning"]
    for name, value in by_hand(rows).items():
        assert ARCSEC * figures.numbers(name)[0] == pytest.approx(value, rel=1e-6), name


def test_targets_may_count_on_through_the_turn(write: Any, metrocli: Metrocli) -> None:
    """From 90 to 450 deg the table is that of 0 to 360 deg."""
    write(readings(TARGETS + 90.0, noise=1e-4))
    table = solved(metrocli).tables["tables/ECC"]
    assert np.abs(ARCSEC * table.numbers("value") - error(TARGETS) + error(TARGETS[:1])).max() < 1e-3


def test_the_count_of_the_axis_decides_the_sign(write: Any, metrocli: Metrocli) -> None:
    """What is read is in the count of the axis; the table is right-handed, as those of other methods."""
    for sense in (1, -1):
        write(readings(noise=1e-4), job=JOB.replace("knots: 13", f"knots: 13, sense: {sense}"))
        value = ARCSEC * solved(metrocli).tables["tables/ECC"].numbers("value")
        assert np.abs(sense * value - error(TARGETS) + error(TARGETS[:1])).max() < 1e-3


def test_one_direction_has_its_own_figures(write: Any, metrocli: Metrocli) -> None:
    write(readings(ways=(1,)))
    ran = metrocli("calibrate-machine", "job.yaml")
    assert ran.code == 0 and "5 runs up and 0 down; ISO 230-2:2014 asks for five in each direction" in ran.err
    assert "E_up [arcsec]" in ran.out and "angle [deg]" in ran.out
    figures = hdf5.read(Path("c.h5"))[0].tables["positioning"]
    assert np.isnan(figures.numbers("B")[0]) and figures.numbers("A_up")[0] > 0
    # the axis returns at once to its first target, which belongs to the run that begins there
    rows = readings(ways=(1,))
    means = [np.mean([value for at, value in rows if at == target]) for target in TARGETS]
    assert ARCSEC * figures.numbers("E_up")[0] == pytest.approx(max(means) - min(means))
    assert "leave it out" not in ran.err and figures.numbers("runs_up")[0] == 5


def test_too_few_targets_are_told(write: Any, metrocli: Metrocli) -> None:
    write(readings(TARGETS[::3]), job=JOB.replace("13", "5"))
    ran = metrocli("calibrate-machine", "job.yaml")
    assert ran.code == 0 and "axis C, line 'L1': 5 targets over 360 deg; ISO 230-2:2014 asks for 8" in ran.err


def scaled(factor: float) -> list[tuple[float, float]]:
    return [(at * factor, value) for at, value in readings()]


REFUSED = {
    "radians": (scaled(np.pi / 180), "c_deg,ec_arcsec", "then write `c_rad`"),
    "gon": (scaled(1 / 0.9), "c_deg,ec_arcsec", "then write `c_gon`"),
    "degrees": (readings(), "c_rad,ec_arcsec", "then write c_deg"),
    "wrapped": (
        [(at % 360, value) for at, value in readings()],
        "c_deg,ec_arcsec",
        "c goes from 330 deg to 0 deg: one way the direction of approach is up, the other way it is down",
    ),
    "wrapped inside a run": (
        [(at % 360, value) for at, value in readings(TARGETS + 90)],
        "c_deg,ec_arcsec",
        "count on through the turn and write 360 deg",
    ),
    "measured": ([(at, at + value / 3600) for at, value in readings()], "c_deg,ec_deg", "write the deviations"),
    "two targets": (readings(TARGETS[[0, -1]]), "c_deg,ec_arcsec", "has fewer than 3 positions"),
    "along x": (readings(), "c_deg,ex_um", "lines along rotary axes have their own angle alone"),
    "no targets": (readings(), "b_deg,ec_arcsec", "the column 'c_deg' is missing"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_would_give_wrong_figures_is_refused(write: Any, metrocli: Metrocli, name: str) -> None:
    rows, head, message = REFUSED[name]
    write(rows, head)
    ran = metrocli("calibrate-machine", "job.yaml")
    assert ran.code == 3 and message in ran.err, ran.err
    assert not Path("c.h5").exists()


def test_a_correction_that_is_offered_fits(write: Any, metrocli: Metrocli) -> None:
    """The same angles under the heading that the message gives; and an axis that did turn back."""
    write(scaled(1 / 0.9), "c_gon,ec_arcsec")
    assert ARCSEC * solved(metrocli).tables["positioning"].numbers("E")[0] == pytest.approx(by_hand(readings())["E"])
    back = JOB.replace("knots: 13", "knots: 12, periodic: false").replace("360 deg", "330 deg")
    write([(at, value) for at, value in readings(ways=(1,)) if at < 360], job=back)
    solved(metrocli)


@pytest.mark.parametrize(
    ("column", "angular"),
    [("[ECC]", True), ("[ECC, EAA]", False), ("[ECC, EXX]", False), ("all", False)],
)
def test_the_job_of_a_whole_machine_names_the_axis(write: Any, metrocli: Metrocli, column: str, angular: bool) -> None:
    whole = """machine:
  chain: wCAbXYZt
  axes:
    x: {range: [-350 mm, 350 mm], knots: 6}
    y: {range: [-400 mm, 400 mm], knots: 5}
    z: {range: [-700 mm, 0 mm], knots: 5}
    a: {range: [-105 deg, 30 deg], knots: 10, at: [0 mm, 12 mm, -520 mm]}
    c: {range: [0 deg, 360 deg], knots: 13, at: [0 mm, 0 mm, -560 mm]}
"""
    lines = JOB.splitlines(keepends=True)
    write(readings(), job="".join([*lines[:3], whole, f"estimate: {column}\n", *lines[4:]]))
    ran = metrocli("calibrate-machine", "job.yaml")
    assert ran.code == (0 if angular else 3), ran.err


def test_the_place_of_the_other_axis_is_in_the_figures(write: Any, metrocli: Metrocli) -> None:
    """C is tested at A = -30 deg; of A there are no lines."""
    job = JOB.replace("axes: {", "axes: {a: {range: [-105 deg, 30 deg], knots: 4}, ").replace(
        "inputs", "estimate: [ECC]\ninputs"
    )
    write(readings(), job=job)
    assert solved(metrocli).tables["positioning"].texts("at") == [""]
    rows = [(-30.0, *row) for row in readings()]
    write(rows, "a_deg,c_deg,ec_arcsec", job=job.replace("[ECC]", "[ECC, EAA]"))
    ran = metrocli("calibrate-machine", "job.yaml")
    assert ran.code == 3 and "leave EAA out of `estimate`" in ran.err


def dense(more: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> list[tuple[float, float, float]]:
    """Return 47 targets at uneven steps, three runs to and fro, with something hidden in them: c, e and t."""
    rng = np.random.default_rng(8)
    inside = np.linspace(0, 360, 47) + np.append(np.append(0, rng.uniform(-3, 3, 45)), 0)
    way = np.tile(np.append(inside, inside[::-1]), 3).round(2)
    t = 30.0 * np.arange(len(way))
    straight = np.interp(way, TARGETS, error(TARGETS))
    return list(zip(way, straight + 0.2 * rng.normal(size=len(way)) + more(way, t), t, strict=True))


HIDDEN: dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
    "worm-error c": lambda c, t: 1.5 * np.sin(np.radians(36 * c) + 1),
    "indexer-drift L1": lambda c, t: 1.5 * t / 3600,
    "encoder-eccentricity c": lambda c, t: 20 * np.cos(np.radians(c) + 2),
    "": lambda c, t: 0 * c,
}


@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=pytest.mark.slow if one[:1] in ("", "w", "e") else ()) for one in HIDDEN]
)
def test_what_is_hidden_is_named(write: Any, metrocli: Metrocli, name: str) -> None:
    """What turns once is not a blunder: the table has it at its knots, and the effect between them."""
    write(dense(HIDDEN[name]), "c_deg,ec_arcsec,t_s")
    ran = metrocli("diagnose", "job.yaml", "--limit", "30s")
    verdict = ran.out.splitlines()[0]
    if name:
        assert verdict.startswith("verdict: explained") and f"{name} explains" in ran.out, ran.out
    else:
        assert verdict == "verdict: clean", ran.out


def test_a_plan_is_simulated_and_solved(write: Any, metrocli: Metrocli) -> None:
    """The program goes beyond each end before it comes back, and its targets are those of the list."""
    job = JOB + "simulation: {error: 0.01 mm}\n"
    write(readings(), job=job)
    Path("lines.csv").unlink()
    assert metrocli("plan", "job.yaml", "--out", "plan").code == 0
    rows = [line.split(",") for line in Path("plan/lines.csv").read_text().splitlines()]
    assert rows[0] == ["line", "axis", "c_deg"]
    listed = [float(row[2]) for row in rows[1:]]
    assert len(listed) == 10 * 13 and np.ptp(np.diff(sorted(set(listed)))) > 10
    blocks = [line for line in Path("plan/lines.nc").read_text().splitlines() if line.startswith("G")][1:]
    moves = [float(line.split("C")[1]) if "C" in line else None for line in blocks]
    read = [moves[i - 1] for i, move in enumerate(moves) if move is None]
    assert read == pytest.approx(listed, abs=1e-4)
    assert moves.count(-1.0) == 5 and moves.count(361.0) == 5
    assert metrocli("simulate", "job.yaml", "--out", "new", "--seed", "5").code == 0
    Path("lines.csv").write_text(Path("new/lines.csv").read_text())
    found = solved(metrocli).tables["tables/ECC"]
    true = [line.split(",") for line in Path("new/true_errors.csv").read_text().splitlines()]
    turn = np.array([float(row[4]) for row in true if row[0] == "ECC"])
    z = (found.numbers("value") - turn)[1:-1] / found.numbers("std")[1:-1]
    assert np.abs(z).max() < 4 and 0.4 < np.sqrt((z**2).mean()) < 1.7
    assert np.abs(turn).mean() * 300 == pytest.approx(0.01, rel=0.3)


def test_linear_axes_alone_are_planned_and_simulated_too(write: Any, metrocli: Metrocli) -> None:
    job = JOB.replace("c: {range: [0 deg, 360 deg]", "x: {range: [0 mm, 600 mm]").replace(
        "angle: 0.2 arcsec", "displacement: 0.5 um"
    )
    write(readings(), job=job + "simulation: {error: 0.01 mm}\n")
    Path("lines.csv").unlink()
    assert metrocli("plan", "job.yaml", "--out", "plan").code == 0
    text = Path("plan/lines.nc").read_text()
    assert text.count("G1 X0.0000") == text.count("G1 X600.0000") == 5
    assert metrocli("simulate", "job.yaml", "--out", "new").code == 0
    Path("lines.csv").write_text(Path("new/lines.csv").read_text())
    assert solved(metrocli).statistics["sigma0"] == pytest.approx(1, abs=0.2)


def test_its_result_does_not_stand_for_a_machine(write: Any, metrocli: Metrocli) -> None:
    """Nothing is known of where the axis lies, so no place of a tool is predicted."""
    write(readings())
    assert "chain" not in solved(metrocli).statistics
    rows = [f"P{i},{i},{i % 2},{i % 3},{30 * i},0,0,0" for i in range(5)]
    Path("check.csv").write_text("\n".join(["point,x_mm,y_mm,z_mm,c_deg,mx_mm,my_mm,mz_mm", *rows, ""]))
    ran = metrocli("verify", "c.h5", "check.csv")
    assert ran.code == 3 and "the positioning of C alone" in ran.err


def test_waves_that_are_zero_at_every_target_have_no_signature() -> None:
    angle = np.radians(np.arange(0.0, 361.0, 30.0))
    for periods in (36, 72, 654, 720):
        sine, cosine = waves(periods * angle)
        assert not sine.any()
        assert np.allclose(np.abs(cosine), 1)


def test_no_worm_is_named_from_rounding(write: Callable[..., None], metrocli: Metrocli) -> None:
    """Scatter that no effect explains: the 654 periods of a worm are 0 at all of these targets, except for rounding."""
    rng, rows = np.random.default_rng(3), []
    for _ in range(RUNS):
        for way in (1, -1):
            along = TARGETS[::way]
            read = 5 * np.sin(np.radians(along)) + 2 * way + rng.normal(size=len(along)) * 0.2
            rows += list(zip(along.tolist(), np.round(read, 3).tolist(), strict=True))
    write(rows, job=JOB + "effects: [{name: backlash, axis: c}]\n")
    ran = metrocli("diagnose", "job.yaml", "--limit", "30s")
    assert ran.code == 0, ran.err
    assert "worm-error c  amplitude" not in ran.out
