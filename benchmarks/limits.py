"""What may not take long: each figure beside its limit, in CPU seconds of the least of some runs unless said.

Some limits are promises (a help text, a volume), some only guard against a method of another order, such as a dense
solution of a network. The tests have no limits of time, since a busy machine would break them.

    python -m benchmarks limits
"""

from __future__ import annotations

import contextlib
import gc
import io
import random
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks import alignment, blunders, camera_speed, coverage, detection, files, references, uncertainty
from metrocli.errors import UndeterminedError
from metrocli.expressions.expression import ExpressionError, parse
from metrocli.simulation import SimulationOptions
from metrocli.table import Table
from metrocli.targets import blobs, ellipses
from metrocli.tasks.align_part import task as align_part
from metrocli.tasks.multilaterate import task as multilaterate
from metrocli.tasks.multilaterate.settings import Inputs, Settings
from metrocli.uncertainty.numbers import evaluate

HOSTILE = ("9**9**9**9", "(" * 150 + "x" + ")" * 150, "(" * 10_000, "a+" * 500_000 + "a", "-" * 4000 + "x", "9" * 4000)
PIECES = ("exp(", "atan2(", "x", "y", "9", "1e300", "0.5", "(", ")", ")", "+", "-", "*", "/", "**", "**", ",", "--")
FEW, MANY = 150, 600


@dataclass(frozen=True)
class Limit:
    """A figure that may not exceed a limit."""

    what: str
    found: Callable[[], float]
    most: float
    unit: str = "s"


def limits() -> Iterator[Limit]:
    """Yield what is measured."""
    yield Limit("metrocli --help", help_text, 0.08)
    yield Limit("a model as text that is refused, the slowest", lambda: max(map(refused, HOSTILE)), 0.05)
    yield Limit("a random text, parsed and evaluated, the slowest of 20,000", random_texts, 0.1)
    yield Limit("no Dask scheduler answers: wall time until that is reported", no_scheduler, 5.0)
    yield Limit("a volume of 50 x 50 x 50 points, 20 contributors", uncertainty.large_volume, 2.0)
    yield Limit("one ellipse of 20 px fitted", one_ellipse, 1.5e-3)
    yield Limit("a part aligned (7D) with covariance", alignment.seconds, 0.2)
    yield Limit("a part aligned that was clamped at 40 degrees", clamped_anyhow, 0.5)
    yield Limit("a tracer that reads four points and is not listed: refused", partial(few_lengths, False), 2.0)
    yield Limit("a tracer that reads four points and is listed", partial(few_lengths, True), 2.0)
    yield Limit(f"{MANY} views of a board over {FEW}: 4 is linear, 16 a square law", growth, 9.0, "")
    if references.DATA.is_dir():
        yield Limit("a network of 115 images (a dense solution takes minutes)", network, 40.0)


def help_text() -> float:
    """Return the cost of a help text, compiled before as after an installation."""
    with tempfile.TemporaryDirectory() as cache:
        return min(files.costs_of([sys.executable, "-m", "metrocli", "--help"], Path(cache)))


def refused(text: str) -> float:
    """Return the time in which a text is refused."""
    before = time.process_time()
    with contextlib.suppress(ExpressionError):
        parse(text)
    return time.process_time() - before


def random_texts() -> float:
    """Return the longest time of many texts, with the collector of garbage held off."""
    rng, values, slowest = random.Random(1), {"x": np.array([0.3, -2.0]), "y": np.array([1.5, 0.0])}, 0.0
    gc.collect()
    gc.freeze()
    for _ in range(20_000):
        text = "".join(rng.choices(PIECES, k=rng.randint(1, 25)))
        before = time.process_time()
        with contextlib.suppress(ExpressionError):
            model = parse(text)
            if set(model.names) <= set(values):
                evaluate(model, values)
        slowest = max(slowest, time.process_time() - before)
    gc.unfreeze()
    return slowest


def no_scheduler() -> float:
    """Return the wall time of a job for which no scheduler answers."""
    from metrocli.cli.commands import run

    with tempfile.TemporaryDirectory() as folder:
        job = Path(folder) / "gauge.yaml"
        job.write_text(uncertainty.JOB.replace("TRIALS", "10000"), encoding="utf-8")
        before = time.monotonic()
        with contextlib.redirect_stderr(io.StringIO()):
            assert run(["report-uncertainty", str(job), "--quiet", "--scheduler", "tcp://127.0.0.1:1"]) == 3
        return time.monotonic() - before


def one_ellipse() -> float:
    """Return the time of one fit from a start near the target."""
    image, _ = detection.draw(np.random.default_rng(6), 20, 0.7, 2.0)
    start = max(blobs.ellipses(image, "dark"), key=lambda found: found.long)
    return least(lambda: ellipses.fit(image, start), 30)


def clamped_anyhow() -> float:
    """Return the time of an alignment whose start is sought at all clamping angles."""
    targets, settings = coverage.corners(), coverage.alignment_settings(0.05, np.radians(40.0))
    job = partial(align_part.TASK.job, settings, coverage.true_camera(), coverage.poses_over(targets), targets)
    seen = align_part.simulate(job(), SimulationOptions(7)).files["observations.csv"]
    return least(lambda: align_part.run(job(observations=seen)), 3)


def few_lengths(listed: bool) -> float:
    """Return the time in which a network is solved or refused two of whose tracers read four points only."""
    net = blunders.measured(7, np.random.default_rng(24))
    seen = np.ones(net.readings.shape, dtype=bool)
    seen[4:, 0] = seen[:-4, 1] = False
    point, tracer = np.nonzero(seen)
    names, stations = np.char.add("P", np.arange(len(seen)).astype(str)), np.array([f"T{j}" for j in range(7)])
    lengths = Table({"point": names[point], "tracer": stations[tracer], "length": net.readings[seen]}, {"length": "mm"})
    about = {"point": (names, net.nominal), "tracer": (stations, blunders.PLACES[:7] * blunders.VOLUME)}
    points, tracers = (
        Table({key: name, **dict(zip("xyz", at.T, strict=True))}, dict.fromkeys("xyz", "mm"))
        for key, (name, at) in about.items()
    )
    settings = Settings(Inputs(Path("-"), Path("-")), blunders.NOISE)
    before = time.process_time()
    with contextlib.suppress(UndeterminedError):
        multilaterate.run(multilaterate.TASK.job(settings, lengths, points, tracers if listed else None))
    return time.process_time() - before


def growth() -> float:
    """Return the time of many views over that of few, which take turns so that a busy machine slows both alike."""
    scenes = [camera_speed.scene(views, views)[0] for views in (FEW, MANY)]
    few, many = zip(*[[least(partial(camera_speed.ours, one), 1) for one in scenes] for _ in range(3)], strict=True)
    return min(many) / min(few)


def network() -> float:
    """Return the time of the published network."""
    return references.adjusted_network()[1]


def least(task: Callable[[], object], runs: int) -> float:
    """Return the least CPU seconds of several runs."""
    return camera_speed.best(task, runs)


def main() -> int:
    """Print the figures; return 1 where one is beyond its limit."""
    met = True
    for limit in limits():
        found = limit.found()
        met &= found <= limit.most
        verdict = "" if found <= limit.most else "  EXCEEDED"
        print(f"{limit.what:66} {found:9.4g} {limit.unit:2} limit {limit.most:g} {limit.unit}{verdict}", flush=True)
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
