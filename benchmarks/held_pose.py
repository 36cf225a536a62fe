"""The pose of a casting that its minimum holds: stated uncertainties against fits to points drawn anew.

The casting is that of the sample raw-part, with the joint covariance of its photogrammetry. Each draw is fitted whole,
with the minimum everywhere, by SLSQP and formulas of its own (benchmarks/apart). The scatter is the root mean square
about the reported pose. Beside it stands that of fits without a minimum, which is another question.

    python -m benchmarks held_pose [DRAWS] [MINIMUM ...]
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.apart.model import Array
from benchmarks.apart.part import Casting
from benchmarks.apart.samples import stated

DRAWS, MINIMA = 300, (0.5, 1.47)
"""Minima of the overstock [mm]: far from the least one, and close to it"""
MICRO = np.array([1e3, 1e3, 1e3, 1e6, 1e6, 1e6])
"""From mm and rad to um and urad"""
NAMES = ("x", "y", "z", "alpha", "beta", "gamma")


def metrocli(folder: Path, *words: str) -> str:
    """Return what a command prints in a folder."""
    run = [sys.executable, "-m", "metrocli", *words]
    return subprocess.run(run, cwd=folder, check=True, capture_output=True, text=True).stdout


def printed(title: str, values: Array) -> None:
    """Print a row of six numbers."""
    print(f"  {title:32}" + "".join(f"{value:8.2f}" for value in values))


def one_minimum(place: Path, minimum: float, draws: int) -> None:
    """Print stated and simulated standard uncertainties of the pose for one minimum."""
    file = f"results/held-{minimum:g}.h5"
    words = ("fit-part", "jobs/fit.yaml", "--set", f"overstock.minimum={minimum} mm", "--output", file, "--json")
    facts = json.loads(metrocli(place, *words))["statistics"]
    one = Casting(place, place / file)
    rng = np.random.default_rng(1)
    held, free, short = [], [], 0.0
    for _ in range(draws):
        places = one.drawn(rng)
        held.append(one.held(places, minimum) - one.pose)
        free.append(one.fitted(places) - one.pose)
        short = max(short, minimum - float(one.overstock_at(one.pose + held[-1], places).min()))
    off = MICRO * np.abs(one.held(one.places, minimum) - one.pose)
    claimed = MICRO * np.array([row["std"] for row in stated(place / file, "parameters")])
    print(
        f"minimum {minimum:g} mm, least overstock {facts['least_overstock']:.4f} mm, {facts['active']:g} points hold it"
    )
    print("  [um, urad]" + " " * 22 + "".join(f"{name:>8}" for name in NAMES))
    printed("stated", claimed)
    printed(f"{draws} fits with the minimum", MICRO * np.sqrt((np.array(held) ** 2).mean(axis=0)))
    printed("the same without it", MICRO * np.sqrt((np.array(free) ** 2).mean(axis=0)))
    print(
        f"  reported pose off that of SLSQP: at most {off.max():.4f} um, urad; least overstock missed: {short:.1e} mm"
    )


def main(words: list[str]) -> None:
    """Print the table for each minimum."""
    draws = int(words[0]) if words else DRAWS
    with TemporaryDirectory() as folder:
        metrocli(Path(folder), "init", "raw-part", "--sample", "raw-part")
        place = Path(folder) / "raw-part"
        metrocli(place, "calibrate-camera", "jobs/photogrammetry.yaml")
        for minimum in map(float, words[1:] or MINIMA):
            one_minimum(place, minimum, draws)


if __name__ == "__main__":
    main(sys.argv[1:])
