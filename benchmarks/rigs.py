"""Several cameras calibrated together: are the uncertainties honest, and does OpenCV find the same on the same corners?

`simulated`: z of all lenses and poses over rigs of two or three cameras, drawn by numpy alone; some images are missing,
and the last camera of every third rig is a fisheye.
`opencv`: the pose of the right camera of OpenCV's stereo images by cv2.stereoCalibrate with the same lenses.
`halves`: z between the halves of those images, with `noise: structured`, over random halvings.

`aligned`: z of a part that both cameras of a rig see, one of them, or a camera of the model spline, calibrated anew
(benchmarks/apart).

    python -m benchmarks rigs [simulated | opencv | halves | aligned] [COUNT]
"""

from __future__ import annotations

import contextlib
import io
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from benchmarks.apart import rig
from benchmarks.bars import Number
from metrocli.cli.commands import run as command
from metrocli.formats.images import read_images
from metrocli.project.job import load
from metrocli.project.runner import content
from metrocli.result import Result
from metrocli.targets.pattern import Pattern
from metrocli.tasks.calibrate_camera.task import run
from metrocli.tasks.shared.images.search import sight

Array = npt.NDArray[np.float64]
STEREO = Path(__file__).parents[2] / "shared/data/opencv-chessboards"
BOARD = np.array([[25.0 * i, 25.0 * j, 0.0] for j in range(7) for i in range(9)]) - [100, 75, 0]
SIZE, NOISE = (1280, 960), 0.1
BAR, ROUGH = 0.005, 3.0
"""Standard uncertainty of a scale bar, and by how much the list of a network is off [mm]"""
LENS = ("f", "cx", "cy", "k1", "k2", "p1", "p2")
POSE = ("x", "y", "z", "alpha", "beta", "gamma")

_JOB = """metrocli: 1
job: calibrate-camera
rig: {rig}
inputs: {{observations: obs.csv, targets: targets.csv{bars}}}
noise: {noise}
cameras:
{cameras}
output: rig.h5
"""


