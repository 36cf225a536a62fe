"""A camera from the files of real images of a chessboard: the corners are found, and the camera calibrated.

The images are those of ../shared/data/opencv-chessboards, which are not part of the project, or 20 of 5 megapixels, a
drawn board in random poses, warped by OpenCV. The values are focal lengths and principal point (k1 k2 p1 p2 k3 are
estimated too), and the root mean square of the residuals [px].
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
COLUMNS, ROWS, PITCH, REAL = 9, 6, 25.0, 13
JOB = f"""metrocli: 1
job: calibrate-camera
rig: board
inputs: {{{{images: "{{images}}"}}}}
pattern: {{{{type: chessboard, columns: {COLUMNS}, rows: {ROWS}, pitch: {PITCH:g} mm}}}}
camera: {{{{estimate: [fx, fy, cx, cy, k1, k2, p1, p2, k3]}}}}
noise: estimated
output: camera.h5
"""


LARGE, FOCAL = (2592, 1944), 2150.0


def _images(count: int) -> tuple[Path, str]:
    """Return folder and pattern of the names of images: the 13 real ones, or as many that are drawn."""
    return (DATA, "left*.jpg") if count == REAL else (_drawn(count), "*.png")


def _drawn(count: int) -> Path:
    import cv2

    folder, rng, side = Path(tempfile.mkdtemp()), np.random.default_rng(5), 120
    squares = np.indices((ROWS + 1, COLUMNS + 1)).sum(0) % 2
    board = np.pad(np.kron(squares, np.ones((side, side))) * 180 + 30, side, constant_values=210).astype(np.float32)
    scale = PITCH / side
    for number in range(count):
        turn = cv2.Rodrigues(rng.normal(0, [0.3, 0.3, 0.2]))[0]
        middle = np.array([board.shape[1], board.shape[0]]) * scale / 2
        at = np.array([*rng.uniform(-30, 30, 2), rng.uniform(330, 420)]) - turn[:, :2] @ middle
        camera = np.array([[2 * FOCAL, 0, LARGE[0]], [0, 2 * FOCAL, LARGE[1]], [0, 0, 1]])
        onto = camera @ np.column_stack([turn[:, :2] * scale, at])
        fine = cv2.warpPerspective(board, onto, (2 * LARGE[0], 2 * LARGE[1]), borderValue=210.0)
        grey = cv2.GaussianBlur(cv2.resize(fine, LARGE, interpolation=cv2.INTER_AREA), (0, 0), 0.7)
        noisy = grey + rng.normal(0, 2, grey.shape)
        cv2.imwrite(str(folder / f"i{number:02d}.png"), np.clip(noisy, 0, 255).astype(np.uint8))
    return folder


def ours(count: int) -> Work:
    """`metrocli calibrate-camera` from the files to the result, start of the program included."""
    folder, (where, names_of) = Path(tempfile.mkdtemp()), _images(count)
    (folder / "job.yaml").write_text(JOB.format(images=where / names_of))

    def run() -> Values:
        call = [sys.executable, "-m", "metrocli", "calibrate-camera", str(folder / "job.yaml"), "--json", "--force"]
        found = json.loads(subprocess.run(call, check=True, capture_output=True, text=True).stdout)
        estimates = [found["estimates"][name] for name in ("fx", "fy", "cx", "cy")]
        rms = found["statistics"]["rms"]
        return [*((one["value"], one["std"]) for one in estimates), (rms["px"], 0.0)]

    return run


def opencv_sb(count: int) -> Work:
    """OpenCV's finder of sectors (SB), and its calibration; start of Python included."""
    where, names = _images(count)
    return lambda: _in_own_process("sectors", where, names)


def opencv(count: int) -> Work:
    """OpenCV's older finder with cornerSubPix, and its calibration; start of Python included."""
    where, names = _images(count)
    return lambda: _in_own_process("older", where, names)


def _in_own_process(finder: str, where: Path, names: str) -> Values:
    call = [sys.executable, "-m", "benchmarks.beside.boards", finder, str(where), names]
    done = subprocess.run(call, check=True, capture_output=True, cwd=Path(__file__).parents[2])
    return [(value, 0.0) for value in json.loads(done.stdout)]


def main(finder: str, where: str, names: str) -> None:
    """Print focal lengths, principal point and root mean square of OpenCV's calibration with one of its finders."""
    import cv2

    cv2.setNumThreads(1)
    grid = np.stack(np.meshgrid(np.arange(COLUMNS) * PITCH, np.arange(ROWS) * PITCH), axis=-1).reshape(-1, 2)
    board = np.column_stack([grid, np.zeros(len(grid))]).astype(np.float32)
    found = []
    size = (0, 0)
    for path in sorted(Path(where).glob(names)):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        if image is None:
            continue
        size = image.shape[::-1]
        if finder == "sectors":
            seen, corners = cv2.findChessboardCornersSB(image, (COLUMNS, ROWS))
        else:
            seen, corners = cv2.findChessboardCorners(image, (COLUMNS, ROWS))
            if seen:
                corners = cv2.cornerSubPix(image, corners, (5, 5), (-1, -1), (3, 100, 1e-4))
        found += [corners] if seen else []
    rms, matrix, *_ = cv2.calibrateCamera([board] * len(found), found, size, None, None)
    # the root mean square of a point has both coordinates
    print(json.dumps([*(float(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2))), float(rms) / 2**0.5]))


if __name__ == "__main__":
    main(*sys.argv[1:])
