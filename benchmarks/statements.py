"""Twenty statements of reports, drawn at random, against simulations written apart from the program.

Reports are those of sample projects (gear-m3d3, xm60-launch-unit, raw-part, ball-cube, machine-lengths, gauge-block),
made by the command line. A sort of claim is drawn first, then a statement of that sort. The measurement behind it is a
plain function of its unknowns (benchmarks/apart), adjusted by least squares with derivatives from differences.
Statements of `diagnose` on power are held against how often it notices what plain formulas put into readings. A
simulated number has its interval of 99.9 %; the statement holds if it reaches the claim.

    python -m benchmarks statements [COUNT] [SEED]
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.apart import alignment, ball_grid, diagnosed, figures, part, samples, statement, three_axes
from benchmarks.apart.diagnosed import Diagnosed
from benchmarks.apart.model import Model
from benchmarks.apart.statement import Statement

COUNT, SEED = 20, 1
_MINIMUM = 1.47
"""Minimum of the overstock [mm] in a second fit of the casting, close to the least overstock"""


def _metrocli(folder: Path, *words: str) -> str:
    """Return what the command line prints; a doubtful result (exit code 6) has statements as well."""
    ran = subprocess.run(
        [sys.executable, "-m", "metrocli", *words], cwd=folder, capture_output=True, text=True, check=False
    )
    if ran.returncode not in (0, 6):
        raise RuntimeError(f"metrocli {' '.join(words)}: exit code {ran.returncode}\n{ran.stderr}")
    return ran.stdout


def _reported(folder: Path, sample: str, *words: str) -> dict[str, Any]:
    """Return the summary of a job of a sample, which is copied into a folder first."""
    if not (folder / sample).is_dir():
        _metrocli(folder, "init", sample, "--sample", sample)
    return dict(json.loads(_metrocli(folder / sample, *words, "--json")))


def _of_model(
    named: tuple[str, str], model: Model, facts: Mapping[str, Any], stds: Mapping[str, float], unit: str
) -> Iterator[list[Statement]]:
    """Yield what every adjustment states: standard uncertainties, global test, degrees of freedom, critical values."""
    yield list(statement.uncertainties(*named, model, stds, unit))
    yield [statement.global_test(*named, model, facts), statement.degrees_of_freedom(*named, model, facts["dof"])]
    if "critical_w" in facts:
        yield [statement.false_alarms(*named, model, facts["critical_w"], len(model.rows))]


def _of_readings(
    one: Diagnosed, facts: Mapping[str, Any], rows: Sequence[Mapping[str, Any]], keys: Sequence[str]
) -> Iterator[list[Statement]]:
    """Yield what is stated of single readings."""
    sizes = {tuple(row[key] for key in keys): row["detectable"] for row in rows if np.isfinite(row["detectable"])}
    limits = facts["critical_w"], max(1.0, facts["sigma0"])
    yield list(statement.detectable(one.kind, one.place, one.model, sizes, limits))


def _of_diagnosis(one: Diagnosed, report: Mapping[str, Any]) -> Iterator[list[Statement]]:
    """Yield what `diagnose` states."""
    yield [statement.noise_interval(one.kind, one.place, one.model, report["noise"])]
    yield [diagnosed.chance(one, report["structure"]["before"])]
    yield from _of_sizes(one, report)


def _of_sizes(one: Diagnosed, report: Mapping[str, Any]) -> Iterator[list[Statement]]:
    """Yield from which sizes `diagnose` excludes effects, and what unseen ones hide."""
    yield list(diagnosed.excluded(one, report["candidates"]))
    yield list(diagnosed.hidden(one, report["candidates"]))


def _redundancy(
    named: tuple[str, str], model: Model, result: Path, keys: Sequence[str], column: str = "redundancy"
) -> list[Statement]:
    rows = samples.stated(result, "residuals")
    return list(statement.redundancies(*named, model, {tuple(row[key] for key in keys): row[column] for row in rows}))


def _of_casting(folder: Path) -> Iterator[list[Statement]]:
    """Yield the statements on the casting: spindle camera, ideal part in the raw part, part in the machine."""
    place, named = folder / "raw-part", ("calibrate-camera", "raw-part camera")
    report = _reported(folder, "raw-part", "calibrate-camera", "jobs/camera.yaml")
    stds = {name: one["std"] for name, one in report["estimates"].items()}
    yield from _of_model(named, samples.camera(place), report["statistics"], stds, "(mm, rad, px)")

    _reported(folder, "raw-part", "calibrate-camera", "jobs/photogrammetry.yaml")
    report = _reported(folder, "raw-part", "fit-part", "jobs/fit.yaml")
    # a minimum that the least overstock exceeds by no more than its uncertainty leaves the best pose as it is
    words = ("--set", f"overstock.minimum={_MINIMUM} mm", "--output", "results/close.h5")
    _reported(folder, "raw-part", "fit-part", "jobs/fit.yaml", *words)
    result = place / "results/fit.h5"
    casting = part.Casting(place, result)
    yield from part.statements("raw-part", casting, result)
    yield [part.degrees_of_freedom("raw-part", casting, report["statistics"]["dof"])]
    close = part.Casting(place, place / "results/close.h5")
    yield list(part.unclean("raw-part", close, samples.stated(place / "results/close.h5", "surfaces"), _MINIMUM))

    report = _reported(folder, "raw-part", "align-part", "jobs/align.yaml")
    named, model, result = ("align-part", "raw-part"), alignment.alignment(place), place / "results/align.h5"
    stds = {name: one["std"] for name, one in report["estimates"].items()}
    yield from _of_model(named, model, report["statistics"], stds, "(mm, rad)")
    gauged = samples.stated(result, "points")
    stds = {f"{row['point']}.{axis}": row[f"s{axis}"] for row in gauged for axis in "xyz"}
    yield list(statement.uncertainties(*named, model, stds, "mm"))
    screws = [row for row in samples.stated(result, "supports") if row["raise"] > 0]
    stds = {f"raise of {row['support']}": row["raise_std"] for row in screws}
    stds |= dict(
        zip(alignment.LEVELLED, (row["levelled_std"] for row in samples.stated(result, "zero_point")), strict=True)
    )
    yield list(statement.uncertainties(*named, model, stds, "(mm, rad)"))
    said = next(note for note in report["notes"] if note.startswith("tilt that may be left: "))
    yield [alignment.tilt_left(*named, model, 1e-3 * float(said.split()[5]))]
    yield _redundancy(named, model, result, ("image", "target", "component"))
    seen = alignment.diagnosed(place, "jobs/align.yaml", model)
    yield from _of_diagnosis(seen, _reported(folder, "raw-part", "diagnose", "jobs/align.yaml"))


def _of_ball_cube(folder: Path) -> Iterator[list[Statement]]:
    """Yield the statements on the ball cube, without and with calibrated lengths."""
    place = folder / "ball-cube"
    for job in ("views", "scaled"):
        report = _reported(folder, "ball-cube", "selfcal-grid", f"jobs/{job}.yaml")
        named, result = ("selfcal-grid", f"ball-cube {job}"), place / f"results/{job}.h5"
        model = ball_grid.ball_grid(place, lengths=job == "scaled")
        stds = {name: one["std"] for name, one in report["estimates"].items()}
        yield from _of_model(named, model, report["statistics"], stds, "(mm, rad)")
        stds = {
            f"{what} {row['i']:g},{row['j']:g},{row['k']:g}.{axis}": row[f"s_e{axis}"]
            for what in ("machine", "artefact")
            for row in samples.stated(result, f"{what}_error")
            for axis in "xyz"
        }
        yield list(statement.uncertainties(*named, model, stds, "mm"))
        yield _redundancy(named, model, result, ("view", "i", "j", "k", "component"))
        if job == "views":
            cube = ball_grid.diagnosed(place, "jobs/views.yaml", model)
            yield from _of_sizes(cube, _reported(folder, "ball-cube", "diagnose", "jobs/views.yaml"))


def _of_machine(folder: Path) -> Iterator[list[Statement]]:
    """Yield the statements on a machine from lengths: tables, squareness and figures of ISO 230."""
    report = _reported(folder, "machine-lengths", "calibrate-machine", "jobs/lengths.yaml")
    named, result = ("calibrate-machine", "machine-lengths"), folder / "machine-lengths/results/lengths.h5"
    model = three_axes.machine(folder / "machine-lengths", report["statistics"]["repeatability"])
    stds = {
        f"{name} at {row['position']:g}": row["std"]
        for name in three_axes.TABLES
        for row in samples.stated(result, f"tables/{name}")
        if row["std"] > 0
    }
    yield from _of_model(named, model, report["statistics"], stds, "(mm, rad)")
    square = samples.stated(result, "squareness")
    stds = {row["error"]: row["s_end_points"] for row in square}
    stds |= {f"{row['error']} of least squares": row["s_least_squares"] for row in square}
    yield list(statement.uncertainties(*named, model, stds, "rad"))
    stds = {f"G in {row['plane']}": row["U_G"] / 2 for row in samples.stated(result, "circular")}
    stds |= {f"E of {row['diagonal']}": row["U_E"] / 2 for row in samples.stated(result, "diagonal_figures")}
    yield list(statement.uncertainties(*named, model, stds, "mm (U/2)"))
    yield list(three_axes.volume(*named, model, samples.stated(result, "volumetric")))
    yield _redundancy(named, model, result, ("point", "station"), "redundancy_length")
    seen = three_axes.diagnosed(folder / "machine-lengths", "jobs/lengths.yaml", model)
    yield from _of_sizes(seen, _reported(folder, "machine-lengths", "diagnose", "jobs/lengths.yaml"))


def sorts(folder: Path) -> Iterator[list[Statement]]:
    """Yield all statements of the reports, sort by sort."""
    job = "jobs/tip3.yaml"
    facts = _reported(folder, "gear-m3d3", "multilaterate", job)["statistics"]
    gear = samples.gear(folder / "gear-m3d3")
    rows = samples.stated(folder / "gear-m3d3/results/tip3.h5", "residuals")
    for table in ("points", "corrected"):
        found = samples.stated(folder / "gear-m3d3/results/tip3.h5", table)
        stds = {f"{row['point']}.{axis}": 1e3 * row[f"s{axis}"] for row in found for axis in "xyz"}
        scaled = gear.in_units(1e3)
        yield list(statement.uncertainties("multilaterate", f"gear-m3d3 /{table}", scaled, stds, "um"))
    moves: dict[tuple[str, ...], tuple[float, float]] = {
        (row["point"], row["tracer"]): (row["detectable"], row["moves_point"]) for row in rows
    }
    seen = {key: move for key, move in moves.items() if np.isfinite(move).all()}
    yield list(statement.moved_points("multilaterate", "gear-m3d3", gear, seen))
    yield from _of_model(("multilaterate", "gear-m3d3"), gear, facts, {}, "")
    network = samples.diagnosed_gear(folder / "gear-m3d3", job, gear)
    yield from _of_readings(network, facts, rows, ("point", "tracer"))
    yield from _of_diagnosis(network, _reported(folder, "gear-m3d3", "diagnose", job))

    job = "jobs/table.yaml"
    report = _reported(folder, "xm60-launch-unit", "locate-launch-unit", job)
    place = folder / "xm60-launch-unit"
    unit = samples.diagnosed_launch_unit(place, job, samples.launch_unit(place))
    stds = {name: one["std"] for name, one in report["estimates"].items()}
    yield from _of_model((unit.kind, unit.place), unit.model, report["statistics"], stds, "(mm, rad)")
    rows = [row for name in ("angles", "distances") for row in samples.stated(place / "results/table.h5", name)]
    yield from _of_readings(unit, report["statistics"], rows, ("pose", "reading"))
    yield from _of_diagnosis(unit, _reported(folder, "xm60-launch-unit", "diagnose", job))

    yield from _of_casting(folder)
    yield from _of_ball_cube(folder)
    yield from _of_machine(folder)

    gauge = _reported(folder, "gauge-block", "report-uncertainty", "jobs/gum.yaml")["estimates"]["l"]
    shares = samples.stated(folder / "gauge-block/results/gum.h5", "budget")
    yield from (
        [one]
        for one in figures.budget("gauge-block", gauge, {row["contributor"]: row["share"] / 100 for row in shares})
    )


def drawn(all_sorts: Sequence[Sequence[Statement]], count: int, rng: np.random.Generator) -> Iterator[Statement]:
    """Yield statements at random, none twice: a sort first, then one of that sort."""
    left = [list(sort) for sort in all_sorts]
    for _ in range(count):
        left = [sort for sort in left if sort]
        sort = left[int(rng.integers(len(left)))]
        yield sort.pop(int(rng.integers(len(sort))))


def main(arguments: list[str]) -> int:
    """Print the table of statements; return 1 if one does not hold."""
    count, seed = ([int(word) for word in arguments] + [COUNT, SEED][len(arguments) :])[:2]
    rng, failed = np.random.default_rng(seed), 0
    with tempfile.TemporaryDirectory() as name:
        print("| claim | report | stated | simulated | holds |\n|---|---|---|---|---|")
        for one in drawn(list(sorts(Path(name))), count, rng):
            found = one.check(rng)
            failed += not found.holds
            row = (one.claim, f"{one.kind} ({one.place})", one.stated, found.text, "yes" if found.holds else "NO")
            print(f"| {' | '.join(row)} |", flush=True)
    print(f"{count - failed} of {count} hold")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
