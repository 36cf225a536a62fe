"""Each of several cameras calibrated alone: why it must not be used.

Poses and a noise that follows the residuals take up what a lens lacks, with several cameras as with one.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

from metrocli.adjust.clusters.robust import FROM_RESIDUALS
from metrocli.adjust.solution import Solution
from metrocli.errors import InputError, UndeterminedError
from metrocli.instruments import camera
from metrocli.tasks.calibrate_camera.advice import seen_from_behind, turned_too_little
from metrocli.tasks.calibrate_camera.doubts import principal_point, unmodelled, why_not
from metrocli.tasks.calibrate_camera.multi_camera.system import CameraSystem
from metrocli.tasks.calibrate_camera.multi_camera.views import views_of
from metrocli.tasks.calibrate_camera.other_lenses import fisheye_instead
from metrocli.tasks.calibrate_camera.problem import CameraProblem
from metrocli.tasks.calibrate_camera.projection_error import angle_warnings
from metrocli.tasks.calibrate_camera.settings import Settings
from metrocli.tasks.calibrate_camera.shape.spline import with_shape
from metrocli.tasks.shared.images.adjustment import AdjustedImages, Options, adjust_images
from metrocli.tasks.shared.images.exposures import IMAGE
from metrocli.tasks.shared.images.settings import SPLINE
from metrocli.tasks.shared.images.tables import root_mean_square


def doubts_and_warnings(
    system: CameraSystem, settings: Settings, adjusted: AdjustedImages, folded: Mapping[str, str]
) -> tuple[list[str], list[str]]:
    """Return why cameras must not be used, and what else their readings contradict.

    `folded` has the cameras whose lens model folds over as all readings have it. Effects of a job are those of all
    cameras: what one of them alone leaves is then no reason against it.
    """
    doubts, warnings = list[str](), list[str]()
    for name, problem in () if system.effects else _problems(system, settings):
        options = Options(settings.outliers == "remove", settings.noise in FROM_RESIDUALS, problem.image_size)
        try:
            alone = adjust_images(problem.blocks, problem.images, problem.others, problem.datum, options)
        except (UndeterminedError, InputError):
            continue  # the readings of all cameras determine it
        if alone.solution.outcome.good:
            folds, centre = [folded[name]] if name in folded else [], principal_point(problem, alone)
            doubts += (f"{name}: {line}" for line in why_not(problem, system.cameras[name], alone, centre, folds))
            warnings += (f"{name}: {line}" for line in (centre.warnings() if centre is not None else []))
    if not doubts:
        size = max((system.size(name) for name in system.cameras), key=max)
        doubts += (f"{name}: {line}" for name, line in folded.items())
        doubts += unmodelled(adjusted, adjusted.group.observations.index[IMAGE], size)
    return doubts, warnings


def view_warnings(system: CameraSystem, solution: Solution) -> Iterator[str]:
    """Yield what the views of a camera do not show, by the values and uncertainties that all readings give."""
    if system.rig != "board":
        return
    lens, std, views = solution.blocks[camera.LENS], solution.std(camera.LENS), views_of(system, solution)[0]
    unturned = list[str]()
    for number, (name, problem) in enumerate(system.alone.items()):
        own = replace(lens, values=lens.values[[number]], free=lens.free[[number]], members=("",))
        there = problem.blocks[camera.VIEW].with_values(views[system.exposed.camera == number])
        found = problem.with_blocks({**problem.blocks, camera.LENS: own, camera.VIEW: there})
        lines = angle_warnings(found, std[number]) + seen_from_behind(found)
        yield from (f"{name}: {line}" for line in lines)
        unturned += (f"{name}: {line}" for line in turned_too_little(found))
    # all see one board: a single camera that is turned separates its errors from those of lenses
    if len(unturned) == len(system.cameras):
        yield from unturned


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
