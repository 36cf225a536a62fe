"""Files of jobs that no sample project has, drawn by formulas of their own."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
F, CENTRE = 690.0, np.array([325.0, 233.0])
_JOB = """metrocli: 1
job: calibrate-camera
rig: board
inputs: {observations: observations.csv, targets: targets.csv}
camera: {image_size: [640, 480], pixel_size: 6 um, estimate: [f, cx, cy, k1, k2]}
noise: 0.05 px
output: camera.h5
"""


def turned(a: float, b: float, c: float) -> Array:
    x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    return np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]]) @ y @ x


def image_points(places: Array, k1: float) -> Array:
    x = places[:, :2] / places[:, 2:]
    return np.asarray(F * x * (1 + k1 * (x**2).sum(axis=1, keepdims=True)) + CENTRE)


@cache
def board(k1: float = -0.2, distance: float = 450.0, relief: float = 0.0) -> dict[str, str]:
    """Eight tilted views of a board of 9 x 6 points, every second one turned by 90 degrees."""
    rng = np.random.default_rng(250)
    points = np.array([[25.0 * i, 25.0 * j, relief * (i * j % 4)] for j in range(6) for i in range(9)])
    names = [f"{chr(65 + j)}{i}" for j in range(6) for i in range(9)]
    lines = ["image,target,u_px,v_px"]
    for view in range(8):
        tilt = (0.45 * np.cos(view * 2.3), 0.45 * np.sin(view * 2.3), np.pi / 2 * (view % 2))
        places = (points - points.mean(axis=0)) @ turned(*tilt).T + [*rng.uniform(-25, 25, 2), distance + 25 * view]
        uv = image_points(places, k1) + rng.normal(0, 0.05, (54, 2))
        lines += [f"view{view}.png,{name},{u:.3f},{v:.3f}" for name, (u, v) in zip(names, uv.tolist(), strict=True)]
    targets = ["target,x_mm,y_mm,z_mm", *(f"{n},{x:g},{y:g},{z:g}" for n, (x, y, z) in zip(names, points, strict=True))]
    return {"job.yaml": _JOB, "observations.csv": "\n".join(lines) + "\n", "targets.csv": "\n".join(targets) + "\n"}


STATIONS = {
    "job.yaml": """metrocli: 1
job: multilaterate
inputs: {lengths: lengths.csv, points: points.csv, tracers: tracers.csv}
measures: absolute
noise: {constant: 1 mm}
output: r.h5
""",
    "points.csv": "point,x_mm,y_mm,z_mm,sigma_mm\nP,10,20,5,\n",
    "tracers.csv": "tracer,x_mm,y_mm,z_mm,sigma_mm\nA,1000,0,0,0\nB,-1000,0,0,0\nC,0,1000,0,0\nD,0,0,1000,0\nE,0,-1000,0,0\n",
    "lengths.csv": "point,tracer,length_mm\nP,A,1000.3\nP,B,999.8\nP,C,1000.1\nP,D,1000.2\nP,E,1000.4\n",
}

BUDGET = """metrocli: 1
job: report-uncertainty
quantities:
  a: {value: 100 mm, std: 1 um, dof: DOF}
  b: {value: 1, std: STD}
