"""Each of several cameras calibrated alone: why it must not be used.

Poses and a noise that follows the residuals take up what a lens lacks, with several cameras as with one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from metrocli.adjust.clusters.robust import FROM_RESIDUALS
from metrocli.adjust.solution import Solution
from metrocli.errors import InputError, UndeterminedError
from metrocli.tasks.calibrate_camera.doubts import principal_point, unmodelled, why_not
from metrocli.tasks.calibrate_camera.multi_camera.system import CameraSystem
from metrocli.tasks.calibrate_camera.other_lenses import fisheye_instead
from metrocli.tasks.calibrate_camera.problem import CameraProblem
from metrocli.tasks.calibrate_camera.settings import Settings
from metrocli.tasks.calibrate_camera.shape.spline import with_shape
from metrocli.tasks.shared.images.adjustment import AdjustedImages, Options, adjust_images
from metrocli.tasks.shared.images.exposures import IMAGE
from metrocli.tasks.shared.images.settings import SPLINE
from metrocli.tasks.shared.images.tables import root_mean_square


def doubts(
    system: CameraSystem, settings: Settings, adjusted: AdjustedImages, folded: Mapping[str, str]
) -> Iterator[str]:
    """Yield why cameras must not be used; `folded` has those whose lens model folds over as all readings have it.

    Effects of a job are those of all cameras: what one of them alone leaves is then no reason against it.
    """
    told = False
    for name, problem in () if system.effects else _problems(system, settings):
        options = Options(settings.outliers == "remove", settings.noise in FROM_RESIDUALS, problem.image_size)
        try:
            alone = adjust_images(problem.blocks, problem.images, problem.others, problem.datum, options)
        except (UndeterminedError, InputError):
            continue  # the readings of all cameras determine it
        if alone.solution.outcome.good:
            folds = [folded[name]] if name in folded else []
            found = why_not(problem, system.cameras[name], alone, principal_point(problem, alone), folds)
            yield from (f"{name}: {line}" for line in found)
            told = told or bool(found)
    if told:
        return
    yield from (f"{name}: {line}" for name, line in folded.items())
    size = max((system.size(name) for name in system.cameras), key=max)
    yield from unmodelled(adjusted, adjusted.group.observations.index[IMAGE], size)


def fisheyes(system: CameraSystem, settings: Settings, solution: Solution) -> list[str]:
    """Return the cameras that the model fisheye fits far better than an adjustment that did not converge."""
    off = root_mean_square(system.images.residuals({**system.blocks, **solution.blocks}))
    each = ((name, fisheye_instead(one, system.cameras[name], off)) for name, one in _problems(system, settings))
    return [f"{name}: {line}" for name, lines in each for line in lines]


def pinholes(system: CameraSystem) -> Iterator[tuple[str, CameraProblem]]:
    """Yield the calibration of each camera alone, but of those whose lens has a shape of its own."""
    yield from ((name, one) for name, one in system.alone.items() if system.cameras[name].model != SPLINE)


def _problems(system: CameraSystem, settings: Settings) -> Iterator[tuple[str, CameraProblem]]:
    for name, one in system.alone.items():
        spline = system.cameras[name].model == SPLINE
        yield name, with_shape(one, settings.noise not in FROM_RESIDUALS) if spline else one
