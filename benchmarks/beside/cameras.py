"""A camera from views of a board of 100 points: focal length and principal point, in pixels.

Each program calibrates a camera of FEW views first, so that modules and code are loaded when its time counts.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.beside.work import Values, Work

Array = npt.NDArray[np.float64]

FEW = 20
FISHEYE = {"f": 1500.0, "cx": 1230.0, "cy": 1015.0, "k1": 0.04, "k2": -0.01, "k3": 0.004, "k4": -0.001}


def ours(views: int) -> Work:
    """metrocli, with the full covariance, redundancy numbers and w-tests of every reading."""
    return _loaded(_ours, views)


def _ours(views: int) -> Work:
    from benchmarks.camera_speed import SIZE, TRUTH, scene
    from metrocli.tasks.calibrate_camera.settings import CameraSettings

    return _calibrated(scene(views, views)[0], CameraSettings(image_size=SIZE, estimate=tuple(TRUTH)))


def ours_fisheye(views: int) -> Work:
    """The same of a fisheye (equidistant, k1 to k4)."""
    return _loaded(_ours_fisheye, views)


def _ours_fisheye(views: int) -> Work:
    from benchmarks.camera_speed import SIZE, scene
    from metrocli.tasks.calibrate_camera.settings import CameraSettings

    estimate = ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")
    camera = CameraSettings(model="fisheye", image_size=SIZE, estimate=estimate)
    return _calibrated(scene(views, views, equidistant)[0], camera)


def _loaded(work_of: Callable[[int], Work], views: int) -> Work:
    work_of(FEW)()
    return work_of(views)


def _calibrated(sighted: Any, camera: Any) -> Work:
    from metrocli.tasks.calibrate_camera.build import build
    from metrocli.tasks.shared.images.adjustment import Options, adjust_images

    def run() -> Values:
        problem = build("board", camera, sighted)
        adjusted = adjust_images(problem.blocks, problem.images, problem.others, None, Options(started=True))
        adjusted.known_residuals()
        adjusted.solution.std("view")
        values, stds = adjusted.solution.blocks["lens"].values[0, :4], adjusted.solution.std("lens")[0, :4]
        return [*zip(values.tolist(), stds.tolist(), strict=True)]

    return run


def equidistant(x: Array, y: Array) -> tuple[object, object]:
    """Return the image of points by a true fisheye: `theta (1 + k1 theta^2 + ...)` along the direction of (x, y)."""
    r = np.hypot(x, y)
    theta = np.arctan(r)
    series = sum((FISHEYE[f"k{i}"] * theta ** (2 * i) for i in range(1, 5)), np.ones_like(theta))
    grown = FISHEYE["f"] * theta * series / np.maximum(r, 1e-300)
    return FISHEYE["cx"] + grown * x, FISHEYE["cy"] + grown * y


def opencv(views: int) -> Work:
    """OpenCV, without covariance."""
    return _loaded(_opencv, views)


def _opencv(views: int) -> Work:
    import cv2

    from benchmarks.camera_speed import SIZE, scene

    cv2.setNumThreads(1)
    objects, images = _listed(*scene(views, views), views)

    def run() -> Values:
        matrix = cv2.calibrateCamera(objects, images, SIZE, None, None)[1]
        return [(float(matrix[at]), 0.0) for at in ((0, 0), (1, 1), (0, 2), (1, 2))]

    return run


def opencv_fisheye(views: int) -> Work:
    """OpenCV's calibration of a fisheye, without covariance."""
    return _loaded(_opencv_fisheye, views)


def _opencv_fisheye(views: int) -> Work:
    import cv2

    from benchmarks.camera_speed import SIZE, scene

    cv2.setNumThreads(1)
    objects, images = _listed(*scene(views, views, equidistant), views)
    flags = cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW
    objects, images = ([one.reshape(1, -1, each) for one in part] for part, each in ((objects, 3), (images, 2)))

    def run() -> Values:
        end = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-12)
        matrix = cv2.fisheye.calibrate(objects, images, SIZE, None, None, flags=flags, criteria=end)[1]
        return [(float(matrix[at]), 0.0) for at in ((0, 0), (1, 1), (0, 2), (1, 2))]

    return run


def _listed(sighted: Any, targets: Any, views: int) -> tuple[list[Any], list[Any]]:
    """Return the points of the board and of the images, view by view, as OpenCV takes them."""
    images = [part.astype(np.float32) for part in np.split(sighted.observations.readings.T, views)]
    return [targets.points.astype(np.float32)] * views, images
