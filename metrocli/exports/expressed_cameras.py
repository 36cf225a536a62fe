"""Each camera of a result in the nearest lens that the models of a program can express."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from metrocli.arrays import Array
from metrocli.effects.links.lens_shape import unshifted
from metrocli.errors import InputError
from metrocli.frozen import dataclass
from metrocli.geometry import poses
from metrocli.instruments.lenses.conventions import Converted, image_grid, projection_range
from metrocli.instruments.lenses.forms import PROGRAMS, LensForm, nearest
from metrocli.instruments.lenses.lens import focal
from metrocli.instruments.lenses.stereographic import StereographicGrid, flattened
from metrocli.result import Result
from metrocli.tasks.shared.images.calibrated import StatedCamera, stated_cameras
from metrocli.units.people import two_digits


@dataclass(frozen=True)
class ExpressedCamera:
    form: LensForm
    values: dict[str, float]
    """Of the form's terms, cx and cy counted as the program does"""
    size: tuple[int, int]
    notes: tuple[str, ...] = ()
    name: str = ""
    """Of one of several cameras"""
    pose: Array | None = None
    """Its pose (6,) in the frame of the first of several; None for a single camera and for the first"""

    def file(self, single: str) -> str:
        """Return the name of its file: that of a single camera, or its own name with the same ending."""
        return f"{self.name}.{single.rpartition('.')[2]}" if self.name else single

    @property
    def from_first(self) -> tuple[Array, Array]:
        """Return R, t [mm] of `X_camera = R X_first + t`."""
        back = poses.inverse(np.zeros(6) if self.pose is None else self.pose)
        return poses.rotation_of(back), back[:3]

    @property
    def matrix(self) -> list[float]:
        fx, fy, cx, cy = self.intrinsics
        return [fx, fx * self.values.get("skew", 0.0), cx, 0.0, fy, cy, 0.0, 0.0, 1.0]

    @property
    def intrinsics(self) -> list[float]:
        """Return fx, fy, cx, cy."""
        return [self.values[name] for name in ("fx", "fy", "cx", "cy")]

    @property
    def distortion(self) -> list[float]:
        own = ("f", "fx", "fy", "cx", "cy", "skew")
        return [value for name, value in self.values.items() if name not in own]

    def commented(self, lines: Iterable[str], begin: str = "# ", end: str = "") -> str:
        """Return the text of lines behind the notes."""
        return "\n".join([*(f"{begin}note: {note}{end}" for note in self.notes), *lines, ""])


def expressed(program: str, result: Result, within: float, posed: bool = False) -> list[ExpressedCamera]:
    """Return each camera of a result in the first model of a program that holds it, else in the nearest.

    `posed` states whether the format holds where several cameras are. Raises InputError for a result that is no
    camera, and where the nearest differs by more than `within` [px].
    """
    if "camera" not in result.tables or "convention" not in result.statistics:
        raise InputError(f"a result of {result.kind} is not a camera: this format takes results of calibrate-camera")
    cameras = list[ExpressedCamera]()
    for stated in stated_cameras(result):
        try:
            camera = _of_program(program, stated, within)
        except InputError as error:
            of = f"camera {stated.name}: " if stated.name else ""
            raise InputError([replace(fault, message=of + fault.message) for fault in error.faults]) from error
        lost = (
            f"the pose of {stated.name} beside {cameras[0].name} is not in this format" if cameras and not posed else ""
        )
        cameras.append(
            replace(camera, name=stated.name, pose=stated.pose, notes=(*camera.notes, *filter(None, [lost])))
        )
    return cameras


