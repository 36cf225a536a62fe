"""Five-axis machines with something hidden in them: how often `diagnose` names it, and what is not there.

    python -m benchmarks hidden_in_rotary_axes [COUNT | FIRST-LAST]        # 150 unless given

An R-test probes random machines of two tables, with three balls in random poses; machines and readings are those of the
tests, 4 x 4 matrices written without the engine. In half of them the tables are estimated, in the others the locations
alone. In a third of them, and where the drawn effect cannot be tested, nothing is hidden. In the others it is an effect
of 1.5 to 3 times the size that the design states as found with 80 % power.
"""

from __future__ import annotations

import csv
import re
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from simulated import five_axis as sim

from benchmarks.hidden.named import print_rates, words
from metrocli.diagnosis.detectability import design
from metrocli.diagnosis.diagnose import diagnose
from metrocli.diagnosis.evidence.measured_job import measurement_of
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.findings import Diagnosis
from metrocli.project.diagnosed import adjusted_job_of
from metrocli.project.job import load

Array = npt.NDArray[np.float64]
COUNT, LEAST_SIZES = 150, (1.5, 3.0)
PROBINGS, SIGMA, INTERVAL = 150, 5e-4, 16.0
Where = dict[str, str]
Disturbed = Callable[[str, float, int], Array]
"""Nine errors of an axis by its letter, its position and the number of the reading"""
Change = Callable[[np.random.Generator, float], Disturbed]


def _only(letter: str, errors: Callable[[float, int], Sequence[float]]) -> Disturbed:
    return lambda axis, s, i: np.asarray(errors(s, i), dtype=float) if axis == letter else np.zeros(9)


def worm(rng: np.random.Generator, size: float) -> Disturbed:
    """A periodic error of the angle of C."""
    periods, phase = int(rng.integers(14, 200)), rng.uniform(0, 2 * np.pi)
    return _only("C", lambda s, i: [0, 0, 0, 0, 0, size * np.sin(periods * s + phase), 0, 0, 0])


def eccentricity(rng: np.random.Generator, size: float) -> Disturbed:
    """An error of the angle of C once a turn, zero at position 0."""
    a = rng.uniform(0, 2 * np.pi)
    return _only(
        "C", lambda s, i: [0, 0, 0, 0, 0, size * (np.cos(a) * (np.cos(s) - 1) + np.sin(a) * np.sin(s)), 0, 0, 0]
    )


def wobble(rng: np.random.Generator, size: float) -> Disturbed:
    """Tilts of C that turn several times a turn."""
    n, direction = int(rng.integers(2, 7)), rng.normal(size=4)
    c1, s1, c2, s2 = size * direction / np.linalg.norm(direction)

    def errors(s: float, i: int) -> Sequence[float]:
        cos, sin = np.cos(n * s), np.sin(n * s)
        return [0, 0, 0, c1 * cos + s1 * sin, c2 * cos + s2 * sin, 0, 0, 0, 0]

    return _only("C", errors)


