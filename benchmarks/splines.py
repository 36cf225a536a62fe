"""The splined lens beside mrcal's, on real boards: errors of the fit, and of images held out one by one.

    python -m benchmarks splines

Both fix the lens of the other images and fit the pose of the one that is held out. mrcal has the best of several
numbers of knots, by the error that is held out; metrocli estimates the size of the shape from the readings. Errors are
those of a corner in the plane. It needs a Python that has mrcal (Debian: python3-mrcal), and real images.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.bars import Number
from benchmarks.beside.environments import python_with
from benchmarks.real.boards import Board
from benchmarks.real.sets import BOARDS, DATA

KNOTS = ((6, 5), (8, 6), (11, 8), (16, 12))
"""Knots across and down that mrcal tries"""
TERMS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
BAR = 1.02
"""Largest held-out error, in that of mrcal"""
PROGRAM = Path(__file__).parent / "beside" / "mrcal_splines.py"


def grid(board: Board) -> tuple[np.ndarray, float] | None:
    """Return the corners (images, rows, columns, 2) and the pitch of a board that all images show whole, or None."""
    xs, ys = (np.unique(board.xyz[:, axis]) for axis in (0, 1))
    if len(board.image) != len(board.images) * len(xs) * len(ys):
        return None
    place = np.searchsorted(ys, board.xyz[:, 1]) * len(xs) + np.searchsorted(xs, board.xyz[:, 0])
    corners = np.empty((len(board.images), len(xs) * len(ys), 2))
    corners[board.image, place[board.target]] = board.uv
    return corners.reshape(len(board.images), len(ys), len(xs), 2), float(xs[1] - xs[0])


def of_mrcal(python: Path, board: Board, corners: np.ndarray, pitch: float) -> list[tuple[float, float]]:
    """Return the root mean squares of the fit and of held-out images [px] for each number of knots."""
    work = {"size": board.size, "pitch": pitch, "corners": corners.tolist(), "knots": KNOTS, "held_out": True}
    work["focal"] = float(board.size[0])
    done = subprocess.run([str(python), str(PROGRAM)], input=json.dumps(work), capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr.strip().splitlines()[-1])
    return [(fit, held) for fit, held in json.loads(done.stdout)]


def ours(board: Board, folder: Path, model: str) -> tuple[float, float]:
    """Return the root mean squares of the fit and of held-out images [px] of metrocli."""
    from metrocli.project.inputs import read_inputs
    from metrocli.project.job import load
    from metrocli.tasks.calibrate_camera import compare, task

    folder.mkdir(parents=True, exist_ok=True)
    board.written(folder / "board")
    (folder / "job.yaml").write_text(
        "metrocli: 1\njob: calibrate-camera\nrig: board\n"
        "inputs: {observations: board.observations.csv, targets: board.targets.csv}\n"
        f"camera: {{model: {model}, image_size: [{board.size[0]}, {board.size[1]}], estimate: [{', '.join(TERMS)}]}}\n"
        "noise: estimated\noutput: camera.h5\n",
        encoding="utf-8",
    )
    job = load(folder / "job.yaml")
    lens = compare.fitted_lens(model, task.prepared(task.TASK.job(job.settings, **read_inputs(job)))[1])
    return lens.rms, lens.held_out


def main() -> int:
    """Print the errors of each board; return 1 where ours are beyond the bar, 0 with the reason where none is there."""
    python = python_with("mrcal")
    if python is None or not DATA.is_dir():
        print("skipped: no Python has mrcal" if python is None else "skipped: no real images are at hand")
        return 0
    met = True
    with tempfile.TemporaryDirectory() as folder:
        for one in BOARDS:
            board = one.read(Path(folder))
            whole = grid(board)
            if whole is None:
                print(f"{one.name}: not every image shows the whole board, which mrcal needs")
                continue
            theirs = of_mrcal(python, board, *whole)
            for knots, (fit, held) in zip(KNOTS, theirs, strict=True):
                print(f"{one.name}: mrcal, {knots[0]} x {knots[1]} knots: fit {fit:.4f} px, held out {held:.4f} px")
            for model in ("opencv", "spline"):
                fit, held = ours(board, Path(folder) / one.name / model, model)
                print(f"{one.name}: metrocli, {model}: fit {fit:.4f} px, held out {held:.4f} px")
            least = min(pair[1] for pair in theirs)
            row = Number(
                f"{one.name}: held-out error in that of mrcal", f"{len(board.images)} images", held / least, most=BAR
            )
            print(row)
            met &= row.met
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
