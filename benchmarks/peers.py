"""Beside other programs: the same work in turn, A B A B, with the ratio of the times and the agreement of the values.

    python -m benchmarks peers            # all works, five times each; writes docs/benchmarks.md (make bench-peers)
    python -m benchmarks peers quick      # the smaller ones, twice each (make bench-quick)
    python -m benchmarks peers cameras    # those of one module of benchmarks/beside; the other rows of the page stay

Each program runs in a process of its own, on one thread, those from PyPI in an environment of their own in build/peers.
CPU seconds count, without the start of the interpreter except where a whole command runs. A program
that is not there is named and skipped. The ratio is that of the medians, with the smallest and the largest of the runs'
own. Values agree within some of our standard uncertainties where they have one, or within some relative difference.
"""

from __future__ import annotations

import json
import os
import platform
import statistics
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from benchmarks.beside.environments import environment_of, python_of, version_of

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "benchmarks.md"
MARK, TRUTH = "<!-- peers -->", "<!-- truth -->"
"""What stands before the tables of the page, which `peers` and `truth` write"""
RUNS, FEW = 5, 2
PATIENCE_S = 600


@dataclass(frozen=True)
class Pair:
    """One piece of work, by metrocli and by another program."""

    work: str
    """In words; what both do"""
    module: str
    ours: str
    peer: str
    size: int
    package: str
    """Name of the peer, and on PyPI if it is installed"""
    bar: float = float("inf")
    """Largest ratio that is promised"""
    installed: bool = False
    """Whether the peer has an environment of its own"""
    quick: bool = True


CAMERA = "camera, {} views of 100 points: ours with all covariances"
PAIRS = (
    Pair("end gauge of JCGM 101, 9.5, 1,000,000 trials", "end_gauge", "ours", "numpy", 10**6, "numpy", 1.25),
    Pair("the same", "end_gauge", "ours", "suncal", 10**6, "suncal", 1 / 6, installed=True),
    Pair("end gauge, law of propagation", "end_gauge", "ours_propagated", "gtc", 1, "GTC", installed=True),
    Pair(CAMERA.format(100), "cameras", "ours", "opencv", 100, "opencv-python-headless", 1.0),
    Pair(CAMERA.format(200), "cameras", "ours", "opencv", 200, "opencv-python-headless", 0.8),
    Pair(CAMERA.format(500), "cameras", "ours", "opencv", 500, "opencv-python-headless", 0.8, quick=False),
    Pair(CAMERA.format(1000), "cameras", "ours", "opencv", 1000, "opencv-python-headless", 0.8, quick=False),
    Pair(
        "fisheye, 100 views of 100 points: the same", "cameras", "ours_fisheye", "opencv_fisheye", 100,
        "opencv-python-headless", 1.0,
    ),
    Pair("splined lens, 100 views of 100 points: whole commands", "splined", "ours", "mrcal", 100, "mrcal", 1.0),
    Pair(
        "13 real images of a board, whole command; peer: SB finder", "boards", "ours", "opencv_sb", 13,
        "opencv-python-headless", 1.0,
    ),
    Pair("the same; peer: older finder", "boards", "ours", "opencv", 13, "opencv-python-headless", quick=False),
    Pair(
        "20 drawn images of 5 megapixels; peer: SB finder", "boards", "ours", "opencv_sb", 20,
        "opencv-python-headless", 1.0, quick=False,
    ),
    Pair("lengths, 1,000 points x 4, adjustment", "lengths", "engine", "scipy", 1000, "scipy"),
    Pair("the same, 100,000 x 4", "lengths", "engine", "ceres", 100_000, "Ceres", quick=False),
    Pair(
        "the same, ours a whole command from text with all covariances", "lengths", "ours", "ceres", 100_000, "Ceres",
        0.8, quick=False,
    ),
    Pair(
        "trackers, 200 points x 6 stations; peer: dense, from memory", "stations", "ours", "dense", 200, "numpy", 0.1,
        quick=False,
    ),
    Pair("run of 50 jobs with nothing to do", "idle", "ours", "make", 50, "make", 30.0),
    Pair("the same, 500 jobs", "idle", "ours", "make", 500, "make", 30.0, quick=False),
    Pair("the same, 500 jobs", "idle", "ours", "doit", 500, "doit", quick=False),
    Pair("the same, 50 jobs", "idle", "ours", "snakemake", 50, "snakemake", quick=False),
    Pair("the same, 50 jobs", "idle", "ours", "dvc", 50, "dvc", quick=False),
)  # fmt: skip


@dataclass(frozen=True)
class Row:
    """What was measured of a pair."""

    pair: Pair
    ours: Sequence[float]
    """CPU seconds of each run"""
    peer: Sequence[float]
    agreement: str
    version: str
    absent: str = ""
    """Why the peer did not run"""

    @property
    def ratio(self) -> float:
        """Our median time in that of the peer."""
        return statistics.median(self.ours) / max(statistics.median(self.peer), 1e-9)

    @property
    def met(self) -> bool:
        """Whether the ratio is what is promised."""
        return bool(self.absent) or self.ratio <= self.pair.bar

    @property
    def cells(self) -> tuple[str, ...]:
        """What stands in the table."""
        name = f"{self.pair.package} {self.version}".strip()
        if self.absent:
            return self.pair.work, f"{statistics.median(self.ours):.3g} s", name, "skipped", self.absent, ""
        each = [a / max(b, 1e-9) for a, b in zip(self.ours, self.peer, strict=True)]
        bar = "" if self.pair.bar == float("inf") else f"{self.pair.bar:.2g}{'' if self.met else ' NOT MET'}"
        times = f"{statistics.median(self.ours):.3g} s", f"{name}: {statistics.median(self.peer):.3g} s"
        return self.pair.work, *times, f"{self.ratio:.2g} ({min(each):.2g} to {max(each):.2g})", bar, self.agreement


