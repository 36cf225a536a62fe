"""Measured data under `diagnose --until-clean`: each step with what was added and its held-out error.

Chessboards of OpenCV's samples (left: listed corners; right: its images, corners found here) as a pinhole job, and the
radio ranges of two drives (Plaza) without a scale. The data are not part of the project; where ../shared/data is absent
the benchmark reports it and ends.

    python -m benchmarks until_clean [left right plaza1 plaza2]
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

from metrocli.cli.diagnosis_report.loop import loop_text
from metrocli.project.job import JobOptions, load
from metrocli.project.until_clean import until_clean

DATA = Path(__file__).parents[2] / "shared" / "data"
BOARDS, DRIVES = DATA / "opencv-chessboards", DATA / "plaza-ranges"
PINHOLE = """metrocli: 1
job: calibrate-camera
rig: board
inputs: {inputs}
camera: {{image_size: [640, 480], estimate: [fx, fy, cx, cy]}}
noise: 0.15 px
output: camera.h5
"""
RANGES = """metrocli: 1
job: multilaterate
inputs: {{lengths: {drive}_lengths.csv, points: {drive}_points.csv, tracers: {drive}_tracers.csv}}
measures: absolute
noise: {{constant: 500 mm}}
outliers: remove
output: beacons.h5
"""
PATTERN = "{type: chessboard, columns: 9, rows: 6, pitch: 25 mm}"
JOBS = {
    "left": PINHOLE.format(
        inputs=f"{{observations: {BOARDS}/left.observations.csv, targets: {BOARDS}/left.targets.csv}}"
    ),
    "right": PINHOLE.format(inputs=f"{{images: {BOARDS}/right*.jpg}}\npattern: {PATTERN}"),
    **{name: RANGES.format(drive=DRIVES / name) for name in ("plaza1", "plaza2")},
}


def main(wanted: list[str]) -> int:
    """Print the table of steps of each job; return 1 if the data are absent."""
    if not BOARDS.is_dir():
        print(f"no measured data at {DATA}")
        return 1
    for name in wanted or JOBS:
        before = time.process_time()
        with tempfile.TemporaryDirectory() as folder:
            job = Path(folder) / f"{name}.yaml"
            job.write_text(JOBS[name])
            loop = until_clean(load(job, JobOptions(accept_doubtful=True)))
            table = loop_text(loop).replace(f"{folder}/", "")
        print(f"-- {name}, {time.process_time() - before:.0f} s of CPU time\n{table}\n", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
