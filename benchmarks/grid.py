"""Self-calibration of a machine by a ball grid: exactness, rank, noise, coverage, and speed beside scipy's lsmr.

Each size runs in a process of its own, so that its largest memory is its own. Seconds are CPU time; with the wall time
in brackets. `metrocli selfcal-grid` is the whole command: reading the CSV, all results, writing. lsmr solves the same
linear problem once, for the values alone, from a start of zero.

    python -m benchmarks.grid [SIZE ...]
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from metrocli.adjust.coupled_fields import adjust_fields, design_of
from metrocli.instruments import ball_grid as bg
from metrocli.table import Table
from metrocli.tasks.selfcal_grid.determination.undetermined import opened
from metrocli.tasks.selfcal_grid.lengths import largest
from metrocli.tasks.selfcal_grid.problem import GridProblem, build
from metrocli.tasks.selfcal_grid.readings import read
from metrocli.tasks.selfcal_grid.sequence import noise_gains
from metrocli.tasks.selfcal_grid.settings import (
    GridSettings,
    GridSimulation,
    Inputs,
    Rotate,
    Settings,
    ViewSettings,
    views_of,
)
from metrocli.tasks.selfcal_grid.simulation import simulated
from metrocli.tasks.selfcal_grid.task import run

Array = npt.NDArray[np.float64]
NOISE, PITCH, RUNS = 5e-4, 65.0, 200
VIEWS = {
    "1": ViewSettings("1"),
    "2": ViewSettings("2", Rotate("z", np.pi / 2)),
    "3": ViewSettings("3", Rotate("x", np.pi / 2)),
    "4": ViewSettings("4", shift=(1, 0, 0)),
    "5": ViewSettings("5", shift=(0, 1, 0)),
    "6": ViewSettings("6", shift=(0, 0, 1)),
}
SIZES = (3, 5, 7, 11, 15, 21, 31)
JOB = """metrocli: 1
job: selfcal-grid
inputs: {{views: views.csv}}
grid: {{size: [{n}, {n}, {n}], pitch: 65 mm}}
views:
  - {{name: "1"}}
  - {{name: "2", rotate: {{axis: z, angle: 90 deg}}}}
  - {{name: "3", rotate: {{axis: x, angle: 90 deg}}}}
  - {{name: "4", shift: [1, 0, 0]}}
