"""A camera from views of a board of 100 points: focal length and principal point, in pixels."""

from __future__ import annotations

import numpy as np

from benchmarks.beside.work import Values, Work


def ours(views: int) -> Work:
    """metrocli, with the full covariance, redundancy numbers and w-tests of every reading."""
    from benchmarks.camera_speed import SIZE, TRUTH, scene
    from metrocli.tasks.calibrate_camera.build import build
    from metrocli.tasks.calibrate_camera.settings import Camera
    from metrocli.tasks.shared.images.adjustment import Options, adjust_images

    sighted, _ = scene(views, views)

    def run() -> Values:
        problem = build("board", Camera(image_size=SIZE, estimate=tuple(TRUTH)), sighted)
        adjusted = adjust_images(problem.blocks, problem.images, problem.others, None, Options(started=True))
        adjusted.known_residuals()
        adjusted.solution.std("view")
        values, stds = adjusted.solution.blocks["lens"].values[0, :4], adjusted.solution.std("lens")[0, :4]
        return [*zip(values.tolist(), stds.tolist(), strict=True)]

    return run


def opencv(views: int) -> Work:
    """OpenCV, without covariance."""
    import cv2

    from benchmarks.camera_speed import SIZE, scene

    cv2.setNumThreads(1)
    sighted, targets = scene(views, views)
    objects = [targets.points.astype(np.float32)] * views
    images = [part.astype(np.float32) for part in np.split(sighted.observations.readings.T, views)]

    def run() -> Values:
        matrix = cv2.calibrateCamera(objects, images, SIZE, None, None)[1]
        return [(float(matrix[at]), 0.0) for at in ((0, 0), (1, 1), (0, 2), (1, 2))]

    return run
