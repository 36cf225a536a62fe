"""The result of a camera calibration: every number a metrologist asks for, in tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy.special

from metrocli.adjust.blocks import Array
from metrocli.adjust.covariance import Covariance
from metrocli.adjust.solution import Residuals, Solution, residuals_of
from metrocli.geometry import poses
from metrocli.instruments import camera
from metrocli.instruments.conventions import converted, photogrammetric, projection_range
from metrocli.instruments.lens import PIXELS, PRISM, RATIONAL
from metrocli.result import Estimate, Result, Scalar
from metrocli.table import Table
from metrocli.tasks.camera_problem import Problem
from metrocli.tasks.camera_settings import Camera
from metrocli.tasks.imaging import Adjusted, residual_table, rms_by, root_mean_square, suspect_images, suspect_readings

if TYPE_CHECKING:
    from metrocli.table import Values

KIND = "calibrate-camera"
HIGH = 0.95
"""A correlation beyond this is flagged."""
_CELLS = 10


@dataclass(frozen=True)
class Parameters:
    """The delivered parameters with their covariance."""

    names: tuple[str, ...]
    values: Array
    covariance: Array
    units: tuple[str, ...]

    @property
    def std(self) -> Array:
        """Standard uncertainties."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def correlation(self) -> Array:
        """Correlation matrix."""
        std = np.where(self.std > 0, self.std, 1.0)
        matrix: Array = self.covariance / std[:, None] / std
        return matrix


def parameters(rig: str, solution: Solution, covariance: Covariance) -> Parameters:
    """Return the estimated lens parameters and, for rig cmm, the camera in the reference frame as x y z alpha beta gamma."""
    lens = solution.blocks[camera.LENS]
    free = np.flatnonzero(lens.free[0])
    names = [lens.columns[i] for i in free]
    units = ["px" if name in PIXELS else "1" for name in names]
    values, matrix = lens.values[0, free], covariance.of(camera.LENS)[np.ix_(free, free)]
    if rig == "cmm":
        pose = solution.blocks[camera.TAPER].values[0]
        change = poses.euler_form_by_step(pose)
        cross = covariance.between(camera.LENS, camera.TAPER)[free] @ change.T
        matrix = np.block([[matrix, cross], [cross.T, change @ covariance.of(camera.TAPER) @ change.T]])
        values = np.concatenate([values, poses.euler_form(pose)])
        names += list(poses.EULER)
        units += ["mm"] * 3 + ["rad"] * 3
    return Parameters(tuple(names), values, (matrix + matrix.T) / 2, tuple(units))


def report(problem: Problem, settings: Camera, adjusted: Adjusted, title: str = "") -> Result:
    """Return the result of a solved calibration."""
    solution = adjusted.solution
    found = residuals_of(solution, adjusted.group)
    factor = solution.sigma0**2 if adjusted.noise is not None and solution.dof > 0 else 1.0
    covariance = solution.known().scaled(factor)
    p = parameters(problem.rig, solution, covariance)
    estimates = tuple(Estimate(*row) for row in zip(p.names, p.values.tolist(), p.std.tolist(), p.units, strict=True))
    views = _views(problem, solution, adjusted, found, covariance)
    arrays: dict[str, Array] = {"correlation": p.correlation}
    tables = {
        "residuals": residual_table(found, adjusted.group),
        "targets": _targets(problem, solution, adjusted, found),
        "rejected": adjusted.rejected,
        "correlations": _high_correlations(p),
        "conventions": _conventions(problem, settings, solution, covariance),
        "camera": _camera(solution, covariance),
    }
    if problem.rig != "cmm":
        tables["views"] = views
        arrays |= _view_covariances(problem, solution, covariance, p)
    if problem.rig == "network":
        tables["points"], arrays["points_covariance"] = _points(solution, adjusted, covariance)
    return Result(
        KIND, title, estimates, p.covariance, _statistics(problem, settings, solution, adjusted, found, p), tables, arrays,
        warnings=tuple(_warnings(problem, adjusted, views, p, solution)), shown=("views",) if problem.rig == "board" else (),
        notes=tuple(_notes(problem, settings, adjusted)),
    )  # fmt: skip