def solved(
    seen: Sequence[tuple[str, int, Array]],
    board: Array,
    cameras: dict[str, str],
    noise: str,
    bars: Sequence[tuple[int, int, float]] = (),
) -> Result:
    """Return the result of image points: image, number of the target, (u, v); with scale bars that of a network."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        rows = (f"{image},T{target:03d},{uv[0]:.9f},{uv[1]:.9f}" for image, target, uv in seen)
        (folder / "obs.csv").write_text("\n".join(["image,target,u_px,v_px", *rows]) + "\n")
        listed = (f"T{i:03d},{x},{y},{z}" for i, (x, y, z) in enumerate(board.tolist()))
        (folder / "targets.csv").write_text("\n".join(["target,x_mm,y_mm,z_mm", *listed]) + "\n")
        text = "\n".join(f"  {key}: {value}" for key, value in cameras.items())
        rig, more = ("network", ", scale_bars: bars.csv") if bars else ("board", "")
        far = (f"T{a:03d},T{b:03d},{length},{BAR}" for a, b, length in bars)
        (folder / "bars.csv").write_text("\n".join(["from,to,length_mm,sigma_mm", *far]) + "\n")
        (folder / "rig.yaml").write_text(_JOB.format(rig=rig, bars=more, noise=noise, cameras=text))
        return run(content(load(folder / "rig.yaml")))


def _euler(turn: Array) -> Array:
    """Return alpha, beta, gamma of `Rz(gamma) Ry(beta) Rx(alpha)`."""
    return np.asarray(Rotation.from_matrix(turn).as_euler("xyz"))


def _image(points: Array, lens: Array) -> Array:
    f, cx, cy, k1, k2, p1, p2 = lens
    x, y = points[:, 0] / points[:, 2], points[:, 1] / points[:, 2]
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2**2
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return np.stack([f * u + cx, f * v + cy], axis=1)


def _fisheye_image(points: Array, lens: Array) -> Array:
    f, cx, cy, *k = lens
    across = np.hypot(points[:, 0], points[:, 1])
    angle = np.arctan2(across, points[:, 2])
    radius = angle * (1 + sum(each * angle ** (2 * n) for n, each in enumerate(k, 1)))
    return np.asarray(f * (radius / across)[:, None] * points[:, :2] + [cx, cy])


def _lens(rng: np.random.Generator, fisheye: bool) -> Array:
    centre = np.array(SIZE) / 2 - 0.5 + rng.normal(0, 10, 2)
    if fisheye:
        return np.array([rng.uniform(550, 750), *centre, *rng.normal(0, [0.02, 0.01, 0.003, 1e-3])])
    return np.array([rng.uniform(900, 1300), *centre, rng.uniform(-0.25, 0), 0.05, *rng.normal(0, 5e-4, 2)])


def z_of_rig(number: int, network: bool = False) -> Array:
    """Return (value - truth) / std of all estimates of a simulated rig, from a board or a network of points."""
    rng = np.random.default_rng([71, number])
    count = 2 + number % 2
    names = ["left", "right", "top"][:count]
    fisheye = [not network and number % 3 == 2 and name == names[-1] for name in names]
    lenses = [_lens(rng, other) for other in fisheye]
    turns = [np.eye(3), *(Rotation.from_rotvec(rng.normal(0, 0.15, 3)).as_matrix() for _ in names[1:])]
    shifts = [np.zeros(3), *(np.array([90.0 * i, 0, 0]) + rng.normal(0, 15, 3) for i in range(1, count))]
    points = rng.uniform([-100, -100, -40], [100, 100, 40], (40, 3)) if network else BOARD
    seen = []
    for exposure in range(16):
        turn = Rotation.from_euler("zxy", [rng.uniform(-3, 3), *rng.uniform(-0.6, 0.6, 2)]).as_matrix()
        in_first = points @ turn.T + [*rng.uniform(-60, 100, 2), rng.uniform(350, 650)]
        for name, lens, own, shift, other in zip(names, lenses, turns, shifts, fisheye, strict=True):
            project = _fisheye_image if other else _image
            uv = project((in_first - shift) @ own, lens) + rng.normal(0, NOISE, (len(points), 2))
            inside = ((uv > 0) & (uv < np.array(SIZE) - 1)).all(axis=1)
            if inside.sum() >= 12 and rng.random() > 0.15:
                seen += [(f"{name}{exposure:02d}.png", int(i), uv[i]) for i in np.flatnonzero(inside)]
    size = f"image_size: [{SIZE[0]}, {SIZE[1]}]"
    models = [", model: fisheye" if other else "" for other in fisheye]
    cameras = {name: f'{{images: "{name}*.png", {size}{own}}}' for name, own in zip(names, models, strict=True)}
    bars = [(a, a + 1, float(np.linalg.norm(points[a] - points[a + 1])) + rng.normal(0, BAR)) for a in (0, 2, 4)]
    rough = points + rng.normal(0, ROUGH, points.shape) if network else points
    result = solved(seen, rough, cameras, f"{NOISE} px", bars if network else ())
    truth = {}
    for name, lens, other in zip(names, lenses, fisheye, strict=True):
        keys = (*LENS[:5], "k3", "k4") if other else LENS
        truth |= {f"{name}.{key}": value for key, value in zip(keys, lens, strict=True)}
    for name, turn, shift in zip(names[1:], turns[1:], shifts[1:], strict=True):
        truth |= {f"{name}.{key}": value for key, value in zip(POSE, [*shift, *_euler(turn)], strict=True)}
    return np.array([(one.value - truth[one.name]) / one.std for one in result.estimates])


def simulated(count: int) -> bool:
    """Print the root mean square z over simulated rigs."""
    each = [z_of_rig(number) for number in range(count)]
    lens = np.concatenate([z[: 7 * (2 + i % 2)] for i, z in enumerate(each)])
    pose = np.concatenate([z[7 * (2 + i % 2) :] for i, z in enumerate(each)])
    rms = [float(np.sqrt(np.mean(one**2))) for one in (np.concatenate(each), lens, pose)]
    print(Number("z rms of cameras fixed to each other", f"{count} rigs", rms[0], 0.95, 1.05))
    print(Number("  of their lenses", f"{count} rigs", rms[1]))
    print(Number("  of their poses", f"{count} rigs", rms[2]))
    free = float(np.sqrt(np.mean(np.concatenate([z_of_rig(number, network=True) for number in range(count)]) ** 2)))
    print(Number("z rms of cameras that see a network of points", f"{count} rigs", free, 0.95, 1.05))
    return 0.95 <= rms[0] <= 1.05 and 0.95 <= free <= 1.05


def corners() -> tuple[list[tuple[str, int, Array]], Array]:
    """Return the corners of the stereo images, and the board."""
    images = read_images(sorted(STEREO.glob("*.jpg")))
    table = sight(images, Pattern("chessboard", 9, 6, 25.0))[0]
    place = {f"r{r:02d}c{c:02d}": r * 9 + c for r in range(6) for c in range(9)}
    targets = [place[name] for name in table.texts("target")]
    board = np.array([[25.0 * c, 25.0 * r, 0.0] for r in range(6) for c in range(9)])
    return list(zip(table.texts("image"), targets, table.stacked(("u", "v")), strict=True)), board


def _stereo(seen: Sequence[tuple[str, int, Array]], board: Array, noise: str, more: Sequence[str] = ("", "")) -> Result:
    size = "image_size: [640, 480]"
    names = zip(("left", "right"), more, strict=True)
    return solved(seen, board, {name: f'{{images: "{name}*.jpg", {size}{own}}}' for name, own in names}, noise)


def _written(key: str, value: float) -> str:
    return f"{value:.15g}{' px' if key in ('f', 'cx', 'cy') else ''}"


def opencv() -> bool:
    """Print how far the pose of the right camera is from that of OpenCV, with the lenses of the joint calibration."""
    import cv2

    seen, board = corners()
    values = {one.name: one.value for one in _stereo(seen, board, "estimated").estimates}
    held = {name: {key: values[f"{name}.{key}"] for key in LENS} for name in ("left", "right")}
    more = [
        ", estimate: []" + "".join(f", {key}: {_written(key, value)}" for key, value in one.items())
        for one in held.values()
    ]
    fixed = _stereo(seen, board, "1 px", more)
    own = {one.name: one for one in fixed.estimates}
    uv = {(image, target): at for image, target, at in seen}
    shots = sorted({image[4:] for image, _, _ in seen if image.startswith("left")})
    shots = [one for one in shots if (f"left{one}", 0) in uv and (f"right{one}", 0) in uv]
    order = range(len(board))
    points = [board.astype(np.float32) for _ in shots]
    sides = [[np.array([uv[f"{side}{one}", k] for k in order], dtype=np.float32) for one in shots] for side in held]
    matrices = [np.array([[k["f"], 0, k["cx"]], [0, k["f"], k["cy"]], [0, 0, 1]]) for k in held.values()]
    lenses = [np.array([k[name] for name in LENS[3:]]) for k in held.values()]
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 500, 1e-12)
    found = cv2.stereoCalibrate(
        points, *sides, matrices[0], lenses[0], matrices[1], lenses[1], SIZE,
        flags=cv2.CALIB_FIX_INTRINSIC, criteria=criteria,
    )  # fmt: skip
    rms, turn, shift = found[0], found[5], found[6].ravel()
    theirs = [*(-turn.T @ shift), *_euler(turn.T)]
    ours = [own[f"right.{key}"] for key in POSE]
    off = max(abs(one.value - other) / one.std for one, other in zip(ours, theirs, strict=True))
    used = float(fixed.statistics["rms"]["px"])  # type: ignore[index, arg-type]
    print(f"rms {used:.7f} px here, {rms:.7f} px there")
    print(Number("stereo pose beside OpenCV's, largest difference", f"{len(shots)} pairs", off, most=0.01, unit="u"))
    return off < 0.01


def halves(count: int) -> bool:
    """Print the root mean square z between the halves of the stereo images."""
    seen, board = corners()

    def shot(image: str) -> str:
        return image.removeprefix("left").removeprefix("right")

    shots, z = sorted({shot(image) for image, _, _ in seen}), []
    for number in range(count):
        order = np.random.default_rng([72, number]).permutation(shots)
        half = [set(order[: len(order) // 2]), set(order[len(order) // 2 :])]
        results = [_stereo([row for row in seen if shot(row[0]) in mine], board, "structured") for mine in half]
        pairs = zip(*(result.estimates for result in results), strict=True)
        z.append([(a.value - b.value) / np.hypot(a.std, b.std) for a, b in pairs])
    rms = np.sqrt(np.mean(np.square(z), axis=0))
    names = [estimate.name for estimate in results[0].estimates]
    whole = Number("z rms between halves of the stereo images", f"{count} halvings", _rms(z), 0.7, 1.3)
    print(whole)
    print("  of each: " + ", ".join(f"{name} {value:.2f}" for name, value in zip(names, rms, strict=True)))
    return whole.met


def aligned(count: int) -> bool:
    """Print the root mean square z of a part, seen by two cameras, by the second of them, and by one with a spline."""
    met = []
    for names in (("left", "right"), ("right",), ("wide",)):
        z = []
        for number in range(count):
            with tempfile.TemporaryDirectory() as name:
                folder = Path(name)
                rig.write_jobs(folder, np.random.default_rng([73, number]), names)
                with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
                    jobs = (("calibrate-camera", "cam.yaml"), ("align-part", "job.yaml"))
                    codes = [command([kind, str(folder / job)]) for kind, job in jobs]
                if any(codes):
                    raise RuntimeError(f"draw {number} of {names}: exit codes {codes}")
                with h5py.File(folder / "part.h5") as file:
                    rows = file["parameters"][:]
            z.append([(row["value"] - rig.TRUTH[row["name"].decode()]) / row["std"] for row in rows])
        rms = np.sqrt(np.mean(np.square(z), axis=0))
        whole = Number(f"z rms of a part seen by {' and '.join(names)}", f"{count} draws", _rms(z), 0.95, 1.05)
        print(whole)
        print("  of each: " + ", ".join(f"{name} {value:.2f}" for name, value in zip(rig.TRUTH, rms, strict=True)))
        met.append(whole.met)
    return all(met)


def _rms(z: list[list[float]]) -> float:
    return float(np.sqrt(np.mean(np.square(z))))


def main(arguments: list[str]) -> int:
    """Run what is named, or all."""
    count = next((int(one) for one in arguments if one.isdigit()), 0)
    tests = {"simulated": lambda: simulated(count or 100), "opencv": opencv, "halves": lambda: halves(count or 20)}
    tests["aligned"] = lambda: aligned(count or 300)
    chosen = [name for name in tests if name in arguments] or list(tests)
    met = [tests[name]() for name in chosen]
    return 0 if all(met) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