def _of_program(program: str, stated: StatedCamera, within: float) -> ExpressedCamera:
    """Return a camera as `expressed`."""
    lens, convention, size, shape = stated.lens, stated.convention, stated.size, stated.shape
    base = partial(unshifted, shape=shape)
    forms, pixel = PROGRAMS[program].forms, PROGRAMS[program].pixel
    exact = next((form for form in forms if shape is None and form.holds(lens, convention)), None)
    notes: tuple[str, ...] = ()
    if exact is not None:
        form, values = exact, exact.of(lens)
    else:
        fitted = ((tried, nearest(lens, convention, size, tried, base)) for tried in forms)
        near = [(tried, fit) for tried, fit in fitted if fit is not None]
        if program == "mrcal" and (shape is not None or not any(fit.largest <= within for _, fit in near)):
            near += _splined(stated, within)
        form, fit = _near(near, program, within)
        values, notes = dict(fit.values), (f"{form.title} is the nearest model of {program}: {_difference(fit)}",)
    if convention != "backward" and (fold := projection_range(lens, size, convention == "fisheye")):
        notes += (f"beyond {fold:.0f} px from its principal point the lens folds over and has no direction",)
    if program == "opencv" and form.fisheye and (widest := _widest(stated)) > _OF_OPENCV:
        notes += (f"the image reaches {widest:.0f} degrees off the axis; OpenCV projects wrongly beyond 90 degrees",)
    shifted = {name: value + pixel * (name in ("cx", "cy")) for name, value in values.items()}
    return ExpressedCamera(form, shifted, size, notes)


_OF_OPENCV = 90.0
"""Angle off the axis up to which cv2.fisheye.projectPoints holds [deg]"""


def _widest(stated: StatedCamera) -> float:
    """Return the largest angle off the axis in the image [deg]."""
    x, y, z = stated.direction(np.stack(image_grid(stated.size, 21)))
    return float(np.degrees(np.nanmax(np.arctan2(np.hypot(x, y), z))))


_COLUMNS = (10, 16, 24, 36, 54, 80, 120)
"""Knots along x of the splined models of mrcal that are tried"""
_ENOUGH = 0.1
"""Share of the largest difference that is allowed, below which no more knots are tried"""
_DENSE = 201
"""Points along each axis at which a splined model is fitted"""


def _splined(stated: StatedCamera, within: float) -> list[tuple[LensForm, Converted]]:
    """Return splined models of mrcal with more and more knots; none where the lens has no direction.

    Focal lengths and principal point are those of the lens.
    """
    fx, fy = focal(stated.lens)
    centre, scale = np.array([[stated.lens["cx"]], [stated.lens["cy"]]]), np.array([[fx], [fy]])
    dense, other = (np.stack(image_grid(stated.size, n)) for n in (_DENSE, _DENSE - 70))
    at, checked = (flattened(stated.direction(uv)) for uv in (dense, other))
    if not (np.isfinite(at).all() and np.isfinite(checked).all()):
        return []
    reach, models = np.abs(at).max(axis=1), list[tuple[LensForm, Converted]]()
    for columns in _COLUMNS:
        grid = StereographicGrid(columns, columns, int(np.ceil(np.degrees(4 * np.arctan(reach[0] / 2)))) + 1)
        grid = replace(grid, rows=int(np.ceil(2 * reach[1] / grid.step)) + 3)
        shifts = grid.fitted(at, (dense - centre) / scale - at)
        gap = np.hypot(*(centre + scale * (checked + grid.shift(checked, shifts)) - other))
        values = dict(zip(("fx", "fy", "cx", "cy"), (fx, fy, stated.lens["cx"], stated.lens["cy"]), strict=True))
        values |= {f"du{knot}": value for knot, value in enumerate(shifts.ravel().tolist())}
        form = LensForm(grid.name, tuple(values), stated.convention == "fisheye")
        models.append((form, Converted(values, float(np.sqrt((gap**2).mean())), float(gap.max()))))
        if models[-1][1].largest <= _ENOUGH * within:
            break
    return models


_AS_NEAR = 1.1
"""Ratio of largest differences up to which the model with fewer parameters is taken"""


def _near(fitted: Sequence[tuple[LensForm, Converted]], program: str, within: float) -> tuple[LensForm, Converted]:
    """Return the nearest, with few parameters; raises InputError with its difference if that is above `within` [px]."""
    if not fitted:
        raise InputError(f"no model of {program} sees all that this lens sees")
    least = min(fit.largest for _, fit in fitted)
    form, fit = next(pair for pair in fitted if pair[1].largest <= _AS_NEAR * least)
    if fit.largest <= within:
        return form, fit
    raise InputError(
        f"no model of {program} is within {within:g} px of this lens; the nearest is {form.title}: {_difference(fit)}. "
        f"Allow it by e.g. --within '{two_digits(fit.largest * 1.1)} px', or calibrate with its parameters"
    )


def _difference(fit: Converted) -> str:
    return f"rms {two_digits(fit.rms)} px, largest difference {two_digits(fit.largest)} px over the image"
