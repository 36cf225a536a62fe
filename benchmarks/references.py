"""Measured data against what others made of them: OpenCV on chessboards, a published photogrammetric network.

The data are not part of the project; where ../shared/data is absent the benchmark reports it and ends.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.bars import Number
from metrocli.formats import csv
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.calibrate_camera import task as calibrate_camera
from metrocli.tasks.calibrate_camera.settings import SCALE_BARS, CameraSettings, Files, Inputs, Settings
from metrocli.tasks.job import Job
from metrocli.tasks.shared.images.sightings import OBSERVATIONS
from metrocli.tasks.shared.images.target_list import TARGETS

DATA = Path(__file__).parents[2] / "shared" / "data"
NOWHERE = Path("-")
SETS = {
    "chessboard, left (window 11)": ("opencv-chessboards/left", "opencv-chessboards/left.reference.json"),
    "chessboard, left (SB)": ("opencv-chessboards/left_SB", "opencv-chessboards/left_SB.reference.json"),
    "chessboard, Sony": ("sony-chess/points", "sony-chess/reference.json"),
}
ORDER = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
"""OpenCV's order"""
MODELS = {
    "pinhole": ((), "pinhole"),
    "k1": (("k1",), "k1"),
    "k1 k2": (("k1", "k2"), "k1k2"),
    "k1 k2 p1 p2": (("k1", "k2", "p1", "p2"), "k1k2p1p2"),
    "k1 k2 k3 p1 p2": (("k1", "k2", "k3", "p1", "p2"), "k1k2p1p2k3"),
}
"""Terms of a row of --compare, and the name of the model in the references"""
PIXEL, R0 = 35.968 / 8688, 13.488
PUBLISHED = {
    "c": (28.78507, 2.513e-4),
    "x0": (0.01734892, 3.442e-4),
    "y0": (0.05668731, 3.263e-4),
    "A1": (-1.096069e-4, 2.979e-8),
    "A2": (1.495660e-7, 7.656e-11),
    "B1": (5.798428e-6, 1.191e-7),
    "B2": (-8.644540e-6, 1.0439e-7),
}
"""Value and standard deviation, mm and powers of it"""
AFFINITY = (-7.00801e-5, -3.12627e-5)


def board_settings(terms: tuple[str, ...]) -> Settings:
    """Return the job of a chessboard with these terms of distortion."""
    camera = CameraSettings(image_size=(640, 480), estimate=(*ORDER[:4], *terms))
    inputs = Inputs(observations=NOWHERE, targets=NOWHERE)
    return Settings(rig="board", inputs=inputs, noise="estimated", camera=camera)


def against_opencv(title: str, stem: str, reference: str) -> None:
    """Print each model beside OpenCV's."""
    models = json.loads((DATA / reference).read_text())["models"]
    readings = csv.read(DATA / f"{stem}.observations.csv", OBSERVATIONS)
    targets = csv.read(DATA / f"{stem}.targets.csv", TARGETS)
    compared = calibrate_camera.compare(
        calibrate_camera.TASK.job(board_settings(MODELS["k1 k2 p1 p2"][0]), readings, targets)
    )
    held = dict(zip(compared.texts("model"), compared.numbers("held_out"), strict=True))
    labels = ("RMS px", "- OpenCV", "value/std", "std ratio", "held-out", "- OpenCV")
    print(f"\n{title}\n{'model':<16}" + "".join(f"{label:>11}" for label in labels))
    far = []
    for row, (terms, name) in MODELS.items():
        result = calibrate_camera.run(
            calibrate_camera.TASK.job(board_settings(terms), observations=readings, targets=targets)
        )
        own, off, rms = _beside(result, models[name], held[row])
        print(f"{row:<16}{own}")
        far.append((off, rms))
    worst = np.max(far, axis=0).tolist()
    print(Number(f"{title}: parameters beside OpenCV's", f"{len(far)} models", worst[0], most=0.01, unit="u"))
    print(Number(f"{title}: RMS beside OpenCV's", f"{len(far)} models", worst[1], most=1e-6, unit="px"))


def _beside(result: Result, theirs: dict[str, Any], held: float) -> tuple[str, float, float]:
    values = dict(zip(ORDER, [*(theirs[name] for name in ORDER[:4]), *theirs["dist"]], strict=False))
    std = dict(zip(ORDER, theirs["std_intrinsics"], strict=False))
    off = max(abs(e.value - values[e.name]) / std[e.name] for e in result.estimates)
    ratio = max((e.std / std[e.name] for e in result.estimates), key=lambda value: abs(np.log(value)))
    rms = result.statistics["rms"]
    assert isinstance(rms, dict)
    words = (
        f"{rms['px']:>11.6f}{rms['px'] - theirs['rms_px']:>11.1e}{off:>11.5f}{ratio:>11.5f}"
        f"{held:>11.4f}{held - theirs['heldout_rms_px']:>11.1e}"
    )
    return words, off, abs(rms["px"] - theirs["rms_px"])


def network_job() -> Job[Settings, Files]:
    """Return the network of 115 images."""
    folder = DATA / "aicon-network"
    g = 1 - PUBLISHED["A1"][0] * R0**2 - PUBLISHED["A2"][0] * R0**4
    camera = CameraSettings(
        image_size=(8688, 5792), pixel_size=PIXEL, reference_radius=R0, aspect=AFFINITY[0] / g, skew=-AFFINITY[1] / g
    )
    settings = Settings(
        rig="network", inputs=Inputs(observations=NOWHERE, targets=NOWHERE), noise="estimated", camera=camera
    )
    columns = {"observations": OBSERVATIONS, "targets": TARGETS, "scale_bars": SCALE_BARS}
    tables = {name: csv.read(folder / f"{name}.csv", wanted) for name, wanted in columns.items()}
    return calibrate_camera.TASK.job(settings, **tables)


def adjusted_network() -> tuple[Result, float]:
    """Return the network of 115 images, adjusted, and the CPU seconds that it took."""
    job = network_job()
    before = time.process_time()
    result = calibrate_camera.run(job)
    return result, time.process_time() - before


def network() -> None:
    """Print the network beside the published adjustment."""
    result, seconds = adjusted_network()
    found = _photogrammetric(result.tables["conventions"])
    print(f"\nnetwork of 115 images, {seconds:.1f} s CPU, s0 {float(str(result.statistics['sigma0'])) * PIXEL:.7f} mm")
    print(f"{'':<6}{'value':>16}{'published':>16}{'off / std':>11}{'std ratio':>11}")
    for name, (value, std) in PUBLISHED.items():
        ours = found[name]
        print(f"{name:<6}{ours[0]:>16.8g}{value:>16.8g}{abs(ours[0] - value) / std:>11.3f}{ours[1] / std:>11.4f}")
    off = max(abs(found[name][0] - value) / std for name, (value, std) in PUBLISHED.items())
    print(Number("network of 115 images: lens beside the published one", "7 values", off, most=0.5, unit="u"))


def _photogrammetric(table: Table) -> dict[str, tuple[float, float]]:
    rows = zip(*(table.columns[name].tolist() for name in ("form", "parameter", "value", "std")), strict=True)
    return {name: (value, std) for form, name, value, std in rows if form.startswith("photogrammetric")}


def main() -> None:
    """Print the tables."""
    if not DATA.is_dir():
        print(f"no measured data at {DATA}")
        return
    for title, (stem, reference) in SETS.items():
        against_opencv(title, stem, reference)
    network()


if __name__ == "__main__":
    main()
