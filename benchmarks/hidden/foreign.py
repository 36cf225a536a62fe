"""Measurements with an error of no catalogue that is drawn at random, or with none: plain formulas and random draws."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import numpy.typing as npt

from benchmarks.hidden import grids, images, lengths, machine, scenes
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.effects.acting import measured
from metrocli.effects.effect import Effect
from metrocli.effects.own.columns import with_variables
from metrocli.effects.requested import RequestedEffect
from metrocli.expressions.dimensions import compound
from metrocli.tasks import KINDS

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]
NOTHING = "nothing"
STRENGTH = (12.0, 24.0)
"""Norm of what the unknowns leave of an error, in standard deviations: twice what is just found and more"""
_POINTS = 60


class Measured(Protocol):
    """Readings that can be adjusted as a user's job."""

    def adjusted(self, effects: Sequence[RequestedEffect] = ()) -> AdjustedJob:
        """Return the job with some effects in its model."""


@dataclass(frozen=True)
class Planted:
    """A measurement with an error of no catalogue, or with none."""

    kind: str
    measured: Measured
    form: str
    correct: Measured
    """The same readings without the error"""
    variables: frozenset[str] = frozenset()
    where: tuple[tuple[str, str], ...] = ()
    strength: float = 0.0
    column: int | None = None
    """Seed of a further column of random numbers; None for none"""

    def job(self, effects: Sequence[RequestedEffect] = (), own: Sequence[Effect] = ()) -> AdjustedJob:
        """Return it as `diagnose` takes it, with some effects in its model; `own` are defined beside the catalogue."""
        found = self.measured.adjusted(effects)
        found = replace(found, places=KINDS[self.kind].task().places, effects=(*found.effects, *own))
        return found if self.column is None else _with_column(found, np.random.default_rng(self.column))


def _with_column(job: AdjustedJob, rng: np.random.Generator) -> AdjustedJob:
    """Return a job with a column of random numbers beside its readings, which has nothing to do with them."""
    column = measured("load", "load", compound("1"))
    groups = []
    for group in job.model.groups:
        values = {"load": rng.uniform(0.2, 1.4, group.observations.count)}
        conditions = {**group.observations.conditions, **values}
        groups.append(replace(group, observations=replace(group.observations, conditions=conditions)))
    return replace(job, model=replace(job.model, groups=tuple(groups)), places=with_variables(job.places, [column]))


def _form(
    rng: np.random.Generator, form: str, variables: Mapping[str, Array], here: Mask | slice = slice(None), own: str = ""
) -> tuple[Array, frozenset[str]]:
    """Return values of a form (n,) in variables drawn at random, 0 elsewhere than `here`, and the names of these.

    `own` is the axis along which they act: products with it (thermal growth), and the side from which it came
    (backlash), are known effects.
    """
    found, names = _values(rng, form, {name: values[here] for name, values in variables.items()}, own)
    every = np.zeros(len(variables["t"]))
    every[here] = found
    return every, names


def _values(
    rng: np.random.Generator, form: str, variables: Mapping[str, Array], own: str
) -> tuple[Array, frozenset[str]]:
    t, sides = variables["t"], [name for name in variables if name.startswith("from_")]
    places = [name for name in variables if name not in ("t", "T", *sides) and (form != "product" or name != own)]
    name = str(rng.choice({"wave in time": ["t"], "wave in place or time": [*places, "t"]}.get(form, places)))
    v = variables[name]
    if form.startswith("wave"):
        turn = 2 * np.pi * v / (np.ptp(v) / rng.uniform(1.5, 8))
        return np.sin(turn + rng.uniform(0, 6)), frozenset([name])
    if form == "saturation":
        return 1 - np.exp(-t / (np.ptp(t) * rng.uniform(0.04, 0.2))), frozenset(["t"])
    if form == "step":
        return (t > np.quantile(t, rng.uniform(0.15, 0.85))).astype(float), frozenset(["t"])
    if form == "direction":
        side = str(rng.choice([one for one in sides if one != f"from_{own.lower()}"]))
        return variables[side], frozenset([side])
    first = "T" if "T" in variables else "t"
    return variables[first] * v, frozenset([first, name])


def _sized(rng: np.random.Generator, seen: Array) -> tuple[float, float]:
    """Return the size of an error of which the readings have `seen`, in standard deviations, and the norm of that."""
    strength = float(rng.uniform(*STRENGTH))
    return strength / float(np.linalg.norm(seen)) * float(rng.choice([-1, 1])), strength


