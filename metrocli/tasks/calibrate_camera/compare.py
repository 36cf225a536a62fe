"""Comparison of lens models: RMS of all and of held-out images, F test, and change of the camera's pose."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from metrocli.adjust.adjustment import StoppingRule, adjust
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.instruments import camera
from metrocli.instruments.lenses.conventions import projection_range
from metrocli.instruments.lenses.distortion import DISTORTION, PRISM, RATIONAL, TILT
from metrocli.table import Table
from metrocli.tasks.calibrate_camera.problem import CameraProblem
from metrocli.tasks.calibrate_camera.shape.found import link_of
from metrocli.tasks.calibrate_camera.shape.spline import with_shape
from metrocli.tasks.shared.images.tables import root_mean_square
from metrocli.units import find_unit

LADDER: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("pinhole", ()),
    ("k1", ("k1",)),
    ("k1 k2", ("k1", "k2")),
    ("k1 k2 p1 p2", ("k1", "k2", "p1", "p2")),
    ("k1 k2 k3 p1 p2", ("k1", "k2", "k3", "p1", "p2")),
    ("rational", ("k1", "k2", "k3", *RATIONAL, "p1", "p2")),
    ("rational + prism", ("k1", "k2", "k3", *RATIONAL, "p1", "p2", *PRISM)),
)
"""Each model contains the one before it."""
FISHEYES: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("fisheye k1", ("k1",)),
    ("fisheye k1 k2", ("k1", "k2")),
    ("fisheye k1 k2 k3 k4", ("k1", "k2", "k3", "k4")),
    ("fisheye k1 k2 k3 k4 p1 p2", ("k1", "k2", "k3", "k4", "p1", "p2")),
)
"""Likewise"""
DIVISIONS: tuple[tuple[str, tuple[str, ...]], ...] = (("division k4", ("k4",)), ("division k4 k5 k6", RATIONAL))
BACKWARDS = tuple((f"backward {name}", terms) for name, terms in LADDER[1:5])
"""Likewise, each with the correction at the measured point"""
LADDERS = {"forward": (LADDER,), "fisheye": (FISHEYES,), "backward": (DIVISIONS, BACKWARDS)}
"""Ladders of each convention"""
_TILTED = "k1 k2 k3 p1 p2"
"""Model to which the tilt of the sensor is added; no other one contains it"""
_ALL_FOLDS, _FOLDS = 20, 10
"""Up to 20 images are held out one by one; more are held out in 10 folds"""
_STEPS = 100
"""Iteration limit of a model, which starts at the one before it, and of a fold, which starts at that of all images: if
either needs more, the readings do not determine the model"""
_LOST = 2.0
"""Held-out RMS [px] above which the lens model is useless for measurement"""


@dataclass(frozen=True)
class FittedLens:
    """A fitted lens model with its residuals in all and in held-out images."""

    name: str
    problem: CameraProblem
    solution: Solution
    rms: float
    """RMS over all images [px]"""
    held: Array
    """Sum of squares and number of readings of each held-out fold, (folds, 2)"""

    @property
    def held_out(self) -> float:
        """Held-out RMS [px]; nan for a model that the readings do not determine"""
        total, count = self.held.sum(axis=0)
        return float(np.sqrt(total / count))


def compare_models(problems: Sequence[CameraProblem]) -> Table:
    """Fit the ladder of nested models of each calibration and return a row for each model.

    The simplest model whose held-out error is within one standard error of the smallest one is marked as chosen.
    """
    ladders = [list(_climb(problem, rungs)) for problem in problems for rungs in LADDERS[problem.convention]]
    fitted = [model for ladder in ladders for model in ladder]
    p_values = [p for ladder in ladders for p in (np.nan, *(_significance(a, b) for a, b in pairwise(ladder)))]
    for base in [model for model in fitted if model.name == _TILTED]:
        tilted = base.problem.with_lens(dict.fromkeys(TILT, 0.0)).with_estimate([*_estimated(base.problem), *TILT])
        fitted.append(fitted_lens(f"{_TILTED} + tilt", tilted))
        p_values.append(_significance(base, fitted[-1]))
    fitted += _splines(fitted[_chosen(fitted)])
    chosen = _chosen(fitted)
    moves = [_moved(model, fitted[chosen]) for model in fitted]
    remarks = [_remark(model, i == chosen) for i, model in enumerate(fitted)]
    return Table.of(
        {
            "model": [model.name for model in fitted],
            "unknowns": [model.solution.unknowns for model in fitted],
            "rms [px]": [model.rms for model in fitted],
            "held_out [px]": [model.held_out for model in fitted],
            "p_value": [*p_values, *[np.nan] * (len(fitted) - len(p_values))],
            "camera_moves [um]": [find_unit("um", "length").outside(move) for move, _ in moves],
            "camera_turns [arcsec]": [find_unit("arcsec", "angle").outside(turn) for _, turn in moves],
            "remark": remarks,
        }
    )


def _climb(problem: CameraProblem, ladder: Sequence[tuple[str, tuple[str, ...]]]) -> Iterator[FittedLens]:
    """Fit each model from the solution of the one before, so that the RMS never rises."""
    plain = [name for name in _estimated(problem) if name not in DISTORTION]
    # from the plainest lens upwards: a higher term of the job would start the plain models elsewhere
    here = problem.with_lens(dict.fromkeys(ladder[-1][1], 0.0))
    for name, terms in ladder:
        model = fitted_lens(name, here.with_estimate([*plain, *terms]))
        here = model.problem
        yield model


def _estimated(problem: CameraProblem) -> list[str]:
    lens = problem.blocks[camera.LENS]
    return [name for name in lens.columns if lens.free[0, lens.column(name)]]


def fitted_lens(name: str, problem: CameraProblem) -> FittedLens:
    """Return a lens model fitted to all images, and to those that are not held out.

    What the readings do not determine predicts nothing, so its images are not held out: that takes most of the time.
    """
    control = StoppingRule(limit=_STEPS)
    solution = adjust(problem.blocks.values(), [problem.images, *problem.others], problem.datum, control)
    here = problem.with_blocks({**problem.blocks, **solution.blocks})
    held = _held_out(here) if solution.outcome.good else np.full((1, 2), np.nan)
    return FittedLens(name, here, solution, root_mean_square(here.images.residuals(here.blocks)), held)


def _splines(base: FittedLens) -> list[FittedLens]:
    """Return the model with the shape of its lens, if the readings show one; its size is that of all images."""
    shaped = with_shape(base.problem, noise_known=False)
    return [] if link_of(shaped) is None else [fitted_lens(f"{base.name} + spline", shaped)]


def _held_out(problem: CameraProblem) -> Array:
    """Return the sum of squares and the number of readings of each held-out fold, (folds, 2).

    Lens and targets are estimated from the other images and then fixed. Only the poses of the held-out images are
    fitted to the fold itself. With rig cmm the place of the camera in the taper is fixed too.
    """
    views = len(problem.sighted.images)
    folds = views if views <= _ALL_FOLDS else _FOLDS
    fold_of = np.arange(views) % folds
    residuals = []
    for fold in range(folds):
        inside = fold_of == fold
        train = problem.of_images(~inside)
        fitted = adjust(
            train.blocks.values(),
            [train.images, *train.others],
            train.datum,
            StoppingRule(limit=_STEPS, covariance=False),
        ).blocks
        test = problem.of_images(inside)
        own = camera.VIEW if problem.rig != "cmm" else ""
        held = {name: block if name == own else fitted[name].fixed() for name, block in test.blocks.items()}
        posed = adjust(held.values(), [test.images], None, StoppingRule(limit=_STEPS, covariance=False)).blocks
        residual = test.images.residuals(posed)
        residuals.append([float((residual**2).sum()), test.images.observations.count])
    return np.array(residuals)


def _chosen(fitted: list[FittedLens]) -> int:
    """Return the number of the simplest model whose held-out error is within one standard error of the smallest one.

    The error is the sum of squares; the standard error is that of the difference of two models over the folds. Models
    that the readings do not determine are left out. If all are left out, the first one is returned.
    """
    sound = [i for i, model in enumerate(fitted) if model.solution.outcome.good] or [0]
    best = min(sound, key=lambda i: fitted[i].held_out)
    unknowns = [model.solution.unknowns for model in fitted]
    for i in sorted((i for i in sound if unknowns[i] < unknowns[best]), key=lambda i: unknowns[i]):
        model = fitted[i]
        excess = model.held[:, 0] - fitted[best].held[:, 0]
        if excess.sum() <= np.sqrt(len(excess)) * excess.std(ddof=1):
            return i
    return best


def _significance(simple: FittedLens, rich: FittedLens) -> float:
    """Return the probability that chance alone lowers the sum of squares this much (F test of nested models)."""
    from scipy.special import fdtrc

    more, dof = rich.solution.unknowns - simple.solution.unknowns, rich.solution.dof
    if dof <= 0 or rich.solution.cost <= 0:
        return float("nan")
    statistic = (simple.solution.cost - rich.solution.cost) / more / (rich.solution.cost / dof)
    return float(fdtrc(more, dof, max(statistic, 0.0)))


def _moved(model: FittedLens, reference: FittedLens) -> tuple[float, float]:
    """Return shift [mm] and rotation [rad] of the camera relative to the reference model, RMS over the images."""
    name = camera.view_name(model.problem.rig)
    here, there = (m.problem.blocks[name].values for m in (model, reference))
    if model.problem.rig == "board":
        here, there = poses.inverse(here), poses.inverse(there)
    step = poses.difference(here, there)
    return float(np.sqrt((step[:, :3] ** 2).sum(axis=1).mean())), float(np.sqrt((step[:, 3:] ** 2).sum(axis=1).mean()))


def _remark(model: FittedLens, chosen: bool) -> str:
    words = ["chosen"] if chosen else []
    if model.solution.undetermined:
        words.append("not determined by these readings")
    elif not model.solution.outcome.good:
        words.append("did not converge")
    lens, convention = model.problem.blocks[camera.LENS].named(), model.problem.convention
    fold = projection_range(lens, model.problem.image_size, convention == "fisheye")
    if convention != "backward" and fold is not None:
        words.append(f"folds over at {fold:.0f} px")
    if chosen and model.held_out > _LOST:
        words.append("no model of the ladder fits this lens")
    return ", ".join(words)
