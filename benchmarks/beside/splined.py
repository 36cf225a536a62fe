"""A splined lens from the corners of 100 points in each view, whole processes: root mean square of the residuals.

The lens is that of the works in `cameras`. metrocli estimates the size of the shape and gives all covariances; mrcal
has 11 x 8 knots and no covariance.
"""

from __future__ import annotations

import csv
import json
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.beside.environments import python_with
from benchmarks.beside.work import Values, Work

PITCH, KNOTS = 25.0, (11, 8)
PROGRAM = Path(__file__).parent / "mrcal_splines.py"


def ours(views: int) -> Work:
    """`metrocli calibrate-camera` with `model: spline`, from CSV to the result."""
    from benchmarks.camera_speed import NOISE, SIZE, TRUTH, scene

    folder, (sighted, targets) = Path(tempfile.mkdtemp()), scene(views, views)
    with (folder / "corners.csv").open("w", newline="", encoding="utf-8") as file:
        keys, uv = sighted.observations.keys, sighted.observations.readings.T.tolist()
        writer = csv.writer(file)
        writer.writerow(("image", "target", "u_px", "v_px"))
        writer.writerows((*names, *map(repr, at)) for *names, at in zip(keys["image"], keys["target"], uv, strict=True))
    with (folder / "targets.csv").open("w", newline="", encoding="utf-8") as file:
        rows = zip(targets.names, targets.points.tolist(), strict=True)
        csv.writer(file).writerows([("target", "x_mm", "y_mm", "z_mm"), *((name, *place) for name, place in rows)])
    (folder / "job.yaml").write_text(
        "metrocli: 1\njob: calibrate-camera\nrig: board\ninputs: {observations: corners.csv, targets: targets.csv}\n"
        f"camera: {{model: spline, image_size: [{SIZE[0]}, {SIZE[1]}], estimate: [{', '.join(TRUTH)}]}}\n"
        f"noise: {NOISE} px\noutput: camera.h5\n",
        encoding="utf-8",
    )

    def run() -> Values:
        call = [sys.executable, "-m", "metrocli", "calibrate-camera", str(folder / "job.yaml"), "--json", "--force"]
        found = json.loads(subprocess.run(call, check=True, capture_output=True, text=True).stdout)
        return [(found["statistics"]["rms"]["px"], 0.0)]

    return run


def mrcal(views: int) -> Work:
    """mrcal's splined model (`benchmarks/beside/mrcal_splines.py`)."""
    from benchmarks.camera_speed import SIZE, scene

    python = python_with("mrcal")
    if python is None:
        raise SystemExit("no Python of the machine has it (Debian: python3-mrcal)")
    corners = scene(views, views)[0].observations.readings.T.reshape(views, 10, 10, 2)
    work = {"size": SIZE, "pitch": PITCH, "focal": 2800.0, "corners": corners.tolist(), "knots": [KNOTS]}
    text = json.dumps({**work, "held_out": False})

    def run() -> Values:
        done = subprocess.run([str(python), str(PROGRAM)], input=text, capture_output=True, text=True, check=True)
        return [(json.loads(done.stdout)[0][0], 0.0)]

    return run
