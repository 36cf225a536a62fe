"""A camera from the files of real images of a chessboard: the corners are found, and the camera calibrated.

The images are those of ../shared/data/opencv-chessboards, which are not part of the project. The values are focal
lengths and principal point (k1 k2 p1 p2 k3 are estimated too), and the root mean square of the residuals [px].
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.beside.work import Values, Work

DATA = Path(__file__).parents[3] / "shared" / "data" / "opencv-chessboards"
COLUMNS, ROWS, PITCH = 9, 6, 25.0
JOB = f"""metrocli: 1
job: calibrate-camera
rig: board
inputs: {{images: "{DATA}/left*.jpg"}}
pattern: {{type: chessboard, columns: {COLUMNS}, rows: {ROWS}, pitch: {PITCH:g} mm}}
camera: {{image_size: [640, 480], estimate: [fx, fy, cx, cy, k1, k2, p1, p2, k3]}}
noise: estimated
output: camera.h5
"""


def ours(_: int) -> Work:
    """`metrocli calibrate-camera` from the files to the result, start of the program included."""
    from metrocli.formats import hdf5

    folder = Path(tempfile.mkdtemp())
    (folder / "job.yaml").write_text(JOB)

    def run() -> Values:
        call = [sys.executable, "-m", "metrocli", "calibrate-camera", str(folder / "job.yaml"), "--quiet", "--force"]
        subprocess.run(call, check=True, capture_output=True)
        found = hdf5.read(folder / "camera.h5")[0]
        names, values = found.tables["camera"].texts("parameter"), found.tables["camera"].numbers("value")
        stds = found.tables["camera"].numbers("std")
        own = [(float(values[names.index(one)]), float(stds[names.index(one)])) for one in ("fx", "fy", "cx", "cy")]
        return [*own, (float(found.statistics["rms"]["px"]), 0.0)]

    return run


def opencv_sb(_: int) -> Work:
    """OpenCV's finder of sectors (SB), and its calibration; start of Python included."""
    return lambda: _in_own_process("sectors")


def opencv(_: int) -> Work:
    """OpenCV's older finder with cornerSubPix, and its calibration; start of Python included."""
    return lambda: _in_own_process("older")


def _in_own_process(finder: str) -> Values:
    call = [sys.executable, "-m", "benchmarks.beside.boards", finder]
    done = subprocess.run(call, check=True, capture_output=True, cwd=Path(__file__).parents[2])
    return [(value, 0.0) for value in json.loads(done.stdout)]


def main(finder: str) -> None:
    """Print focal lengths, principal point and root mean square of OpenCV's calibration with one of its finders."""
    import cv2

    cv2.setNumThreads(1)
    grid = np.stack(np.meshgrid(np.arange(COLUMNS) * PITCH, np.arange(ROWS) * PITCH), axis=-1).reshape(-1, 2)
    board = np.column_stack([grid, np.zeros(len(grid))]).astype(np.float32)
    found = []
    for path in sorted(DATA.glob("left*.jpg")):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if image is None:
            continue
        if finder == "sectors":
            seen, corners = cv2.findChessboardCornersSB(image, (COLUMNS, ROWS))
        else:
            seen, corners = cv2.findChessboardCorners(image, (COLUMNS, ROWS))
            if seen:
                corners = cv2.cornerSubPix(image, corners, (5, 5), (-1, -1), (3, 100, 1e-4))
        found += [corners] if seen else []
    rms, matrix, *_ = cv2.calibrateCamera([board] * len(found), found, (640, 480), None, None)
    # the root mean square of a point has both coordinates
    print(json.dumps([*(float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2))), float(rms) / 2**0.5]))


if __name__ == "__main__":
    main(sys.argv[1])
