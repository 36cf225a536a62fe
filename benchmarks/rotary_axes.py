"""Machines with rotary axes: recovery without noise, honesty of the uncertainties, what is left open, time and memory.

    python -m benchmarks rotary_axes recovery          # three machines, three methods, 200 places each
    python -m benchmarks rotary_axes honesty [RUNS]    # 100 runs of each method unless given
    python -m benchmarks rotary_axes open              # directions that few balls, tools and unknown probes leave open
    python -m benchmarks rotary_axes speed             # 300 probings, 20,000 points at standstill

Machines and readings are those of the tests: 4 x 4 matrices, written without the engine.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import numpy.typing as npt

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from simulated import five_axis as sim

from benchmarks.bars import Number
from metrocli.errors import UndeterminedError
from metrocli.project.inputs import read_inputs
from metrocli.project.job import load
from metrocli.tasks.calibrate_machine.solve import AdjustedMachine, solve
from metrocli.tasks.calibrate_machine.tables import tables_of
from metrocli.tasks.calibrate_machine.task import TASK, problem_of
from metrocli.tasks.calibrate_machine.volume import predict

Array = npt.NDArray[np.float64]
METHODS = ("probing", "standstill", "lengths")
NOISE = {"probing": 5e-4, "standstill": 1e-3, "lengths": 3e-4}
PLACES = 200


def measured(folder: Path, kind: str, method: str, seed: int, sigma: float) -> tuple[sim.Machine, Path]:
    """Return a random machine and the job that measures it."""
    rng = np.random.default_rng(seed)
    machine = sim.drawn(sim.KINDS[kind], rng, linear=method != "probing")
    fixed = 3 if kind == "table-table" else 0
    on = "workpiece" if kind == "head-table" else "bed"
    if method == "probing":
        return machine, sim.probed(folder, machine, rng, 200, sigma, rtest=kind != "table-table")
    noise = (
        (sigma, 2 * sigma, 3e-6 if sigma else 0.0) if method == "standstill" else (sigma, 0.0, 1e-7 if sigma else 0.0)
    )
    stations = 5 if method == "lengths" else 0
    return machine, sim.tracked(folder, machine, rng, 200 if stations else 400, noise, on, stations, fixed)


def adjusted(path: Path) -> tuple[AdjustedMachine, float]:
    """Return the solved calibration and its CPU time."""
    job = load(path)
    held = TASK.job(job.settings, **read_inputs(job))
    start = time.process_time()
    return solve(problem_of(held), False), time.process_time() - start


def scores(machine: sim.Machine, found: AdjustedMachine, seed: int) -> tuple[Array, Array, Array]:
    """Return errors of all entries over their uncertainty, of the predictions (mm), and their uncertainty."""
    tables = tables_of(found.problem.machine, found.solution)
    z = []
    for name, values in (machine.tables | {one: np.array([value]) for one, value in machine.places.items()}).items():
        _, value, std = tables.of(name)
        if len(value) and found.identified.status[name] == "determined":
            z += ((value - values)[std > 1e-9] / std[std > 1e-9]).tolist()
    rng = np.random.default_rng(seed + 1000)
    poses = [machine.drawn_pose(rng) for _ in range(PLACES)]
    nominal, errors = sim.errors_at(machine, poses, np.array(machine.kind.tools["T1"]))
    position = np.array([[pose[axis.letter] for pose in poses] for axis in found.problem.machine.axes])
    known = (tables.unknowns, tables.raw)
    predicted, design = predict(found.problem.machine, tables.blocks, known, position, 0)
    off = sim.without_motion(nominal, predicted.error.T - errors)
    rows = np.moveaxis(design, 0, 1)
    free = np.stack([sim.without_motion(nominal, rows[:, :, k]) for k in range(rows.shape[2])], axis=2)
    spread = np.einsum("nap,pq,naq->na", free, tables.raw, free)
    return np.array(z), off, np.sqrt(spread)


def recovery() -> None:
    """Print the largest error of the prediction for each machine and method."""
    for kind in sim.KINDS:
        for method in METHODS:
            with tempfile.TemporaryDirectory() as folder:
                machine, path = measured(Path(folder), kind, method, 1, 0.0)
                found, took = adjusted(path)
                off = np.abs(scores(machine, found, 1)[1]).max()
            print(f"{kind:12s} {method:10s} off by {1e3 * off:.1e} um at {PLACES} places, {took:.2f} s CPU", flush=True)


def honesty(runs: int) -> None:
    """Print how the errors of entries and predictions compare with their stated uncertainty."""
    for method in METHODS:
        z, off, std, misfit = [], [], [], []
        for run in range(runs):
            kind = tuple(sim.KINDS)[run % len(sim.KINDS)]
            with tempfile.TemporaryDirectory() as folder:
                machine, path = measured(Path(folder), kind, method, 100 + run, NOISE[method])
                found, _ = adjusted(path)
            own, wrong, stated = scores(machine, found, run)
            z.append(own)
            off.append(wrong)
            std.append(stated)
            misfit.append(found.solution.cost / found.solution.dof)
        joint, ratio = np.concatenate(z), np.sqrt(np.mean(np.square(off)) / np.mean(np.square(std)))
        inside = 100 * np.mean(np.abs(joint) < 1.96)
        of = f"{runs} runs"
        print(Number(f"z rms of all entries, {method}", of, float(np.sqrt(np.mean(joint**2))), 0.95, 1.05))
        print(Number(f"inside their 95 % intervals, {method}", of, float(inside), unit="%"))
        print(Number(f"error of the volume over its std, {method}", of, float(ratio), 0.9, 1.1))
        print(Number(f"chi2/dof, {method}", of, float(np.mean(misfit))), flush=True)


def left_open() -> None:
    """Print the number of open directions of some measurements, and which errors they concern."""
    rng = np.random.default_rng(5)
    table, head = sim.drawn(sim.KINDS["table-table"], rng, linear=False), sim.KINDS["head-head"]
    one_tool = sim.drawn(sim.Kind(**{**vars(head), "tools": {"T1": head.tools["T1"]}}), rng)
    for what, make, change in (
        ("1 ball, locations", lambda f: sim.probed(f, table, rng, 200, 5e-4, "locations", balls=1), ""),
        ("1 ball, rotary", lambda f: sim.probed(f, table, rng, 200, 5e-4, balls=1), ""),
        ("2 balls, rotary", lambda f: sim.probed(f, table, rng, 200, 5e-4, balls=2), ""),
        ("3 balls, rotary", lambda f: sim.probed(f, table, rng, 200, 5e-4), ""),
        ("3 balls, unknown probe", lambda f: sim.probed(f, table, rng, 200, 5e-4), "  tool_uncertainty: unknown\n"),
        ("head-head, tracker, 1 tool", lambda f: sim.tracked(f, one_tool, rng, 400, (1e-3, 2e-3, 0), "bed"), ""),
    ):
        with tempfile.TemporaryDirectory() as folder:
            path = make(Path(folder))
            path.write_text(path.read_text().replace("estimate:", change + "estimate:"))
            try:
                found = adjusted(path)[0].identified
                count = found.unknowns - found.rank
                print(f"{what}: {count} open, none moves the tool: {' '.join((*found.undetermined, *found.together))}")
            except UndeterminedError as error:
                print(f"{what}: {' '.join(str(error).split())}")


def speed() -> None:
    """Print CPU time and peak memory."""
    rng = np.random.default_rng(3)
    machine = sim.drawn(sim.KINDS["table-table"], rng, linear=False)
    with tempfile.TemporaryDirectory() as folder:
        adjusted(sim.probed(Path(folder), machine, rng, 300, 5e-4))  # loads what is loaded once
        print(f"300 probings: {adjusted(Path(folder) / 'job.yaml')[1]:.2f} s CPU")
    machine = sim.drawn(sim.KINDS["head-head"], rng)
    with tempfile.TemporaryDirectory() as folder:
        path = sim.tracked(Path(folder), machine, rng, 20_000, (1e-3, 2e-3, 3e-6), "bed")
        took = adjusted(path)[1]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    print(f"20,000 points at standstill: {took:.1f} s CPU, peak {peak:.2f} GB")


def main(arguments: list[str]) -> int:
    """Run what is named, or all."""
    runs = next((int(word) for word in arguments if word.isdigit()), 100)
    parts = {"recovery": recovery, "honesty": lambda: honesty(runs), "open": left_open, "speed": speed}
    wanted = [word for word in arguments if word in parts] or list(parts)
    for word in wanted:
        parts[word]()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