def basic_statistics(solution: Solution, rms: Mapping[str, float]) -> dict[str, Scalar | Mapping[str, float]]:
    """Return the statistics that every adjustment has; `rms` by unit, a reading of several components counting once."""
    return {
        "observations": solution.observations,
        "unknowns": solution.unknowns,
        "conditions": solution.conditions,
        "dof": solution.dof,
        "sigma0": solution.sigma0,
        "chi2": solution.cost,
        "p_value": solution.p_value,
        "iterations": solution.iterations,
        "rms": dict(rms),
        "outcome": solution.outcome.value,
    }


def _statistics(
    problem: Problem, settings: Camera, solution: Solution, adjusted: Adjusted, found: Residuals, p: Parameters
) -> dict[str, Scalar | Mapping[str, float]]:
    uv = adjusted.group.observations.readings
    statistics = basic_statistics(solution, {"px": root_mean_square(found.values)})
    u_rms, v_rms = np.sqrt((found.values**2).mean(axis=1)).tolist()
    w, h = problem.image_size
    cells = {(int(u), int(v)) for u, v in zip(uv[0] / w * _CELLS, uv[1] / h * _CELLS, strict=True)}
    lens = solution.blocks[camera.LENS]
    cx, cy = lens.values[0, lens.column("cx")], lens.values[0, lens.column("cy")]
    corner = max(np.hypot(cx - x, cy - y) for x in (0, w - 1) for y in (0, h - 1))
    values, _ = np.linalg.eigh(p.correlation)
    half_width = chi_interval(solution)
    statistics |= {
        "rms_u": u_rms,
        "rms_v": v_rms,
        "readings": adjusted.group.observations.count,
        "rejected": len(adjusted.rejected),
        "images": len(problem.sighted.images),
        "targets": len(np.unique(adjusted.group.observations.index[camera.TARGET])),
        "coverage_cells": len(cells) / _CELLS**2,
        "coverage_hull": _hull_area(uv) / (w * h),
        "coverage_radius": float(np.hypot(uv[0] - cx, uv[1] - cy).max() / corner),
        "sigma0_low": half_width[0],
        "sigma0_high": half_width[1],
        "condition": float(np.sqrt(values[-1] / max(values[0], 1e-300))),
        "image_width": w,
        "image_height": h,
        "pixel_size": settings.pixel_size if settings.pixel_size is not None else float("nan"),
        "rig": problem.rig,
        "convention": problem.convention,
    }
    if adjusted.noise is not None:
        return with_noise(statistics, solution, adjusted.noise)
    return statistics


def with_noise(
    statistics: dict[str, Scalar | Mapping[str, float]], solution: Solution, noise: float
) -> dict[str, Scalar | Mapping[str, float]]:
    """Return the statistics of a job whose noise was found: sigma0 is for a unit weight of 1 px, and there is no global test."""
    kept = {name: value for name, value in statistics.items() if name not in ("p_value", "sigma0_low", "sigma0_high")}
    return {**kept, "noise": noise, "sigma0": noise, "chi2": solution.dof * noise**2}


def chi_interval(solution: Solution) -> tuple[float, float]:
    """Return the interval that sigma0 falls in with 95 % if model and noise are right."""
    if solution.dof <= 0:
        return float("nan"), float("nan")
    low, high = scipy.special.chdtri(solution.dof, [0.975, 0.025])
    return float(np.sqrt(low / solution.dof)), float(np.sqrt(high / solution.dof))


def _hull_area(uv: Array) -> float:
    """Return the area of the convex hull of image points (2, n), by the monotone chain of Andrew (1979)."""
    points = np.unique(uv.T, axis=0)
    hull: list[Array] = []
    for ordered in (points, points[::-1]):
        side: list[Array] = []
        for point in ordered:
            while len(side) > 1 and _turn(side[-2], side[-1], point) <= 0:
                side.pop()
            side.append(point)
        hull += side[:-1]
    x, y = np.array(hull).T if hull else np.zeros((2, 1))
    return float(abs(np.dot(x, np.roll(y, 1)) - np.dot(y, np.roll(x, 1))) / 2)