def crash(rng: np.random.Generator, size: float) -> Disturbed:
    """The line of A stands elsewhere from some reading on."""
    begin, a = int(rng.integers(PROBINGS // 4, 3 * PROBINGS // 4)), rng.uniform(0, 2 * np.pi)
    shift = size * np.array([0, np.cos(a), np.sin(a)])
    return _only("A", lambda s, i: [0, 0, 0, 0, 0, 0, *(shift * (i >= begin))])


def drift(rng: np.random.Generator, size: float) -> Disturbed:
    """The line of C drifts; the size is a rate."""
    a = rng.uniform(0, 2 * np.pi)
    v = size * np.array([np.cos(a), np.sin(a), 0])
    return _only("C", lambda s, i: [0, 0, 0, 0, 0, 0, *(v * INTERVAL * i)])


def backlash(rng: np.random.Generator, size: float) -> Disturbed:
    """The angle of C depends on the side from which it comes."""
    positions: dict[int, float] = {}

    def errors(s: float, i: int) -> Sequence[float]:
        positions[i] = s
        return [0, 0, 0, 0, 0, size / 2 * (1.0 if s >= positions.get(i - 1, 0.0) else -1.0), 0, 0, 0]

    return _only("C", errors)


ALWAYS: dict[str, tuple[Change, Where]] = {
    "worm-error": (worm, {"axis": "c"}),
    "axis-jump": (crash, {"axis": "a"}),
    "pivot-drift": (drift, {"axis": "c"}),
    "backlash": (backlash, {"axis": "c"}),
}
WITHOUT_TABLES: dict[str, tuple[Change, Where]] = {
    "encoder-eccentricity": (eccentricity, {"axis": "c"}),
    "wobble": (wobble, {"axis": "c"}),
}
OF_READINGS = ("moved-ball", "machine-drift")
"""Effects that change the file of readings"""


def case(number: int, folder: Path) -> tuple[str, str]:
    """Return what was hidden in a case, and what was said."""
    whole = number % 2 == 0
    hidden = ""
    if number % 3:
        names = [*ALWAYS, *OF_READINGS, *(() if whole else WITHOUT_TABLES)]
        hidden = names[(number // 3) % len(names)]
    plain = _probed(folder, number, whole, None)
    if not hidden:
        return words(_diagnosed(plain), "", {})
    change, where = (ALWAYS | WITHOUT_TABLES).get(hidden, (None, {"ball": "K1"} if hidden == "moved-ball" else {}))
    least = _least(plain, hidden, where)
    if not np.isfinite(least):
        return words(_diagnosed(plain), "", {})
    rng = np.random.default_rng([79, number])
    size = least * rng.uniform(*LEAST_SIZES)
    job = _probed(folder, number, whole, None if change is None else change(rng, size))
    if change is None:
        _changed(folder, hidden, size, rng)
    return words(_diagnosed(job), hidden, where)


def _probed(folder: Path, number: int, whole: bool, disturbed: Disturbed | None) -> Path:
    """Write the job of a random machine; the same number has the same machine, poses and noise."""
    rng = np.random.default_rng([78, number])
    machine = sim.drawn(sim.KINDS["table-table"], rng, linear=False)
    if not whole:
        machine.tables = {}
    machine.disturbed = disturbed
    return sim.probed(folder, machine, rng, PROBINGS, SIGMA, "rotary" if whole else "locations", rtest=True)


def _changed(folder: Path, hidden: str, size: float, rng: np.random.Generator) -> None:
    """Add to the displacements what a moved ball, or a drift of the tool's side, changes in them."""
    perfect = sim.Machine(
        sim.KINDS["table-table"],
        {key: np.array([low, high]) for key, (low, high, _) in sim.KINDS["table-table"].axes.items()},
    )
    direction = rng.normal(size=3)
    step = size * direction / np.linalg.norm(direction)
    begin = float(rng.integers(PROBINGS // 4, 3 * PROBINGS // 4)) * INTERVAL
    path = folder / "probing.csv"
    with path.open() as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        pose = {key: float(row[f"{key.lower()}_{'deg' if key in sim.ROTARY else 'mm'}"]) for key in perfect.knots}
        pose = {key: value * sim.DEG if key in sim.ROTARY else value for key, value in pose.items()}
        t = float(row["t_s"])
        if hidden == "machine-drift":
            more = -step * t
        elif row["ball"] == "K1" and t >= begin:
            more = perfect.sides(pose)[0][:3, :3] @ step
        else:
            continue
        for axis, own in zip("xyz", more, strict=True):
            row[f"d{axis}_um"] = f"{float(row[f'd{axis}_um']) + 1e3 * own:.9f}"
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)


def _least(job: Path, name: str, where: Where) -> float:
    """Return the size that is found with 80 % power; inf if it is not tested."""
    tests = measurement_of(adjusted_job_of(load(job)))
    sizes = [
        one.detectable
        for one in design(State.of(tests)).candidates
        if (one.alternative.effect.name, dict(one.alternative.where)) == (name, where) and one.testable
    ]
    return min(sizes, default=np.inf)


def _diagnosed(job: Path) -> Diagnosis:
    return diagnose(adjusted_job_of(load(job)))


def main(arguments: list[str]) -> int:
    """Print the cases that are not plainly right, then the rates; return 1 where a bar is not met."""
    span = re.fullmatch(r"(?:(\d+)-)?(\d+)", arguments[0]) if arguments else None
    numbers = range(COUNT)
    if span is not None:
        numbers = range(int(span[2])) if span[1] is None else range(int(span[1]), int(span[2]) + 1)
    with tempfile.TemporaryDirectory() as where:
        return print_rates((str(number), case(number, Path(where))) for number in numbers)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