noise: 5 um
simulation: {{machine_error: 17 um, artefact_error: 0.1 mm, shift: 0.2 mm, tilt: 2 mrad}}
"""


def measured(n: int, views: str = "1234", noise: float = 0.0) -> tuple[GridProblem, dict[str, Array]]:
    """Return a simulated self-calibration and its true fields."""
    truth = GridSimulation(machine_error=0.017, artefact_error=0.1, shift=0.2, tilt=2e-3)
    some = tuple(VIEWS[name] for name in views)
    settings = Settings(Inputs(Path("-")), GridSettings((n, n, n), PITCH), some, NOISE, simulation=truth)
    files = simulated(replace(settings, noise=max(noise, 1e-300)), None, (), np.random.default_rng(n)).files
    readings = read(views_of(settings), settings.grid.half, files["views.csv"])
    problem = build(readings, (settings.grid.half, PITCH), NOISE)
    fields = {name: files[f"true_{name}.csv"].stacked(bg.COLUMNS) for name in (bg.MACHINE, bg.ARTEFACT)}
    return problem, fields


@contextmanager
def timed(what: dict[str, tuple[float, float]], name: str) -> Iterator[None]:
    """Keep CPU and wall seconds of a step."""
    cpu, wall = time.process_time(), time.perf_counter()
    yield
    what[name] = time.process_time() - cpu, time.perf_counter() - wall


def one(n: int) -> None:
    """Print what one size takes and gives."""
    problem, truth = measured(n)
    took: dict[str, tuple[float, float]] = {}
    with timed(took, "rank, factor"):
        design = design_of(problem.fields)
    with timed(took, "values"):
        solution = adjust_fields(problem.fields, design).solution
    with timed(took, "uncertainties"):
        std = design.std(bg.MACHINE)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    with timed(took, "lsmr"):
        steps = _lsmr(problem, design.jacobian)
    error = max(float(np.abs(solution.blocks[name].values - truth[name]).max()) for name in truth)
    gain = float(np.sqrt((std**2).mean()) / NOISE)
    parts = ", ".join(f"{name} {cpu:.2f} [{wall:.2f}]" for name, (cpu, wall) in took.items() if name != "lsmr")
    whole = [sum(took[name][k] for name in took if name != "lsmr") for k in (0, 1)]
    print(
        f"N = {n:2}: {design.partition.width:6} unknowns, {design.jacobian.shape[0]:6} readings, undetermined "
        f"{design.null.shape[1]}, noise-free error {error:.0e} mm, noise gain {gain:.3f}\n"
        f"        {whole[0]:.2f} s [{whole[1]:.2f}] ({parts}), {memory} MB; "
        f"lsmr {took['lsmr'][0]:.2f} s [{took['lsmr'][1]:.2f}], {steps} iterations, without uncertainties",
        flush=True,
    )


def command(n: int) -> None:
    """Print what the command takes for one size, its readings simulated by the program."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder)
        (path / "job.yaml").write_text(JOB.format(n=n))
        program = [sys.executable, "-m", "metrocli"]
        simulation = [*program, "simulate", str(path / "job.yaml"), "--out", str(path / "new")]
        subprocess.run(simulation, check=True, stdout=subprocess.DEVNULL)
        (path / "new" / "views.csv").rename(path / "views.csv")
        start = time.perf_counter()
        with subprocess.Popen([*program, "selfcal-grid", str(path / "job.yaml")], stdout=subprocess.DEVNULL) as running:
            _, status, used = os.wait4(running.pid, 0)
            wall = time.perf_counter() - start
            running.returncode = os.waitstatus_to_exitcode(status)
    assert running.returncode == 0
    cpu, memory = used.ru_utime + used.ru_stime, used.ru_maxrss // 1024
    print(f"        metrocli selfcal-grid: {cpu:.2f} s [{wall:.2f}], {memory} MB", flush=True)


def _lsmr(problem: GridProblem, jacobian: object) -> int:
    from scipy.sparse.linalg import lsmr

    at_start = problem.readings.residuals(problem.fields.blocks) / NOISE
    return int(lsmr(jacobian, at_start.ravel(), atol=1e-12, btol=1e-12, maxiter=5000)[2])


def reduced_sets() -> None:
    """Print what reduced sets of views leave open."""
    for views in ("123", "124", "134", "1246", "123456"):
        for n in (3, 5, 7):
            problem, _ = measured(n, views)
            found = opened(problem, design_of(problem.fields))
            named = "; ".join(f"{family.pattern} ({family.count})" for family in found.families)
            beyond = f" beyond 13: {named}" if named else ""
            print(f"views {' '.join(views):11} N = {n}: undetermined {found.count}{beyond}")


def coverage() -> None:
    """Print how often 95 % intervals of the machine error hold over 200 measurements."""
    for views in ("1234", "123456"):
        problem, truth = measured(5, views)
        design, rng = design_of(problem.fields), np.random.default_rng(1)
        std, inside, group = design.std(bg.MACHINE), [], problem.readings
        for _ in range(RUNS):
            noisy = group.observations.readings + rng.normal(0.0, NOISE, group.observations.readings.shape)
            group_now = group.with_observations(group.observations.with_readings(noisy))
            solution = adjust_fields(replace(problem.fields, groups=(group_now,)), design).solution
            inside.append(np.abs(solution.blocks[bg.MACHINE].values - truth[bg.MACHINE]) < 1.96 * std)
        held = np.mean(inside)
        print(f"N = 5, {len(views)} views: 95 % intervals of the machine error hold in {held:.1%} ({RUNS} runs)")


