"""The network of 115 images with terms of its camera left out, or planted into its image coordinates, to first order.

With x and y of an image point in units of the focal length, from the middle of the image: axis skew `u += f a y`,
aspect ratio `u += f a x`, thin prism `u += f a r²`, `v += f b r²`.
"""

from __future__ import annotations

import csv
import shutil
from collections.abc import Sequence
from pathlib import Path

SOURCE = Path(__file__).parents[3] / "shared" / "data" / "aicon-network"
SIZE, PIXEL, RADIUS = (8688, 5792), 35.968 / 8688, 13.488
PLANTED = {"axis-skew": 1, "aspect-ratio": 1, "thin-prism": 2}
"""Effects that are planted, with the number of their parameters"""
LEFT_OUT = {"decentring-distortion": ("p1", "p2")}
"""Ingredient of the published camera: fifty of its standard deviations. Skew and aspect ratio have none there"""
_FOCAL, _SKEW, _ASPECT = 28.78507 / PIXEL, 3.08e-5, -6.9e-5
"""As published; skew and aspect ratio are held there too"""
_JOB = """metrocli: 1
job: calibrate-camera
rig: network
inputs: {{observations: observations.csv, targets: targets.csv, scale_bars: scale_bars.csv}}
camera:
  image_size: [{size[0]}, {size[1]}]
  pixel_size: {pixel!r} mm
  reference_radius: {radius} mm
  estimate: [{estimate}]
{held}noise: estimated
output: camera.h5
"""


def job(folder: Path, without: Sequence[str] = (), change: tuple[str, Sequence[float]] | None = None) -> Path:
    """Write the job without some terms of its camera, and with a change planted."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("targets", "scale_bars"):
        shutil.copyfile(SOURCE / f"{name}.csv", folder / f"{name}.csv")
    with (SOURCE / "observations.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    with (folder / "observations.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows if change is None else [_changed(row, *change) for row in rows])
    estimate = [name for name in ("f", "cx", "cy", "k1", "k2", "p1", "p2") if name not in without]
    terms = (("aspect", _ASPECT), ("skew", _SKEW))
    held = "".join(f"  {name}: {value!r}\n" for name, value in terms if name not in without)
    text = _JOB.format(size=SIZE, pixel=PIXEL, radius=RADIUS, estimate=", ".join(estimate), held=held)
    (folder / "job.yaml").write_text(text, encoding="utf-8")
    return folder / "job.yaml"


def _changed(row: dict[str, str], name: str, sizes: Sequence[float]) -> dict[str, str]:
    u, v = float(row["u_px"]), float(row["v_px"])
    x, y = ((value - (size - 1) / 2) / _FOCAL for value, size in zip((u, v), SIZE, strict=True))
    r2 = x * x + y * y
    shapes = {"axis-skew": (y, 0.0), "aspect-ratio": (x, 0.0), "thin-prism": (r2, r2)}
    by_u, by_v = shapes[name]
    return row | {"u_px": repr(u + _FOCAL * sizes[0] * by_u), "v_px": repr(v + _FOCAL * sizes[-1] * by_v)}