def _network(rng: np.random.Generator, form: str) -> Planted:
    """Return a network in which the length of one tracer has an error."""
    m = lengths.measurement(rng, _POINTS)
    if form == NOTHING:
        return Planted("multilaterate", m, form, m)
    at = int(rng.integers(len(m.tracers)))
    known = dict(zip("XYZ", m.points[m.point].T, strict=True))
    known |= {"t": m.t - m.t.min(), "T": m.temp - m.temp[np.argmin(m.t)]}
    values, names = _form(rng, form, known, m.tracer == at)
    size, strength = _sized(rng, lengths.visible(m, lengths.absorbed_by(m), values[:, None]))
    wrong = replace(m, length=m.length + size * values)
    return Planted("multilaterate", wrong, form, m, names, (("tracer", f"T{at}"),), strength)


def _machine(rng: np.random.Generator, form: str) -> Planted:
    """Return a machine in which a component of the error motion has an error."""
    m = machine.measurement(rng)
    if form == NOTHING:
        return Planted("calibrate-machine", m, form, m)
    known = dict(zip("XYZ", m.at.T, strict=True)) | {"t": m.t - m.t.min()}
    component = int(rng.integers(3))
    known |= {f"from_{axis}": side for axis, side in zip("xyz", m.came.T, strict=True)}
    values, names = _form(rng, form, known, own="XYZ"[component])
    moved = np.zeros((len(m.at), 3))
    moved[:, component] = values
    change = moved @ m.turn
    size, strength = _sized(rng, m.visible(change))
    return Planted("calibrate-machine", replace(m, read=m.read + size * change), form, m, names, (), strength)


def _grid(rng: np.random.Generator, form: str) -> Planted:
    """Return views of a ball grid in one of which a coordinate has an error."""
    m = grids.measurement(rng, "1234")
    if form == NOTHING:
        return Planted("selfcal-grid", m, form, m)
    view, component = int(rng.integers(4)), int(rng.integers(3))
    known = dict(zip("XYZ", (m.views.hanging + m.views.shifts).T, strict=True))
    known |= {"t": m.t - m.t.min(), "T": m.temp - m.temp[np.argmin(m.t)]}
    values, names = _form(rng, form, known, m.views.view == view, "XYZ"[component])
    change = np.zeros(m.readings.shape)
    change[:, component] = values
    size, strength = _sized(rng, grids.visible(m.views, change[:, :, None]))
    where = (("view", m.views.names[view]),)
    return Planted("selfcal-grid", replace(m, readings=m.readings + size * change), form, m, names, where, strength)


def _images(kind: str, scene: scenes.Scene, rng: np.random.Generator, form: str) -> Planted:
    """Return images in which one coordinate of all image points has an error."""
    m = images.read(scene, rng)
    if form == NOTHING:
        return Planted(kind, m, form, m)
    component = int(rng.integers(2))
    off = scene.predicted(scene.start(), {}) - [scene.lens["cx"], scene.lens["cy"]]
    known = {"off_u": off[:, 0], "off_v": off[:, 1], "t": scene.elapsed}
    known |= {"T": scene.warming} if kind == "calibrate-camera" else {}
    values, names = _form(rng, form, known, own=("off_u", "off_v")[component])
    change = np.zeros(off.shape)
    change[:, component] = values
    seen = scenes.sight(scene)
    if kind == "align-part":
        # most of a saturation is a constant, and that is a known effect there: the shift of the principal point
        shift = np.tile(np.eye(2), (len(change), 1))
        seen = replace(seen, taken=np.linalg.qr(np.concatenate([seen.taken, shift], axis=1))[0])
    size, strength = _sized(rng, seen.left({"outside": lambda *_: change, "size": 1.0}) / scene.noise)
    return Planted(kind, replace(m, uv=m.uv + size * change), form, m, names, (), strength)


def _camera(rng: np.random.Generator, form: str) -> Planted:
    return _images("calibrate-camera", scenes.cmm_scene(rng), rng, form)


def _part(rng: np.random.Generator, form: str) -> Planted:
    return _images("align-part", scenes.part_scene(rng), rng, form)


SIMULATED: dict[str, tuple[Callable[[np.random.Generator, str], Planted], tuple[str, ...]]] = {
    "multilaterate": (_network, ("wave", "saturation", "product")),
    "calibrate-machine": (_machine, ("wave", "saturation", "product", "direction", "step")),
    "selfcal-grid": (_grid, ("wave in time", "product")),
    "calibrate-camera": (_camera, ("wave in place or time", "saturation", "product")),
    "align-part": (_part, ("wave in place or time", "saturation", "product")),
}
"""Measurements of each kind, and the forms of errors that are not a known effect there"""


def planted(kind: str, number: int, nothing: bool = False) -> Planted:
    """Return one seeded measurement of a kind."""
    simulated, forms = SIMULATED[kind]
    rng = np.random.default_rng([90, list(SIMULATED).index(kind), int(nothing), number])
    return simulated(rng, NOTHING if nothing else forms[number % len(forms)])
