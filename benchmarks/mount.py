"""A mount whose encoders nobody reads, by points of a network: honesty, and an antenna beside its published place.

    python -m benchmarks mount [RUNS]     # 40 simulated mounts unless given; z and coverage of what the table mount has
    python -m benchmarks mount antenna    # 195 places of targets on a 12 m antenna, from its network to its axes

The antenna is the survey of ../shared/data/antenna-tie. The names of its targets hold the run (W and X turn about the
standing axis, Y and Z about the lying one), the position in tens of degrees or degrees, and the number of the target.
"""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np
import numpy.typing as npt

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from simulated import mount as sim

from metrocli.cli.commands import run
from metrocli.formats.hdf5 import read

SURVEY = Path(__file__).parents[2] / "shared" / "data" / "antenna-tie"
AZIMUTH = {"Y": 312, "Z": 222}
"""Where the standing axis was about [deg], while the lying one turned"""
NEAR = np.array([42580.0, -44260.0, 16630.0])
"""The mount, to some mm"""


def found_in(folder: Path) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return the row of the table mount, and its standard uncertainties."""
    table = read(folder / "mount.h5")[0].tables["mount"]
    value = table.stacked(("x", "y", "z", "offset", "angle"))[0]
    return value, table.stacked(("sx", "sy", "sz", "s_offset", "s_angle"))[0]


def honesty(runs: int) -> int:
    """Print how large errors are in units of their stated uncertainty."""
    scores = []
    for seed in range(runs):
        with tempfile.TemporaryDirectory() as name:
            folder, rng = Path(name), np.random.default_rng(960_000 + seed)
            mount = sim.drawn(rng)
            job = sim.write(folder, mount, rng)
            run(["adjust-network", "--quiet", str(folder / "network.yaml")])
            run(["calibrate-machine", "--quiet", str(job)])
            value, std = found_in(folder)
            scores.append((value - [*mount.invariant, mount.offset, np.pi / 2 + mount.tilt]) / std)
    z = np.array(scores)
    for name, own in zip(("x", "y", "z", "offset", "angle"), z.T, strict=True):
        print(f"{name:7s} z rms {np.sqrt((own**2).mean()):.2f}  within 1.96: {np.mean(np.abs(own) < 1.96):.0%}")
    print(f"all     z rms {np.sqrt((z**2).mean()):.2f}  within 1.96: {np.mean(np.abs(z) < 1.96):.1%} of {z.size}")
    return 0


def targets_of(network: Path) -> list[str]:
    """Write the targets of the antenna with what their names say; return rough places of these on the mount."""
    table = read(network)[0].tables["points"]
    rows, rough = ["point,run,c_deg,a_deg,tool"], dict[str, list[npt.NDArray[np.float64]]]()
    for name, place in zip(table.texts("point"), table.stacked("xyz"), strict=True):
        if len(name) == 4 and name[:2].isdigit() and name[2] in "WXYZ":
            angle, arc = int(name[:2]), name[2]
            c, a = (10 * angle, 0) if arc in "WX" else (AZIMUTH[arc], angle)
            target = ("H" if arc in "WX" else "D") + name[3]
            rows.append(f"{name},{arc},{c},{a},{target}")
            turn = sim.about(2, -np.radians(c)) @ sim.about(0, np.radians(a))
            rough.setdefault(target, []).append(turn.T @ (place - NEAR))
    (network.parent / "targets.csv").write_text("\n".join(rows) + "\n")
    means = ((name, np.mean(places, axis=0)) for name, places in sorted(rough.items()))
    return [f"{name},tool,{x:.0f},{y:.0f},{z:.0f}," for name, (x, y, z) in means]


def antenna() -> int:
    """Print the invariant point of the antenna beside the published one."""
    if not SURVEY.is_dir():
        print(f"the survey is not there: {SURVEY}")
        return 1
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file in SURVEY.iterdir():
            shutil.copy(file, folder)
        published = str(folder / "job-as-published.yaml")
        run(["adjust-network", "--quiet", published, "--output", str(folder / "network.h5")])
        listed = ["reflector,on,x_mm,y_mm,z_mm,sigma_mm", *targets_of(folder / "network.h5")]
        (folder / "reflectors.csv").write_text("\n".join(listed) + "\n")
        job = sim.JOB.format(positions="estimated").replace(
            "0 mm, 0 mm, 0 mm], positions", "0 mm, 0 mm, 0 mm], sense: -1, positions", 1
        )
        (folder / "mount.yaml").write_text(job)
        code = run(["calibrate-machine", str(folder / "mount.yaml")])
        value, std = found_in(folder)
    reference = np.array(json.loads((SURVEY / "reference.json").read_text())["invariant_points_phase3"]["WARK12M"])
    for axis, own, spread, theirs in zip("xyz", value, std, reference, strict=False):
        print(f"{axis}  {own:12.3f} +- {spread:.2f} mm   published {theirs:12.3f}   difference {own - theirs:+.3f}")
    print(
        f"offset of the axes {value[3]:.2f} +- {std[3]:.2f} mm, angle 90 deg {(value[4] - np.pi / 2) * 206265:+.0f}"
        f" +- {std[4] * 206265:.0f} arcsec"
    )
    return code


def main(arguments: list[str]) -> int:
    """Run what is asked for."""
    return antenna() if arguments == ["antenna"] else honesty(int(arguments[0]) if arguments else 40)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