def sequence() -> None:
    """Print what the published sequence loses against the joint adjustment."""
    for n in (5, 7, 11):
        joint, other = noise_gains(measured(n)[0], np.random.default_rng(2), 50)
        print(f"N = {n:2}: noise gain {joint:.3f} joint, {other:.3f} with views fitted first and differences (eq. 6-9)")


def between_sites(machines: int = 10) -> None:
    """Print how far the forms are off between the sites of smooth machines, against what they state."""
    rng = np.random.default_rng(3)
    off: dict[str, list[tuple[float, float]]] = {"trilinear": [], "smooth form": []}
    lengths = []
    for _ in range(machines):
        settings, files, field = _smooth_machine(rng)
        places = rng.uniform(-2 * PITCH, 2 * PITCH, (200, 3))
        columns = {"point": np.arange(200).astype(str), **dict(zip("xyz", places.T, strict=True))}
        found = run(settings, files["views.csv"], None, Table(columns, dict.fromkeys("xyz", "mm")))
        for name, form in (("trilinear", ""), ("smooth form", "smooth_")):
            error = found.tables["map"].stacked([f"{form}e{a}" for a in "xyz"]) - field(places)
            stated = found.tables["map"].stacked([f"s_{form}e{a}" for a in "xyz"])
            off[name].append((float((error**2).mean()), float((stated**2).mean())))
        sites = found.tables["machine_error"]
        true = largest(PITCH * sites.stacked("ijk"), field(PITCH * sites.stacked("ijk")))
        given = found.statistics
        lengths.append([abs(true.error if true else 0.0), abs(given["largest_length_error"]["mm"])])
        lengths[-1].append(given["largest_length_error_std"]["mm"])
    for name, squares in off.items():
        error, stated = 1e3 * np.sqrt(np.mean(squares, axis=0))
        print(f"N = 5, noise 5 um, between the sites, {name}: off by {error:.1f} um rms, stated {stated:.1f} um")
    true, given, std = 1e3 * np.mean(lengths, axis=0)
    print(f"N = 5, noise 5 um, largest length error: true {true:.1f} um, found {given:.1f} um, stated {std:.1f} um")


def _smooth_machine(rng: np.random.Generator) -> tuple[Settings, Mapping[str, Table], Callable[[Array], Array]]:
    """Return a simulated self-calibration of a machine of third order, and its error at any place."""
    views = tuple(VIEWS[name] for name in "1234")
    truth = GridSimulation(machine_error=0.017, artefact_error=0.2)
    settings = Settings(Inputs(Path("-")), GridSettings((5, 5, 5), PITCH), views, 5e-3, leave_one_out="no")
    files = simulated(replace(settings, simulation=truth), None, (), rng).files
    table = files["true_machine_error.csv"]

    def terms(places: Array) -> Array:
        x, y, z = places.T / (2 * PITCH)
        powers = [(p, q, r) for p in range(4) for q in range(4) for r in range(4) if p + q + r <= 3]
        return np.stack([x**p * y**q * z**r for p, q, r in powers], axis=1)

    at_sites = terms(PITCH * table.stacked("ijk"))
    coefficients = np.linalg.lstsq(at_sites, table.stacked(bg.COLUMNS), rcond=None)[0]
    return settings, files, lambda places: np.asarray(terms(places) @ coefficients)


def main() -> None:
    """Print all figures, or those of one size."""
    if sys.argv[1:2] == ["--one"]:
        one(int(sys.argv[2]))
        return
    sizes = [int(text) for text in sys.argv[1:]]
    for n in sizes or SIZES:
        subprocess.run([sys.executable, "-m", "benchmarks.grid", "--one", str(n)], check=True)
        command(n)
    if not sizes:
        reduced_sets()
        coverage()
        sequence()
        between_sites()


if __name__ == "__main__":
    main()
