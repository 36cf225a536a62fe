"""fit-part of many points on a mesh of a million triangles: CPU time and memory of the whole command.

The mesh is a block of 1500 mm x 1000 mm x 400 mm with waves of 3 mm on its faces, as binary STL.

    python -m benchmarks large_mesh [TRIANGLES] [AIM] [refused] [POINTS]

With `refused` the points lie as far inside as they otherwise do outside: three pairs of opposite faces contradict
each other, and the job is refused. POINTS is one number of points instead of several.
"""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import numpy.typing as npt

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from simulated.castings import SIZE, turn

from metrocli.tasks.fit_part.fit import EVEN, LEAST_MOTION, MOST

Array = npt.NDArray[np.float64]
UNDETERMINED = 4
"""Exit code of a refusal"""
COUNTS = (25_000, 50_000, 100_000, 200_000)
ANGLES, SHIFT = np.array([0.03, -0.02, 0.04]), np.array([20.0, -30.0, 10.0])


def waves(u: Array, v: Array) -> Array:
    """Return the height of a face at places 0 to 1 along its sides [mm]."""
    return 3 * np.sin(3 * np.pi * u) * np.sin(2 * np.pi * v)


def write_mesh(file: Path, triangles: int) -> int:
    """Write the block as binary STL; return its number of triangles."""
    cells = round(np.sqrt(triangles / 12))
    side = np.linspace(0, 1, cells + 1)
    u, v = np.meshgrid(side, side, indexing="ij")
    found = []
    for axis in range(3):
        one, other = (k for k in range(3) if k != axis)
        for end in (0, 1):
            at = np.zeros((cells + 1, cells + 1, 3))
            at[..., one], at[..., other] = u * SIZE[one], v * SIZE[other]
            at[..., axis] = end * SIZE[axis] + (2 * end - 1) * waves(u, v)
            p, q, r, s = at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]
            faces = np.concatenate([np.stack(three, axis=2).reshape(-1, 3, 3) for three in ((p, q, r), (p, r, s))])
            outward = np.cross(faces[0, 1] - faces[0, 0], faces[0, 2] - faces[0, 0])[axis] * (2 * end - 1) > 0
            found.append(faces if outward else faces[:, ::-1])
    every = np.concatenate(found)
    rows = np.zeros(len(every), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
    rows["corners"] = every
    file.write_bytes(bytes(80) + np.uint32(len(every)).tobytes() + rows.tobytes())
    return len(every)


def write_points(file: Path, n: int, side: int) -> None:
    """Write points 2 to 4 mm outside of the faces (side 1) or inside (side -1), in a frame of their own."""
    rng = np.random.default_rng(n)
    axis, end, share = rng.integers(0, 3, n), rng.integers(0, 2, n), rng.uniform(0.03, 0.97, (n, 3))
    row, others = np.arange(n), np.array([[1, 2], [0, 2], [0, 1]])[axis]
    stock = side * rng.uniform(2, 4, 6)[2 * axis + end] + rng.normal(size=n) * 0.25
    height = waves(share[row, others[:, 0]], share[row, others[:, 1]]) + stock
    places = share * SIZE
    places[row, axis] = end * SIZE[axis] + (2 * end - 1) * height
    places = places @ turn(ANGLES).T + SHIFT + rng.normal(size=(n, 3)) * 0.03
    lines = [f"P{k},{x:.4f},{y:.4f},{z:.4f}" for k, (x, y, z) in enumerate(places.tolist())]
    file.write_text("\n".join(["point,x_mm,y_mm,z_mm", *lines, ""]))


def main(triangles: int, aim: str, counts: tuple[int, ...], refused: bool) -> None:
    """Print CPU time and memory of the command for several numbers of points."""
    with TemporaryDirectory() as place:
        folder = Path(place)
        count = write_mesh(folder / "part.stl", triangles)
        job = folder / "job.yaml"
        job.write_text(
            "metrocli: 1\njob: fit-part\ninputs: {points: points.csv, nominal: part.stl}\nnoise: 0.03 mm\n"
            f"overstock: {{minimum: 0.2 mm, aim: {aim}}}\noutput: part.h5\n"
        )
        for n in counts:
            write_points(folder / "points.csv", n, -1 if refused else 1)
            command = [sys.executable, "-m", "metrocli", "fit-part", str(job), "--force", "--json"]
            started = subprocess.Popen(
                command,
                env={**os.environ, "OMP_NUM_THREADS": "1"},
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            _, status, used = os.wait4(started.pid, 0)
            assert os.waitstatus_to_exitcode(status) == (UNDETERMINED if refused else 0)
            what = "refused" if refused else f"aim {aim}"
            print(
                f"{count} triangles, {n} points, {what}: {used.ru_utime + used.ru_stime:.1f} s CPU, "
                f"{used.ru_maxrss / 1024:.0f} MB"
            )


if __name__ == "__main__":
    given = sys.argv[1:]
    numbers = [int(word) for word in given if word.isdigit()]
    aims = [word for word in given if word in (EVEN, MOST, LEAST_MOTION)]
    main(
        numbers[0] if numbers else 1_000_000,
        aims[0] if aims else EVEN,
        tuple(numbers[1:]) or COUNTS,
        "refused" in given,
    )
