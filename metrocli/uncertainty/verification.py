"""A result compared with independent measurements of points or lengths: deviations, their uncertainty, and E_n."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace

import numpy as np

from metrocli.arrays import Array
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.result import Result
from metrocli.table import Columns, Table, columns
from metrocli.uncertainty import predicted
from metrocli.uncertainty.calibrated_machine import has_machine
from metrocli.uncertainty.numbers import COVERAGE, effective, factor
from metrocli.uncertainty.predicted import PredictedPlaces
from metrocli.units import find_unit
from metrocli.units.parsing import Range, range_of
from metrocli.words import counted

_ROUNDING = 1e-9
"""Share of the largest eigenvalue of a covariance below which others are rounding, and rounding of coordinates [mm]"""
_FLAT = 1e-6
"""Points whose spread across a line is below this share of their length lie on it"""
_ENOUGH = 4
"""Fewest measurements that can show a shift of all of them"""
_MENDED = 0.1
"""Share of the largest deviation that a mistake in all measurements leaves, at most, once it is mended"""

_SIGMA = Range(0.0, range_of("length").high)
_SPREAD = columns("sigma? [length]", allowed=_SIGMA)
COMMANDED = Columns(
    (
        *columns("point [text]", "x y z [length]", "a? b? c? [angle]", "mx my mz [length]"),
        *_SPREAD,
        *columns("tool? [text]"),
    ),
    ("point",),
    "commanded points, and where an independent instrument measured them",
)
MEASURED = Columns((*columns("point [text]", "x y z [length]"), *_SPREAD), ("point",), "points measured independently")
LENGTHS = Columns(
    (*columns("from to [text]"), *columns("length sigma [length]", allowed=_SIGMA)),
    ("from", "to"),
    "lengths between points of the result",
)


@dataclass(frozen=True)
class Deviation:
    """One independent measurement against the prediction, in mm."""

    name: str
    """The point; both ends of a length"""
    value: float
    """Measured minus predicted length; for a point the length of `vector`"""
    expanded: float
    """U: how large the deviation in its direction may be, with 95.45 % probability"""
    en: float
    k: float = COVERAGE[0]
    """Coverage factor of U"""
    vector: tuple[float, ...] = ()
    """Measured minus predicted coordinates of a point, in the frame of the result"""


@dataclass(frozen=True)
class Verification:
    """All deviations of a result from independent measurements."""

    deviations: tuple[Deviation, ...]
    laid: bool = False
    """Whether points were laid onto the prediction"""
    mistake: str = ""
    """What all measurements have in common that the prediction contradicts, empty if nothing explains most of it"""

    @property
    def mean(self) -> float:
        """Mean of the deviations: with sign for lengths, mean distance for points [mm]."""
        return float(np.mean(self._values))

    @property
    def rms(self) -> float:
        """Root mean square of the deviations [mm]."""
        return float(np.sqrt(np.mean(self._values**2)))

    @property
    def largest(self) -> float:
        """Largest absolute deviation [mm]."""
        return float(np.abs(self._values).max())

    @property
    def inside(self) -> float:
        """Share of the deviations within their expanded uncertainty, 0 to 1."""
        return float(np.mean([deviation.en <= 1.0 for deviation in self.deviations]))

    @property
    def max_en(self) -> float:
        """Largest E_n."""
        return max(deviation.en for deviation in self.deviations)

    @property
    def largest_k(self) -> float:
        """Largest coverage factor of all U, as a multiple of that for infinitely many degrees of freedom."""
        return max(deviation.k / COVERAGE[max(len(deviation.vector), 1) - 1] for deviation in self.deviations)

    @property
    def _values(self) -> Array:
        return np.array([deviation.value for deviation in self.deviations])


def columns_for(result: Result, header: Collection[str]) -> Columns:
    """Return what a file with this header is read as; raises InputError if the result predicts nothing like it."""
    lengths = bool({"from", "to"} & set(header))
    if predicted.has_points(result):
        return LENGTHS if lengths else MEASURED
    if not has_machine(result):
        raise InputError(
            f"this result of {result.kind} predicts neither points nor a machine's errors, so nothing can be held "
            "against it. Verify takes results of calibrate-machine, and those with a table of points and its "
            "covariance: multilaterate, calibrate-camera with `rig: network`, align-part with `inputs: points`"
        )
    if lengths:
        raise InputError(
            "a result of calibrate-machine has no named points, so it predicts no length between them: give commanded "
            "and measured points, point,x_mm,y_mm,z_mm,mx_mm,my_mm,mz_mm"
        )
    return COMMANDED


def verify(result: Result, check: Table, aligned: bool = False) -> Verification:
    """Return the deviations of measurements, read by `columns_for`, from what a result predicts.

    Points are laid onto the prediction by the shift and turn of least squares, unless they are `aligned` with it or the
    result is in the frame of a machine.
    Raises InputError for rows without a prediction, and for points that are too few to be laid.
    """
    if not len(check):
        raise InputError([check.fault("the file has no rows", "give at least one measurement")])
    dof = result.degrees_of_freedom()
    if "length" in check:
        first, second = predicted.listed(result, check, ("from", "to"))
        verification = Verification(_lengths(check, first, second, dof))
        return replace(verification, mistake=_shifted_lengths(verification))
    if "mx" in check:
        places, measured = predicted.reached(result, check), check.stacked(("mx", "my", "mz"))
    else:
        (places,), measured = predicted.listed(result, check, ("point",)), check.stacked(("x", "y", "z"))
    read = measured
    own = places.own + (check.numbers("sigma", 0.0) ** 2)[:, None, None] * np.eye(3)
    # a part that was laid onto the prediction has lost six motions, and their covariance with them
    laid = not (aligned or predicted.in_machine(result))
    left = predicted.after_fit if laid else _as_it_is
    if laid:
        measured = _laid(check, measured, places.values)
    covariance, predicted_part = left(places, own), left(places, places.own)
    traces = (np.trace(matrix, axis1=1, axis2=2) for matrix in (predicted_part, covariance))
    deviations = _points(check.texts("point"), measured - places.values, covariance, effective(dof, *traces))
    verification = Verification(deviations, laid)
    tools = predicted.tool_vectors(result, check) if "mx" in check else np.zeros_like(read)
    return replace(
        verification, mistake=_without_tool(verification, check, read, places.values, tools) or _shifted(verification)
    )


def _explained(verification: Verification, left: Array) -> bool:
    """Return whether deviations too large are small beside what they are once a mistake is mended, left (n, ...)."""
    many = len(verification.deviations) >= _ENOUGH and verification.max_en > 1.0
    return many and float(np.abs(left).max()) < _MENDED * verification.largest


def _without_tool(verification: Verification, check: Table, measured: Array, onto: Array, tools: Array) -> str:
    """Return the sentence about measured points that are without the vectors of their tools (n, 3), or nothing."""
    without = onto - tools
    left = np.linalg.norm((_laid(check, measured, without) if verification.laid else measured) - without, axis=1)
    if not _explained(verification, left):
        return ""
    return (
        "the measured points leave out the vector of the tool, which the prediction contains (x + T + d): without it "
        f"the largest deviation would be {_um(left.max())}; measure at the tool's point, or add T to mx, my, mz"
    )


def _shifted(verification: Verification) -> str:
    """Return the sentence about points that are all off by one vector, or nothing."""
    vectors = np.array([deviation.vector for deviation in verification.deviations])
    shift = vectors.mean(axis=0)
    left = np.linalg.norm(vectors - shift, axis=1)
    if not _explained(verification, left):
        return ""
    place = ", ".join(f"{value:.4g}" for value in shift)
    return (
        f"all points are off by one vector, ({place}) mm, {np.linalg.norm(shift):.4g} mm long: without it the largest "
        f"deviation would be {_um(left.max())}; the frames are shifted, or the length of the tool or a reflector is "
        "left out"
    )


def _shifted_lengths(verification: Verification) -> str:
    """Return the sentence about lengths that are all off by one constant, or nothing."""
    values = np.array([deviation.value for deviation in verification.deviations])
    left = values - values.mean()
    if not _explained(verification, left):
        return ""
    return (
        f"all lengths are off by {values.mean():.4g} mm: without it the largest deviation would be "
        f"{_um(np.abs(left).max())}; a constant of the instrument, or the diameter of a ball, is left out"
    )


def _um(length: float) -> str:
    return f"{find_unit('um', 'length').outside(length):.3g} um"


def _laid(check: Table, measured: Array, onto: Array) -> Array:
    """Return measured points (n, 3) after the shift and turn that bring them nearest to others."""
    for points in (measured, onto):
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        if len(points) < 3 or spread[1] <= _FLAT * spread[0]:
            reason = counted(len(points), "point") if len(points) < 3 else "the points lie on one line, which"
            hint = "expected three points off one line; `--aligned` takes points in the frame of the result"
            raise InputError([check.fault(f"{reason} cannot be laid onto the prediction", hint)])
    return poses.apply(poses.fit_pose(measured, onto), measured)


def _as_it_is(places: PredictedPlaces, own: Array) -> Array:
    """Return the covariance of each deviation in the frame of the result, (n, 3, 3)."""
    return np.asarray(places.common @ places.core @ np.swapaxes(places.common, 1, 2) + own)


def _points(names: list[str], vectors: Array, covariance: Array, dof: Array) -> tuple[Deviation, ...]:
    """Return the deviations of points: `E_n^2 = v' Q^+ v / k^2` with k by rank and dof of Q, and `U = |v| / E_n`.

    A part of v in a direction without uncertainty, beyond rounding, gives an infinite E_n and U = 0.
    """
    values, axes = np.linalg.eigh(covariance)
    kept = values > np.maximum(_ROUNDING * values[:, -1:], 0.0)
    parts = np.einsum("nia,ni->na", axes, vectors)
    k = factor(kept.sum(axis=1), dof)
    scores = np.where(kept, parts, 0.0) / np.sqrt(np.where(kept, values, 1.0))
    en = np.linalg.norm(scores, axis=1) / k
    en[np.linalg.norm(np.where(kept, 0.0, parts), axis=1) > _ROUNDING] = np.inf
    sizes = np.linalg.norm(vectors, axis=1)
    widest = k * np.sqrt(np.maximum(values[:, -1], 0.0))
    # a deviation of 0 has no direction: then U is that of the widest one
    expanded = np.where(en > 0, sizes / np.where(en > 0, en, 1.0), widest)
    rows = zip(names, sizes.tolist(), expanded.tolist(), en.tolist(), k.tolist(), vectors.tolist(), strict=True)
    return tuple(Deviation(name, size, big, row, by, tuple(vector)) for name, size, big, row, by, vector in rows)


def _lengths(check: Table, first: PredictedPlaces, second: PredictedPlaces, dof: float) -> tuple[Deviation, ...]:
    """Return the deviations of lengths, `U = k sqrt(e' (Q_aa + Q_bb - Q_ab - Q_ba) e + sigma^2)`, e the direction."""
    ends = list(zip(check.texts("from"), check.texts("to"), strict=True))
    same = [row for row, (begin, end) in enumerate(ends) if begin == end]
    if same:
        raise InputError(check.faults_at(same, lambda row: f"the length is from '{ends[row][0]}' to itself"))
    away = second.values - first.values
    length = np.linalg.norm(away, axis=1)
    along = away / np.where(length > 0, length, 1.0)[:, None]
    shared = np.einsum("ni,nik->nk", along, second.common - first.common)
    variance = np.einsum("nk,kl,nl->n", shared, first.core, shared)
    variance += np.einsum("ni,nij,nj->n", along, first.own + second.own, along)
    variance = np.maximum(variance, 0.0)
    whole = variance + check.numbers("sigma") ** 2
    k = factor(1, effective(dof, variance, whole))
    expanded = k * np.sqrt(whole)
    deviation = check.numbers("length") - length
    without = np.where(np.abs(deviation) > _ROUNDING, np.inf, 0.0)
    en = np.where(expanded > 0, np.abs(deviation) / np.where(expanded > 0, expanded, 1.0), without)
    rows = zip(ends, deviation.tolist(), expanded.tolist(), en.tolist(), k.tolist(), strict=True)
    return tuple(Deviation(f"{begin} - {end}", *figures) for (begin, end), *figures in rows)
