"""Time of `diagnose`: 100 points and six tracers in 0.5 s, 4,000 image coordinates in 8 s; CPU seconds.

The adjustment before it is not counted, and printed beside it. Much structure: radial distortion of 100 times the size
that is found, an effect of no table and 1 % wrong coordinates, so that the job is diagnosed again with the first.
"""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.hidden import images, lengths
from benchmarks.hidden.images import Images
from benchmarks.hidden.scenes import board_scene
from benchmarks.real.sets import BOARDS, LENS, BoardSet
from benchmarks.references import DATA, network_job
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.diagnose import diagnose
from metrocli.project.diagnosed import adjusted_job_of
from metrocli.project.job import load
from metrocli.tasks.calibrate_camera import task as calibrate_camera

LENGTHS, COORDINATES, NETWORK = 0.5, 8.0, 20.0
"""CPU seconds allowed"""
BOARDS_ALLOWED = {"sony-chess": 1.5, "left": 3.0, "left_SB": 3.0, "right": 3.0}
"""Those allowed for the boards of real images"""
FIRST = 0.2
"""Share of them for the first answer"""
SIZES = {300: 0.5, 1000: 0.5, 3000: 1.5, 10000: 3.0, 100000: 15.0}
"""Points of larger networks of six tracers, and the CPU seconds allowed for each"""
DRAWS, MOST_DRAWN = 5, 3000
"""Networks of each size of at most so many points, of which the median counts"""
GROWTH = 1.1
"""Largest exponent of the time in the number of readings"""
DRIFT = {"rate": 3e-7}
"""mm/s: a dead path that drifts by 1.1 um/h"""


def measurements() -> Iterator[tuple[str, Callable[[], AdjustedJob], float]]:
    """Yield what is diagnosed, in words, with the seconds allowed."""
    rng = np.random.default_rng(7)
    plain = lengths.measurement(rng, 100)
    yield "100 points, 6 tracers: nothing hidden", plain.adjusted, LENGTHS
    drift, _ = lengths.planted(plain, rng, "tracer-drift", 3.0)
    yield "  an effect of 3x, 2 % wrong lengths", lengths.spoilt(drift, rng, 0.02)[0].adjusted, LENGTHS
    read = images.read(board_scene(rng, 29, (10, 8)).without(("k2",)), rng)
    yield f"{read.uv.size} image coordinates of a board: nothing hidden", read.adjusted, COORDINATES
    yield "  an effect of 3x", _planted(read, rng, "axis-skew", 3.0).adjusted, COORDINATES
    much, _ = images.unknown(_planted(read, rng, "radial-distortion", 100.0), rng, "_six-lobe", 10.0)
    yield "  much structure", images.spoilt(much, rng, 0.01)[0].adjusted, COORDINATES


def real_images() -> bool:
    """Print the times of measured images that are at hand, and of their first answers; return whether all are allowed.

    A first answer may take a share of what the whole diagnosis may.
    """
    met = True
    for name, (job, allowed) in _measured().items():
        adjusted = job()
        readings = sum(group.observations.readings.size for group in adjusted.model.readings)
        for quick, most in ((True, allowed * FIRST), (False, allowed)):
            start = time.process_time()
            found = diagnose(adjusted, quick=quick)
            seconds = time.process_time() - start
            met &= seconds <= most
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
            what = f"{readings:5d} image coordinates, {name}: {'first answer' if quick else found.verdict}"
            print(f"{what:60} {seconds:6.2f} s  allowed {most:.1f} s  {memory} MB so far", flush=True)
    return met


def _measured() -> dict[str, tuple[Callable[[], AdjustedJob], float]]:
    """Return the measured images at hand, adjusted, with the CPU seconds allowed."""
    boards = [board for board in BOARDS if board.name in BOARDS_ALLOWED and board.folder.is_dir()]
    measured = {board.name: (partial(_adjusted, board), BOARDS_ALLOWED[board.name]) for board in boards}
    if (DATA / "aicon-network").is_dir():
        measured["network of 115 images"] = (lambda: calibrate_camera.diagnosed(network_job()), NETWORK)
    return measured


def _adjusted(board: BoardSet) -> AdjustedJob:
    with tempfile.TemporaryDirectory() as folder:
        return adjusted_job_of(load(board.job(Path(folder), board.read(board.folder), LENS)))


def _planted(read: Images, rng: np.random.Generator, name: str, times: float) -> Images:
    made = images.planted(read, rng, name, times)
    if made is None:
        raise RuntimeError(f"nothing of {name} shows")
    return made[0]


def sizes() -> bool:
    """Print the times of growing networks with a drift, memory and the growth; return whether all are allowed.

    A smooth error that chance makes in one network costs a further search, so of small ones several are drawn.
    """
    found, met = {}, True
    for points, allowed in SIZES.items():
        drawn = [_drifting(points, seed) for seed in range(8, 8 + (DRAWS if points <= MOST_DRAWN else 1))]
        found[points] = float(np.median([seconds for seconds, _ in drawn]))
        met &= found[points] <= allowed
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
        spent = f"{found[points]:6.1f} s  allowed {allowed:.1f} s  {memory} MB so far"
        most = f"  (median of {DRAWS}, at most {max(drawn)[0]:.1f} s)" if len(drawn) > 1 else ""
        print(f"{points:6d} points, 6 tracers: {spent}  {drawn[0][1]}{most}", flush=True)
    first, last = min(found), max(found)
    growth = float(np.log(found[last] / found[first]) / np.log(last / first))
    print(f"growth from {first} to {last} points: readings to the power of {growth:.2f}, allowed {GROWTH}")
    return met and growth <= GROWTH


def _drifting(points: int, seed: int) -> tuple[float, str]:
    """Return the CPU seconds of the diagnosis of a network with a drift, and what is named."""
    m = lengths.measurement(np.random.default_rng(seed), points)
    adjusted = replace(m, length=m.length + lengths.signature("dead-path-drift", 1, DRIFT)(m)).adjusted()
    start = time.process_time()
    found = diagnose(adjusted).findings
    return time.process_time() - start, ", ".join(str(one.effect.alternative) for one in found) or "no name"


def main() -> int:
    """Print the times; return 1 where one is beyond what is allowed."""
    met = real_images()
    met &= sizes()
    for what, job, allowed in measurements():
        start = time.process_time()
        adjusted = job()
        begun = time.process_time()
        found = diagnose(adjusted)
        seconds = time.process_time() - begun
        met &= seconds <= allowed
        names = ", ".join(str(finding.effect.alternative) for finding in found.findings) or "no name"
        printed = f"{found.verdict}: {names}; {len(found.outliers)} wrong"
        print(f"{what:52} {seconds:6.2f} s (adjusted in {begun - start:.2f} s)  allowed {allowed:.1f} s  {printed}")
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