def _turn(a: Array, b: Array, c: Array) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def _views(problem: Problem, solution: Solution, adjusted: Adjusted, found: Residuals, covariance: Covariance) -> Table:
    index = adjusted.group.observations.index["view"]
    columns: dict[str, Values] = {
        "image": np.array(problem.sighted.images),
        **rms_by(problem.sighted.images, index, found.values),
    }
    units = {"rms": "px", "largest": "px"}
    if problem.rig != "cmm":
        values = solution.blocks[camera.VIEW].values
        change = poses.euler_form_by_step(values)
        std = np.sqrt(np.einsum("vab,vbc,vac->va", change, covariance.members(camera.VIEW), change))
        for i, (name, unit) in enumerate(zip(poses.EULER, ["mm"] * 3 + ["rad"] * 3, strict=True)):
            columns[name], columns[f"s_{name}"] = poses.euler_form(values)[:, i], std[:, i]
            units |= {name: unit, f"s_{name}": unit}
    return Table(columns, units)


def _view_covariances(problem: Problem, solution: Solution, covariance: Covariance, p: Parameters) -> dict[str, Array]:
    """Return the covariance of each pose (x y z alpha beta gamma) and its covariance with the lens parameters."""
    values = solution.blocks[camera.VIEW].values
    change = poses.euler_form_by_step(values)
    each = change @ covariance.members(camera.VIEW) @ np.swapaxes(change, 1, 2)
    lens = solution.blocks[camera.LENS]
    cross = covariance.between(camera.VIEW, camera.LENS).reshape(len(values), 6, -1)[:, :, lens.free[0]]
    return {"views_covariance": each, "views_lens_covariance": change @ cross}


def _targets(problem: Problem, solution: Solution, adjusted: Adjusted, found: Residuals) -> Table:
    names = problem.sighted.targets.names
    by_target = rms_by(names, adjusted.group.observations.index[camera.TARGET], found.values)
    return Table({"target": np.array(names), **by_target}, {"rms": "px", "largest": "px"})


def _camera(solution: Solution, covariance: Covariance) -> Table:
    """Return every lens parameter of the model, estimated or not, for jobs that use the camera."""
    lens = solution.blocks[camera.LENS]
    units = ["px" if name in PIXELS else "1" for name in lens.columns]
    std = np.sqrt(np.diag(covariance.of(camera.LENS)))
    return Table({"parameter": np.array(lens.columns), "value": lens.values[0], "std": std, "unit": np.array(units)})


def _points(solution: Solution, adjusted: Adjusted, covariance: Covariance) -> tuple[Table, Array]:
    block = solution.blocks[camera.TARGET]
    each = covariance.members(camera.TARGET)
    std = np.sqrt(np.einsum("mii->mi", each))
    known = np.bincount(adjusted.group.observations.index[camera.TARGET], minlength=len(block.members)) > 0
    columns: dict[str, Values] = {"point": np.array(block.members)[known]}
    for i, name in enumerate("xyz"):
        columns[name] = block.values[known, i]
    for i, name in enumerate("xyz"):
        columns[f"s{name}"] = std[known, i]
    return Table(columns, dict.fromkeys(("x", "y", "z", "sx", "sy", "sz"), "mm")), each[known]


def _high_correlations(p: Parameters) -> Table:
    matrix = p.correlation
    first, second = np.nonzero(np.triu(np.abs(matrix) > HIGH, 1))
    names = np.array(p.names, dtype=str)
    return Table({"first": names[first], "second": names[second], "correlation": matrix[first, second]})


def _conventions(problem: Problem, settings: Camera, solution: Solution, covariance: Covariance) -> Table:
    """Return the lens in the other convention and, with the pixel size, in mm; the residual of each conversion over the image."""
    lens = solution.blocks[camera.LENS]
    values = dict(zip(lens.columns, lens.values[0].tolist(), strict=True))
    std = dict(zip(lens.columns, np.sqrt(np.diag(covariance.of(camera.LENS))).tolist(), strict=True))
    rows: list[tuple[str, str, float, float, str, float, float]] = []
    other = converted(values, problem.convention, problem.image_size)
    name_of_other = "backward" if problem.convention == "forward" else "forward"
    for name, value in values.items():
        rows.append((problem.convention, name, value, std[name], "px" if name in PIXELS else "1", 0.0, 0.0))
    for name, value in other.values.items():
        spread = std.get(name, float("nan"))
        rows.append((name_of_other, name, value, spread, "px" if name in PIXELS else "1", other.rms, other.largest))
    if settings.pixel_size is not None:
        rows += _in_mm(problem, settings, values, covariance)
    labels = ("form", "parameter", "value", "std", "unit", "residual_rms", "residual_largest")
    columns: dict[str, Values] = {
        label: np.array(column) for label, column in zip(labels, zip(*rows, strict=True), strict=True)
    }
    return Table(columns, {"residual_rms": "px", "residual_largest": "px"})


