"""Poses of the spindle: as commanded, and as a calibrated machine really reaches them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import field

import numpy as np

from metrocli import units
from metrocli.arrays import Array, Index
from metrocli.errors import Fault, InputError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.instruments.machine import is_angle
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.shared.images.exposures import exposure_of
from metrocli.uncertainty.calibrated_machine import digest_of, error_motion, outside
from metrocli.uncertainty.comparison import TABLES_COVARIANCE

_FLANGE = np.zeros((3, 1))
"""Tool vector of the spindle's reference point, in which the taper of the camera sits"""
_LEVER = 1e3
"""Length [mm] at which a turn of the spindle is compared with a shift"""
_ROUNDING = 1e-7
"""Share of the largest singular value below which a motion of the poses is rounding"""


@dataclass(frozen=True)
class SpindleErrors:
    """How the spindle stands off its commanded poses, `m + F z` with z ~ N(0, I): shifts [mm] and turns [rad]."""

    mean: Array
    """m (n, 6)"""
    spread: Array
    """F (n, 6, k)"""
    turn: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """K (k, errors) with z = K e: e are the errors of the machine's tables, whatever the poses"""
    digest: str = ""
    """Of the machine's tables and their covariance"""

    def drawn(self, rng: np.random.Generator) -> Array:
        """Return a motion (n, 6) with errors of the machine drawn as its result leaves them open."""
        return np.asarray(self.mean + self.spread @ rng.normal(size=self.spread.shape[2]))


@dataclass(frozen=True)
class SpindlePoses:
    """The table of commanded poses, and the calibrated machine that carries them out, if there is one."""

    commanded: Table
    machine: Result | None = None

    def rows(self, cameras: Mapping[str, str]) -> dict[str, int]:
        """Return the row of each exposure, which it names itself or by an image; `cameras` as for `exposures`.

        Raises InputError where images that were taken at once have different poses.
        """
        values, row_of, faults = self.at(np.arange(len(self.commanded))), dict[str, int](), list[Fault]()
        names = self.commanded.texts("image")
        for row, name in enumerate(names):
            first = row_of.setdefault(exposure_of(cameras, name), row)
            if (values[first] != values[row]).any():
                message = f"images '{names[first]}' and '{name}' are taken at once, and their poses differ"
                faults.append(Fault(message, self.commanded.file))
        if faults:
            raise InputError(faults)
        return row_of

    def at(self, rows: Index) -> Array:
        """Return the commanded poses (rows, 6) of some rows."""
        angles = np.stack([self.commanded.numbers(name, 0.0) for name in "abc"], axis=1)[rows]
        return poses.pose_from_euler(self.commanded.stacked("xyz")[rows], angles)

    def moved(self, rows: Index, motion: Array) -> Array:
        """Return the poses (rows, 6) of some rows of a spindle that stands off them by a motion (rows, 6)."""
        return self.at(rows) if self.machine is None else poses.moved(self.at(rows), motion)

    def motion(self, rows: Index) -> SpindleErrors:
        """Return true minus commanded poses at some rows; raises InputError where the machine's result has none.

        The displacement is that of the tool vector zero, the turn the sum of the angles of all axes.
        """
        if self.machine is None:
            return SpindleErrors(np.zeros((len(rows), 6)), np.zeros((len(rows), 6, 0)))
        self.must_be_known(rows)
        mean, by_entry = error_motion(self.machine, self.commanded.stacked("xyz")[rows].T, _FLANGE)
        spread, turn = _independent(by_entry @ _root(self.machine.arrays[TABLES_COVARIANCE]))
        return SpindleErrors(mean, spread, turn, digest_of(self.machine))

    def must_be_known(self, rows: Index) -> None:
        """Raise InputError for poses beyond the calibrated axes, and for errors that the result leaves open."""
        if self.machine is None:
            return
        faults = outside(self.machine, self.commanded, "image", rows)
        open_ones = _with_status(self.machine, "undetermined")
        if open_ones:
            message = (
                f"the machine's result does not determine {', '.join(open_ones)}: it predicts the tools that were "
                "measured, and not how the spindle turns"
            )
            hint = (
                "calibrate with three tools that are not on one line, or name in `estimate` of its job the errors "
                "without these, which then count as zero"
            )
            faults.append(Fault(message, hint=hint))
        if faults:
            raise InputError(faults)

    def warnings(self) -> Iterator[str]:
        """Yield which errors of the machine count as zero, and which of its effects are not corrected."""
        if self.machine is None:
            return
        zero = _with_status(self.machine, "not estimated")
        if zero:
            yield f"the machine's result does not estimate {', '.join(zero)}: the poses count them as zero"
        effects = [name.split("/")[1] for name in self.machine.tables if name.startswith("effects/")]
        if effects:
            yield (
                f"the machine's result has effects besides its errors: {', '.join(dict.fromkeys(effects))}; "
                "the poses are not corrected by them"
            )


def note_of(motion: SpindleErrors) -> str:
    """Return by how much the poses of a calibrated machine are corrected, in a sentence."""
    shift = float(np.linalg.norm(motion.mean[:, :3], axis=1).max())
    turn = float(np.linalg.norm(motion.mean[:, 3:], axis=1).max())
    return (
        f"the poses of the spindle are corrected by the errors of the machine, by up to {units.sized(shift, 'length')} "
        f"and {units.sized(turn, 'angle')}. The uncertainty of its error tables is in that of the part; the machine's "
        "repeatability and its errors between knots are not"
    )


def _with_status(machine: Result, status: str) -> list[str]:
    """Return the errors with a status of determination: angles first, since they turn the spindle."""
    errors = machine.tables["errors"]
    names = [name for name, error in zip(errors.texts("error"), errors.texts("status"), strict=True) if error == status]
    return sorted(names, key=lambda name: not is_angle(name))


def _root(covariance: Array) -> Array:
    """Return a matrix R (n, k) with `R R' = Q` of a covariance (n, n) that may be singular."""
    std = np.sqrt(np.diag(covariance))
    size = np.where(std > 0, std, 1.0)
    values, axes = np.linalg.eigh(covariance / np.outer(size, size))
    return np.asarray(size[:, None] * axes * np.sqrt(np.maximum(values, 0.0)))


def _independent(spread: Array) -> tuple[Array, Array]:
    """Return F (n, 6, k) of the same covariance `F F'` with as few unknowns z as its rank has, and K with z = K e."""
    flat = spread.reshape(-1, spread.shape[2])
    scale = np.tile([1.0] * 3 + [_LEVER] * 3, len(spread))
    _, singular, axes = np.linalg.svd(scale[:, None] * flat, full_matrices=False)
    kept = axes[singular > _ROUNDING * singular.max(initial=0.0)]
    return np.asarray(flat @ kept.T).reshape(len(spread), 6, -1), kept
