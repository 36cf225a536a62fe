"""One board seen by four cameras: each must find the same stretch and bend of it, within the uncertainties it states.

    python -m benchmarks one_board

The images come with the source of Pose2Sim 0.9.8 (BSD 3-Clause) in the package index: seven of each camera, of a board
held by hand, 1088 x 1920 pixels. Nothing is known of the board but its squares of 60 mm, so the four cameras are the
only witnesses, and they share no image. `stretched-targets` and `target-plane-bend` are estimated with `noise:
structured`. The z are the differences of each camera from the weighted mean, relative to their uncertainty. A stretch
stays; a bend may not, since the board is held by hand.
"""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import numpy as np

from benchmarks.bars import Number
from benchmarks.fetched import Images

IMAGES = Images(
    "pose2sim",
    "pose2sim-0.9.8.tar.gz",
    "1785fd249192d039a111ab93ceeee9f41c475589b1f213605044779856e43a7f",
    "Pose2Sim/Demo_SinglePerson/calibration/intrinsics",
)
CAMERAS = ("cam01", "cam02", "cam03", "cam04")
JOB = """metrocli: 1
job: calibrate-camera
rig: board
inputs: {{images: "{camera}_*.jpg"}}
pattern: {{type: chessboard, columns: 7, rows: 4, pitch: 60 mm}}
noise: structured
{effects}output: {camera}.h5
"""
BAND = {"least": 0.45, "most": 1.55}
"""95 % band of the root mean square of six numbers of variance 1"""
EFFECTS = "effects:\n- name: stretched-targets\n- name: target-plane-bend\n"


def _ran(*arguments: str) -> dict[str, Any]:
    """Return what a command prints as JSON."""
    call = [sys.executable, "-m", "metrocli", *arguments, "--json"]
    done = subprocess.run(call, check=True, capture_output=True, text=True, cwd=IMAGES.folder)
    answer: dict[str, Any] = json.loads(done.stdout)
    return answer


def main() -> int:
    """Calibrate and diagnose each camera; print what each finds of the board, and how well they agree."""
    try:
        IMAGES.fetch()
    except OSError as error:
        print(f"skipped: the images cannot be fetched ({error})")
        return 0
    found = list[dict[str, Any]]()
    for camera in CAMERAS:
        (IMAGES.folder / f"{camera}.yaml").write_text(JOB.format(camera=camera, effects=""))
        (IMAGES.folder / f"{camera}-board.yaml").write_text(JOB.format(camera=camera, effects=EFFECTS))
        report = _ran("diagnose", f"{camera}.yaml", "--out", f"{camera}-extended.yaml")
        named = [entry["name"] for entry in report["effects"]]
        masked = [entry["name"] for error in report["processes"] for entry in error["instead_of"]]
        print(f"{camera}: {report['verdict']}; names: {', '.join(named) or 'none'}", end="; ")
        print(f"named without what varies smoothly: {', '.join(dict.fromkeys(masked)) or 'none'}")
        found.append(_ran("calibrate-camera", f"{camera}-board.yaml", "--force")["estimates"])
    for effect, bars in (("stretched-targets", BAND), ("target-plane-bend", {})):
        squares, freedoms = 0.0, 0
        for name in (key for key in found[0] if key.startswith(effect)):
            values, stds = (np.array([one[name][what] for one in found]) for what in ("value", "std"))
            weights = stds**-2.0
            mean = float(weights @ values / weights.sum())
            squares += float((((values - mean) / stds) ** 2).sum())
            freedoms += len(values) - 1
            each = ", ".join(f"{value:.2g} \u00b1 {std:.1g}" for value, std in zip(values, stds, strict=True))
            print(f"{name} {found[0][name]['unit']}: {each}; mean {mean:.3g} \u00b1 {weights.sum() ** -0.5:.1g}")
        print(Number(f"{effect} by four cameras: z rms", str(freedoms), float(np.sqrt(squares / freedoms)), **bars))
    return 0


if __name__ == "__main__":
    sys.exit(main())