def _in_mm(
    problem: Problem, settings: Camera, values: dict[str, float], covariance: Covariance
) -> list[tuple[str, str, float, float, str, float, float]]:
    pixel = settings.pixel_size or 0.0
    w, h = problem.image_size
    rows = []
    std = dict(zip(values, np.sqrt(np.diag(covariance.of(camera.LENS))).tolist(), strict=True))
    for name, centre in (("f", 0.0), ("fx", 0.0), ("fy", 0.0), ("cx", (w - 1) / 2), ("cy", (h - 1) / 2)):
        if name in values:
            rows.append(
                (
                    f"{problem.convention}, mm",
                    f"{name} from image centre" if centre else name,
                    (values[name] - centre) * pixel,
                    std[name] * pixel,
                    "mm",
                    0.0,
                    0.0,
                )
            )
    if problem.convention == "forward" and not any(values.get(name) for name in (*RATIONAL, *PRISM)):
        r0 = settings.reference_radius if settings.reference_radius is not None else pixel * float(np.hypot(w, h)) / 3
        form = photogrammetric(values, pixel, problem.image_size, r0)
        spread = np.sqrt(np.einsum("ai,ij,aj->a", form.by_lens, covariance.of(camera.LENS), form.by_lens))
        for row in zip(form.names, form.values.tolist(), spread.tolist(), form.units, strict=True):
            rows.append((f"photogrammetric, R0 = {r0:.4g} mm", *row, 0.0, 0.0))
    return rows


def _warnings(problem: Problem, adjusted: Adjusted, views: Table, p: Parameters, solution: Solution) -> list[str]:
    lines = list(problem.sighted.warnings)
    if problem.rig != "cmm":
        lines += suspect_images(problem.sighted.images, views.numbers("rms"), views.numbers("readings"))
    lines += suspect_readings(adjusted.suspects, adjusted.group)
    table = _high_correlations(p)
    pairs = [
        f"{a}-{b} {c:+.3f}"
        for a, b, c in zip(table.texts("first"), table.texts("second"), table.numbers("correlation"), strict=True)
    ]
    if pairs:
        lines.append(f"correlations above {HIGH}: {', '.join(pairs)}")
    low, high = chi_interval(solution)
    if adjusted.noise is None and np.isfinite(solution.sigma0) and not low <= solution.sigma0 <= high:
        lines.append(noise_line(solution, low, high))
    lens = solution.blocks[camera.LENS]
    if problem.convention == "forward":
        fold = projection_range(dict(zip(lens.columns, lens.values[0].tolist(), strict=True)), problem.image_size)
        if fold is not None:
            lines.append(
                f"the lens model folds over at {fold:.0f} px from the principal point, inside the image: use fewer distortion parameters"
            )
    return lines


def noise_line(solution: Solution, low: float, high: float) -> str:
    """Return the warning that the residuals are not of the declared size."""
    word = "larger" if solution.sigma0 > high else "smaller"
    return (
        f"sigma0 = {solution.sigma0:.3f} is outside {low:.3f} ... {high:.3f}: the residuals are {word} than the declared noise says; "
        "standard uncertainties are for the declared noise (`noise: estimated` scales them)"
    )


def _notes(problem: Problem, settings: Camera, adjusted: Adjusted) -> Sequence[str]:
    lines = []
    if adjusted.noise is not None:
        lines.append(f"noise of an image coordinate found: {adjusted.noise:.4f} px; covariances are scaled by it")
    if len(adjusted.rejected):
        lines.append(
            f"{len(adjusted.rejected)} readings rejected as outliers (table 'rejected' has each with its test value)"
        )
    return lines
