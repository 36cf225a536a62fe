"""Twenty statements of reports, drawn at random, against simulations written apart from the program.

Reports are those of sample projects (gear-m3d3, xm60-launch-unit, the camera of raw-part, gauge-block), made by the
command line. A sort of claim is drawn first, then a statement of that sort. The measurement behind it is a plain
function of its unknowns (benchmarks/apart), adjusted by least squares with derivatives from differences. Statements of
`diagnose` on power are held against how often it notices what plain formulas put into readings. A simulated number has
its interval of 99.9 %; the statement holds if it reaches the claim.

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

from benchmarks.apart import diagnosed, figures, samples, statement
from benchmarks.apart.diagnosed import Diagnosed
from benchmarks.apart.statement import Statement

COUNT, SEED = 20, 1


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
    one: Diagnosed, facts: Mapping[str, Any], stds: Mapping[str, float], unit: str
) -> Iterator[list[Statement]]:
    """Yield what every adjustment states: standard uncertainties, and the global test."""
    yield list(statement.uncertainties(one.kind, one.place, one.model, stds, unit))
    yield [statement.global_test(one.kind, one.place, one.model, facts)]


def _of_readings(
    one: Diagnosed, facts: Mapping[str, Any], rows: Sequence[Mapping[str, Any]], keys: Sequence[str]
) -> Iterator[list[Statement]]:
    """Yield what is stated of single readings."""
    sizes = {tuple(row[key] for key in keys): row["detectable"] for row in rows if np.isfinite(row["detectable"])}
    limits = facts["critical_w"], max(1.0, facts["sigma0"])
    yield list(statement.detectable(one.kind, one.place, one.model, sizes, limits))
    yield [statement.false_alarms(one.kind, one.place, one.model, facts["critical_w"], len(rows))]


def _of_diagnosis(one: Diagnosed, report: Mapping[str, Any]) -> Iterator[list[Statement]]:
    """Yield what `diagnose` states."""
    yield [statement.noise_interval(one.kind, one.place, one.model, report["noise"])]
    yield [diagnosed.chance(one, report["structure"]["before"])]
    yield list(diagnosed.excluded(one, report["candidates"]))
    yield list(diagnosed.hidden(one, report["candidates"]))


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
    yield [statement.global_test("multilaterate", "gear-m3d3", gear, facts)]
    network = samples.diagnosed_gear(folder / "gear-m3d3", job, gear)
    yield from _of_readings(network, facts, rows, ("point", "tracer"))
    yield from _of_diagnosis(network, _reported(folder, "gear-m3d3", "diagnose", job))

    job = "jobs/table.yaml"
    report = _reported(folder, "xm60-launch-unit", "locate-launch-unit", job)
    place = folder / "xm60-launch-unit"
    unit = samples.diagnosed_launch_unit(place, job, samples.launch_unit(place))
    stds = {name: one["std"] for name, one in report["estimates"].items()}
    yield from _of_model(unit, report["statistics"], stds, "(mm, rad)")
    rows = [row for name in ("angles", "distances") for row in samples.stated(place / "results/table.h5", name)]
    yield from _of_readings(unit, report["statistics"], rows, ("pose", "reading"))
    yield from _of_diagnosis(unit, _reported(folder, "xm60-launch-unit", "diagnose", job))

    report = _reported(folder, "raw-part", "calibrate-camera", "jobs/camera.yaml")
    camera = samples.camera(folder / "raw-part")
    stds = {name: one["std"] for name, one in report["estimates"].items()}
    yield list(statement.uncertainties("calibrate-camera", "raw-part camera", camera, stds, "(mm, rad, px)"))
    yield [statement.global_test("calibrate-camera", "raw-part camera", camera, report["statistics"])]

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