def once(python: str, module: str, function: str, size: int) -> dict[str, Any]:
    """Return what one run of a function takes and gives; raises RuntimeError with the reason if it cannot run."""
    call = [python, "-m", "benchmarks.beside.work", module, function, str(size)]
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    environment = {**os.environ, **threads, "PYTHONPATH": str(ROOT)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # programs are compiled once, as pip does
    try:
        done = subprocess.run(
            call, check=False, capture_output=True, text=True, env=environment, cwd=ROOT, timeout=PATIENCE_S
        )
    except subprocess.TimeoutExpired:
        raise RuntimeError(f"takes more than {PATIENCE_S} s") from None
    if done.returncode:
        raise RuntimeError(next(reversed(done.stderr.strip().splitlines()), "fails without a word"))
    return dict(json.loads(done.stdout.splitlines()[-1]))


def measured(pair: Pair, runs: int) -> Row:
    """Run both in turn."""
    python = python_of(pair.package) if pair.installed else None
    ours, peer, agreement = [], [], ""
    for _ in range(runs):
        mine = once(sys.executable, pair.module, pair.ours, pair.size)
        ours.append(float(mine["seconds"]))
        if pair.installed and python is None:
            return Row(pair, ours, (), "", "", "cannot be installed here")
        try:
            other = once(str(python or sys.executable), pair.module, pair.peer, pair.size)
        except RuntimeError as error:
            return Row(pair, ours, (), "", _version(pair, python), str(error))
        peer.append(float(other["seconds"]))
        agreement = agreement_of(mine["values"], other["values"])
    return Row(pair, ours, peer, agreement, _version(pair, python))


def _version(pair: Pair, python: Path | None) -> str:
    """Return the version of the peer: after the runs, of which the first may have installed it."""
    named = pair.package in ("make", "Ceres", "mrcal")
    return "" if named else version_of(pair.package, python or environment_of(pair.package))


def agreement_of(ours: Sequence[Sequence[float]], peer: Sequence[Sequence[float]]) -> str:
    """Return the largest difference, in words."""
    both = [(a, b, max(u, v)) for (a, u), (b, v) in zip(ours, peer, strict=False)]
    with_u = [abs(a - b) / u for a, b, u in both if u]
    without = [abs(a - b) / max(abs(b), 1e-300) for a, b, u in both if not u]
    words = [f"{max(with_u):.1g} u"] if with_u else []
    return ", ".join([*words, *([f"{max(without):.0e} relative"] if without else [])])


def table(rows: Sequence[Row], page: str = "") -> Iterator[str]:
    """Yield the lines of a table in Markdown: a row that was not measured is that of the page, if it has one."""
    yield "| work | metrocli | other program | ratio (smallest to largest) | bar | largest difference |"
    yield "|---|---|---|---|---|---|"
    measured = {row.pair: f"| {' | '.join(row.cells)} |" for row in rows}
    lines = [(line, line.split("|")) for line in page.splitlines() if line.startswith("| ")]
    for pair in PAIRS:
        old = (line for line, cells in lines if cells[1].strip() == pair.work and pair.package in cells[3])
        yield from [line for line in (measured.get(pair) or next(old, ""),) if line]


def machine() -> str:
    """Return on what it was measured, in words."""
    names = (line.partition(":")[2].strip() for line in _lines("/proc/cpuinfo") if line.startswith("model name"))
    return f"{next(names, platform.processor() or 'unknown processor')}, {os.cpu_count()} cores, {platform.platform()}"


def _lines(path: str) -> list[str]:
    return Path(path).read_text(encoding="utf-8").splitlines() if Path(path).is_file() else []


def main(arguments: list[str]) -> int:
    """Print the table, write the page after all works; return 1 where a bar is not met."""
    quick, modules = "quick" in arguments, [one for one in arguments if one != "quick"]
    pairs = [one for one in PAIRS if (not quick or one.quick) and (not modules or one.module in modules)]
    rows = []
    for pair in pairs:
        rows.append(measured(pair, FEW if quick else RUNS))
        print(" | ".join(rows[-1].cells), flush=True)
    if not quick:
        about = [
            "",
            f"Measured until {datetime.now(UTC):%Y-%m-%d} by `make bench-peers`, five runs in turn, CPU seconds:",
        ]
        about += [f"{machine()}, Python {platform.python_version()}, numpy {version_of('numpy')}.", ""]
        head, _, rest = PAGE.read_text(encoding="utf-8").partition(MARK)
        truth = TRUTH + rest.partition(TRUTH)[2]
        PAGE.write_text(
            "\n".join([head + MARK, *about, *table(rows, rest.partition(TRUTH)[0]), "", truth]), encoding="utf-8"
        )
    return int(not all(row.met for row in rows))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