measurands: {y: {model: "MODEL", unit: mm}}
monte_carlo: {trials: 100000, seed: 1}
output: y.h5
"""


def budget(model: str, dof: str = "1000", std: str = "1e-6") -> str:
    return BUDGET.replace("MODEL", model).replace("DOF", dof).replace("STD", std)


def fisheye() -> dict[str, str]:
    """The board near to a lens whose image radius is f times the angle from its axis."""
    files = board(distance=130.0)
    rng = np.random.default_rng(3)
    points = np.array([[25.0 * i - 100, 25.0 * j - 62.5, 0.0] for j in range(6) for i in range(9)])
    lines = ["image,target,u_px,v_px"]
    for view in range(8):
        tilt = (0.4 * np.cos(view * 2.3), 0.4 * np.sin(view * 2.3), np.pi / 2 * (view % 2))
        places = points @ turned(*tilt).T + [*rng.uniform(-25, 25, 2), 130.0 + 10 * view]
        r = np.hypot(*places[:, :2].T)
        uv = 220 * places[:, :2] * (np.arctan2(r, places[:, 2]) / r)[:, None] + CENTRE + rng.normal(0, 0.05, (54, 2))
        lines += [f"view{view}.png,{chr(65 + k // 9)}{k % 9},{u:.3f},{v:.3f}" for k, (u, v) in enumerate(uv.tolist())]
    return {**files, "observations.csv": "\n".join(lines) + "\n"}


def two_cameras() -> dict[str, str]:
    """The board seen by two cameras at once, the second 100 mm beside the first."""
    rng = np.random.default_rng(7)
    points = np.array([[25.0 * i - 100, 25.0 * j - 62.5, 0.0] for j in range(6) for i in range(9)])
    lines = ["image,target,u_px,v_px"]
    for view in range(10):
        tilt = (0.45 * np.cos(view * 2.3), 0.45 * np.sin(view * 2.3), np.pi / 2 * (view % 2))
        places = points @ turned(*tilt).T + [*rng.uniform(-25, 25, 2), 450.0 + 25 * view]
        for side, seen in (("left", places), ("right", (places - [100.0, 0, 0]) @ turned(0, 0.2, 0))):
            uv = image_points(seen, -0.2) + rng.normal(0, 0.05, (54, 2))
            name = f"{side}{view}.png"
            lines += [f"{name},{chr(65 + k // 9)}{k % 9},{u:.3f},{v:.3f}" for k, (u, v) in enumerate(uv.tolist())]
    cameras = "".join(
        f"  {side}: {{images: {side}*.png, image_size: [640, 480], estimate: [f, cx, cy, k1]}}\n"
        for side in ("left", "right")
    )
    lens = "camera: {image_size: [640, 480], pixel_size: 6 um, estimate: [f, cx, cy, k1, k2]}\n"
    return {
        **board(),
        "observations.csv": "\n".join(lines) + "\n",
        "job.yaml": _JOB.replace(lens, f"cameras:\n{cameras}"),
    }


PART = """surfaces:
- {name: left, type: plane, point: [0 mm, 40 mm, 30 mm], normal: [-1, 0, 0]}
- {name: right, type: plane, point: [100 mm, 40 mm, 30 mm], normal: [1, 0, 0]}
- {name: front, type: plane, point: [50 mm, 0 mm, 30 mm], normal: [0, -1, 0]}
- {name: back, type: plane, point: [50 mm, 80 mm, 30 mm], normal: [0, 1, 0]}
- {name: bottom, type: plane, point: [50 mm, 40 mm, 0 mm], normal: [0, 0, -1]}
- {name: top, type: plane, point: [50 mm, 40 mm, 60 mm], normal: [0, 0, 1]}
"""


def part() -> dict[str, str]:
    """A block of 100 mm x 80 mm x 60 mm in a raw part that is 2 mm larger on each side."""
    rng, size = np.random.default_rng(4), np.array([100.0, 80.0, 60.0])
    lines, number = ["point,x_mm,y_mm,z_mm,surface,sigma_mm"], 0
    sides = (("left", "right"), ("front", "back"), ("bottom", "top"))
    for axis, names in enumerate(sides):
        for name, level in zip(names, (-2.0, size[axis] + 2.0), strict=True):
            for at in rng.uniform(0.05, 0.95, (12, 3)) * size:
                at[axis] = level + rng.normal(0, 0.02)
                number += 1
                lines.append(f"Q{number},{at[0]:.4f},{at[1]:.4f},{at[2]:.4f},{name},0.02")
    job = (
        "metrocli: 1\njob: fit-part\ninputs: {points: points.csv, nominal: part.yaml}\n"
        "overstock: {minimum: 0.5 mm, aim: even}\noutput: fit.h5\n"
    )
    files = {"job.yaml": job, "part.yaml": PART, "points.csv": "\n".join(lines) + "\n"}
    return {**files, "part.stl": box(size), "inverted.stl": box(size, -1), "cm.stl": box(size / 10)}


def box(size: Array, sense: int = 1) -> str:
    """A closed mesh, its triangles counter-clockwise seen from outside; the other way with sense -1."""
    low, high = np.zeros(3), size
    faces = []
    for axis in range(3):
        one, other = (axis + 1) % 3, (axis + 2) % 3
        for level, order in ((high, (0, 1, 2, 3)), (low, (0, 3, 2, 1))):
            corners = np.zeros((4, 3))
            corners[:, axis] = level[axis]
            corners[[1, 2], one], corners[[2, 3], other] = high[one], high[other]
            quad = corners[list(order)][::sense]
            faces += [quad[[0, 1, 2]], quad[[0, 2, 3]]]
    facet = "facet normal 0 0 0\nouter loop\n{}endloop\nendfacet\n"
    return (
        "solid box\n"
        + "".join(facet.format("".join(f"vertex {x:g} {y:g} {z:g}\n" for x, y, z in face)) for face in faces)
        + "endsolid box\n"
    )


def points_at_rest() -> dict[str, str]:
    """Points of a machine with errors of scale, measured by a tracker at rest."""
    rng = np.random.default_rng(6)
    at = np.array(np.meshgrid(*[np.linspace(0, 400, 4)] * 3, indexing="ij")).reshape(3, -1).T
    seen = (at * [1 + 2e-5, 1 - 3e-5, 1.0]) @ turned(0.1, 0.2, 0.7).T + [900.0, 300, 50] + rng.normal(0, 2e-3, at.shape)
    rows = (
        f"P{n},{x:g},{y:g},{z:g},{a:.4f},{b:.4f},{c:.4f}"
        for n, ((x, y, z), (a, b, c)) in enumerate(zip(at, seen, strict=True))
    )
    axes = ", ".join(f"{axis}: {{range: [0 mm, 400 mm], knots: 2}}" for axis in "xyz")
    job = (
        f"metrocli: 1\njob: calibrate-machine\nmethod: standstill\nmachine:\n  chain: wXbYZt\n  axes: {{{axes}}}\n"
        "  tool: [0 mm, 0 mm, 100 mm]\nestimate: [EXX, EYY]\ninputs: {points: points.csv}\n"
        "noise: {beam: 2 um, lateral: 2 um}\noutput: machine.h5\n"
    )
    return {"job.yaml": job, "points.csv": "\n".join(["point,x_mm,y_mm,z_mm,mx_mm,my_mm,mz_mm", *rows]) + "\n"}


def charuco(folder: Path) -> None:
    """Two images of a ChArUco board of 7 x 5 corners, drawn by OpenCV."""
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    drawn = cv2.aruco.CharucoBoard((8, 6), 35.0, 24.0, dictionary).generateImage((480, 360), marginSize=30)
    for number, sigma in enumerate((0.8, 1.0)):
        cv2.imwrite(str(folder / f"view{number}.png"), cv2.GaussianBlur(drawn, (0, 0), sigma))
    cv2.imwrite(str(folder / "blank.png"), np.full((360, 480), 128, np.uint8))
    pattern = "{type: charuco, columns: 7, rows: 5, pitch: 35 mm, marker_size: 24 mm, dictionary: 4x4_50}"
    job = f"metrocli: 1\njob: calibrate-camera\nrig: board\ninputs: {{images: view*.png}}\npattern: {pattern}\n"
    (folder / "job.yaml").write_text(f"{job}camera: {{estimate: [f, cx, cy]}}\nnoise: 0.1 px\noutput: camera.h5\n")


def axis_alone() -> dict[str, str]:
    """A rotary axis read by an indexer at 13 targets, five times to and fro."""
    rng = np.random.default_rng(12)
    way = np.tile(np.append(np.arange(0, 361, 30), np.arange(360, -1, -30)), 5)
    read = zip(way.tolist(), (np.sin(np.radians(way)) + 0.2 * rng.normal(size=len(way))).tolist(), strict=True)
    return {
        "job.yaml": """metrocli: 1
job: calibrate-machine
method: six-dof
machine: {axes: {c: {range: [0 deg, 360 deg], knots: 13}}}
inputs: {lines: lines.csv}
noise: {angle: 0.2 arcsec}
output: c.h5
""",
        "lines.csv": "line,axis,c_deg,ec_arcsec\n" + "".join(f"L1,c,{at},{error:.3f}\n" for at, error in read),
    }
