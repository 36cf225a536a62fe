"""Image points with something hidden in them: cameras on a board or a measuring machine, parts seen from a spindle."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.hidden.case import Case, Hidden
from benchmarks.hidden.scenes import Scene, Sight, board_scene, cmm_scene, part_scene, sight
from benchmarks.hidden.stated import stated
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.effects.requested import RequestedEffect
from metrocli.table import Table
from metrocli.tasks.align_part import settings as part_job
from metrocli.tasks.align_part import task as align_part
from metrocli.tasks.calibrate_camera import settings as camera_job
from metrocli.tasks.calibrate_camera import task as calibrate_camera
from metrocli.tasks.calibrate_camera.settings import CameraSettings
from metrocli.tasks.shared.images.settings import CameraFile, Extrinsics

Array = npt.NDArray[np.float64]
NOWHERE = Path("-")


@dataclass(frozen=True)
class Images:
    """A scene as it was read."""

    scene: Scene
    uv: Array
    """(n, 2)"""
    declared: float = 1.0
    """Declared noise over the true one"""

    def adjusted(self, effects: Sequence[RequestedEffect] = ()) -> AdjustedJob:
        """Return it as the job that a user would give, with the effects that the job has in its model."""
        scene = self.scene
        names, images = _names("T", len(scene.targets)), _names("I", len(scene.time))
        seen = {"image": images[scene.view], "target": names[scene.target], "u": self.uv[:, 0], "v": self.uv[:, 1]}
        points = dict(zip("xyz", scene.targets.T, strict=True)) | {"radius": np.full(len(names), scene.radius)}
        targets = Table({"target": names, **points}, dict.fromkeys(points, "mm"))
        noise = scene.noise * self.declared
        if scene.kind == "align-part":
            return self._alignment(Table(seen, {"u": "px", "v": "px"}), targets, noise, effects)
        seen |= {"t": scene.time[scene.view], "temp": scene.warmth[scene.view]}
        settings = camera_job.Settings(
            rig=scene.rig,
            inputs=camera_job.Inputs(observations=NOWHERE, targets=NOWHERE),
            noise=noise,
            shutter="rolling" if scene.rolling else "global",
            camera=CameraSettings(image_size=scene.image_size, estimate=scene.lens_free),
        )
        units = {"u": "px", "v": "px", "t": "s", "temp": "degC"}
        return calibrate_camera.diagnosed(
            calibrate_camera.TASK.job(settings, observations=Table(seen, units), targets=targets, effects=effects)
        )

    def _alignment(
        self, observations: Table, targets: Table, noise: float, effects: Sequence[RequestedEffect]
    ) -> AdjustedJob:
        scene = self.scene
        held, mounting = scene.given["spindle"].T, scene.given["mounting"]
        columns = {"image": _names("I", len(scene.time)), **dict(zip("xyzabc", held, strict=True)), "t": scene.time}
        poses = Table(columns, {**dict.fromkeys("xyz", "mm"), **dict.fromkeys("abc", "rad"), "t": "s"})
        place = dict(zip(("x", "y", "z", "alpha", "beta", "gamma"), mounting.tolist(), strict=True))
        camera = CameraFile(image_size=scene.image_size, extrinsics=Extrinsics(**place), **scene.lens)
        inputs = part_job.Inputs(camera=NOWHERE, poses=NOWHERE, targets=NOWHERE, observations=NOWHERE)
        estimate = ("part-pose", "clamping-angle") if scene.angle_free else ("part-pose",)
        shutter = "rolling" if scene.rolling else "global"
        settings = part_job.Settings(inputs=inputs, noise=noise, estimate=estimate, shutter=shutter)
        files = {"camera": camera, "poses": poses, "targets": targets, "observations": observations}
        return align_part.diagnosed(align_part.TASK.job(settings, effects=effects, **files))


def _names(letter: str, count: int) -> npt.NDArray[np.str_]:
    return np.array([f"{letter}{i:03d}" for i in range(count)])


@dataclass(frozen=True)
class Plant:
    """How an effect of the tables is planted: the scene's own name of each parameter, and what the job leaves out."""

    parameters: Mapping[str, str]
    """Parameter of the table: short name in the scene, or a place in an array of it, as `moved.0`"""
    left_out: tuple[str, ...] = ()
    """Lens parameters that the job does not estimate"""
    where: str = ""
    """target, image, axis or pair"""
    by: str = ""
    rigs: tuple[str, ...] = ("board", "cmm", "")


_XYZ = ("dx", "dy", "dz")
_ROWS = {"a_u": "rolling.0", "a_v": "rolling.1"}
PLANTS: dict[str, dict[str, Plant]] = {
    "calibrate-camera": {
        "radial-distortion": Plant({"k2": "k2"}, ("k2",)),
        "decentring-distortion": Plant({"p1": "p1", "p2": "p2"}, ("p1", "p2")),
        "thin-prism": Plant({"s1": "s1", "s3": "s3"}, ("p1", "p2")),
        "aspect-ratio": Plant({"aspect": "aspect"}),
        "axis-skew": Plant({"skew": "skew"}),
        "principal-point": Plant({"cx": "cx", "cy": "cy"}, ("cx", "cy")),
        "target-plane-bend": Plant({"bxx": "bend.0", "bxy": "bend.1", "byy": "bend.2"}, rigs=("board",)),
        "focal-drift": Plant({"rate": "focal_t"}, by="t"),
        "focal-drift, T": Plant({"rate": "focal_T"}, by="T"),
        "principal-point-drift": Plant({"rate_u": "rate_u", "rate_v": "rate_v"}),
        "moved-target": Plant({name: f"moved.{i}" for i, name in enumerate(_XYZ)}, where="target"),
        "rolling-shutter": Plant(_ROWS, where="image", rigs=("board",)),
    },
    "align-part": {
        "clamping-angle": Plant({"gamma_s": "gamma_s"}),
        "coupling-tilt": Plant({"alpha_s": "alpha_s", "beta_s": "beta_s"}),
        "coupling-shift": Plant({"dx": "dx", "dy": "dy"}),
        "part-expansion": Plant({"scale": "scale"}),
        "moved-target": Plant({name: f"moved.{i}" for i, name in enumerate(_XYZ)}, where="target"),
        "bad-pose": Plant({name: f"bad_pose.{i}" for i, name in enumerate(_XYZ)}, where="image"),
        "focal-change": Plant({"ratio": "ratio"}),
        "principal-point-shift": Plant({"du": "cx", "dv": "cy"}),
        "machine-scale": Plant({"scale": "machine_scale"}, where="axis"),
        "machine-squareness": Plant({"angle": "squareness"}, where="pair"),
        "machine-straightness": Plant({"b1": "bow.0", "b2": "bow.1"}, where="axis"),
        "machine-angular": Plant({name: f"angular.{i}" for i, name in enumerate(("rx", "ry", "rz"))}, where="axis"),
        "spindle-growth": Plant({"rate": "growth"}, by="t"),
        "stretched-targets": Plant({"stretch": "stretched.0", "shear": "stretched.1"}),
        "part-drift": Plant({name: f"drift.{i}" for i, name in enumerate(("vx", "vy", "vz"))}),
        "radial-distortion": Plant({"dk1": "k1"}),
        "rolling-shutter": Plant(_ROWS, where="image"),
    },
}
_TYPICAL = {
    "drift": 1e-5,
    "focal_t": 1e-6,
    "rate_u": 1e-3,
    "bend": 1e-6,
    "moved": 0.1,
    "bad_pose": 0.1,
    "bow": 1e-7,
    "angular": 1e-7,
    "growth": 1e-5,
    "cx": 1.0,
}
"""Sizes at which signatures are taken, where 1e-4 is not of the right order"""
PAIRS = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}


def effects_of(plant: Plant, values: Mapping[str, float], place: str) -> dict[str, Any]:
    """Return an effect as a scene takes it."""
    found: dict[str, Any] = {}
    for name, short in plant.parameters.items():
        key, _, at = short.partition(".")
        if at:
            found.setdefault(key, np.zeros(3))[int(at)] = values[name]
        elif key == "machine_scale":
            found[key] = [("xyz".index(place), values[name])]
        elif key == "squareness":
            found[key] = [(*PAIRS[place], values[name])]
        else:
            found[key] = values[name]
    if plant.where in ("target", "image"):
        found[plant.where] = int(place[1:])
    if "bow" in found or "angular" in found:
        found["axis"] = "xyz".index(place)
    return found


def _places(scene: Scene, plant: Plant) -> list[str]:
    """Return all places where an effect can be; targets and images that are seen twice, where there are any."""
    if plant.where in ("target", "image"):
        letter, counts = plant.where[0].upper(), np.bincount(scene.target if plant.where == "target" else scene.view)
        return [f"{letter}{i:03d}" for i in np.flatnonzero(counts >= min(2, counts.max()))]
    return {"axis": list("xyz"), "pair": list(PAIRS)}.get(plant.where, [""])


def _size(plant: Plant) -> float:
    return _TYPICAL.get(next(iter(plant.parameters.values())).partition(".")[0], 1e-4)


def _nearest(seen: Sight, kind: str, effect: tuple[str, str], left: Array) -> float:
    """Return the largest cosine of what an effect leaves with another cause or place."""
    most = 0.0
    for name, plant in PLANTS[kind].items():
        if (seen.scene.rig or "") not in plant.rigs or set(plant.parameters) & set(seen.scene.lens_free):
            continue
        if name == "rolling-shutter" and not seen.scene.rolling:
            continue
        for place in _places(seen.scene, plant):
            if (name.partition(",")[0], place) == effect:
                continue
            units = [{key: _size(plant) * (key == own) for key in plant.parameters} for own in plant.parameters]
            columns = np.stack([seen.left(effects_of(plant, unit, place)) for unit in units], axis=1)
            u, s, _ = np.linalg.svd(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300), full_matrices=False)
            most = max(most, float(np.linalg.norm(u[:, s > 1e-4].T @ left) / np.linalg.norm(left)))
    return most


def planted(images: Images, rng: np.random.Generator, name: str, times: float) -> tuple[Images, Hidden] | None:
    """Return the images with an effect of so many times its least detectable size; None where nothing of it shows."""
    scene = images.scene
    plant = PLANTS[scene.kind][name]
    place = str(rng.choice(_places(scene, plant)))
    direction = rng.normal(size=len(plant.parameters))
    direction *= _size(plant) / np.linalg.norm(direction)
    values = dict(zip(plant.parameters, direction.tolist(), strict=True))
    effect, seen = name.partition(",")[0], sight(scene)
    left = seen.left(effects_of(plant, values, place))
    shows = float(np.linalg.norm(left)) / scene.noise
    if shows < 1e-3:
        return None
    factor = times * np.sqrt(stated(images.adjusted(), effect, len(plant.parameters))) / shows
    values = {key: value * factor for key, value in values.items()}
    noise = images.uv - scene.predicted(scene.start(), {})
    uv = scene.predicted(scene.start(), effects_of(plant, values, place)) + noise
    where = ({plant.where: place} if plant.where else {}) | ({"by": plant.by} if plant.by else {})
    known = values | ({"k3": 0.0} if "k2" in values else {})
    return replace(images, uv=uv), Hidden(effect, where, known, _nearest(seen, scene.kind, (effect, place), left))


Outside = Callable[[Scene, Array, Array], Array]


def _outside(name: str, rng: np.random.Generator) -> Outside:
    """Return the image points' change by an effect that is in no table, of size 1 px."""
    phase, period = rng.uniform(0, 6), rng.uniform(3.5, 8.0)

    def change(scene: Scene, off: Array, points: Array) -> Array:
        radius = np.hypot(*off.T)
        outwards = off / np.maximum(radius, 1e-9)[:, None]
        share = radius / np.hypot(*scene.image_size) * 2
        zero = np.zeros(len(off))
        if name == "_six-lobe":
            return outwards * np.cos(6 * np.arctan2(off[:, 1], off[:, 0]) + phase)[:, None]
        if name == "_order-wave":
            return np.column_stack([zero, np.sin(2 * np.pi * scene.view / period + phase)])
        if name == "_ripple":
            return outwards * np.sin(14 * share + phase)[:, None]
        return np.column_stack([np.where(off[:, 0] > 0, 0.5, -0.5), zero])

    return change


OUTSIDE = ("_six-lobe", "_order-wave", "_ripple", "_sensor-step")
WITHIN = {
    "_six-lobe": frozenset({"lens-shape"}),
    "_ripple": frozenset({"lens-shape", "radial-distortion"}),
    "_sensor-step": frozenset({"lens-shape"}),
}
"""A shift over the image that all images share is a lens shape, and one along the radius is a radial distortion"""


def unknown(images: Images, rng: np.random.Generator, name: str, times: float) -> tuple[Images, Hidden]:
    """Return the images with an effect that is in no table."""
    scene = images.scene
    change = _outside(name, rng)
    like = "part-expansion" if scene.kind == "align-part" else "aspect-ratio"
    seen = sight(scene)
    shows = seen.strength({"outside": change, "size": 1.0})
    size = times * np.sqrt(stated(images.adjusted(), like, 2)) / max(shows, 1e-3)
    uv = (
        images.uv
        + scene.predicted(scene.start(), {"outside": change, "size": size})
        - scene.predicted(scene.start(), {})
    )
    near = _nearest(seen, scene.kind, (name, ""), seen.left({"outside": change, "size": 1.0}))
    return replace(images, uv=uv), Hidden(name, {}, {"c": float(size)}, near, within=WITHIN.get(name, frozenset()))


def spoilt(images: Images, rng: np.random.Generator, share: float) -> tuple[Images, frozenset[tuple[str, ...]]]:
    """Return the images with a share of the coordinates wrong by 6 to 25 standard deviations."""
    wrong = rng.random(images.uv.shape) < share
    off = rng.uniform(6, 25, wrong.shape) * rng.choice([-1, 1], wrong.shape) * images.scene.noise * wrong
    view, target = images.scene.view, images.scene.target
    keys = frozenset((f"I{view[i]:03d}", f"T{target[i]:03d}", "uv"[j]) for i, j in np.argwhere(wrong).tolist())
    return replace(images, uv=images.uv + off), keys


def noisier(images: Images, rng: np.random.Generator) -> Images:
    """Return the images with one image three times as noisy as the others."""
    counts = np.bincount(images.scene.view)
    here = images.scene.view == rng.choice(np.flatnonzero(counts >= min(3, counts.max())))
    more = rng.normal(size=images.uv.shape) * images.scene.noise * np.sqrt(8.0)
    return replace(images, uv=images.uv + more * here[:, None])


def read(scene: Scene, rng: np.random.Generator) -> Images:
    """Return the scene as it is read, with noise."""
    return Images(scene, scene.predicted(scene.start(), {}) + rng.normal(0, scene.noise, (len(scene.view), 2)))


def _scene(kind: str, scenario: str, rng: np.random.Generator, rig: str, small: bool) -> Scene:
    if kind == "align-part":
        if "few" in scenario:
            return part_scene(rng, 8, 4, turned=False)
        return part_scene(rng, 16, 8) if small else part_scene(rng)
    if rig == "cmm" and "noisier" not in scenario:
        return cmm_scene(rng, 20 if "few" in scenario else 40 if small else 120)
    if "few" in scenario:
        return board_scene(rng, 8, (5, 4))
    return board_scene(rng, 8, (6, 5)) if small else board_scene(rng)


def case(kind: str, number: int, small: bool = False) -> Case:
    """Return one seeded case, or one of fewer images and targets."""
    rng = np.random.default_rng([44, len(kind), number])
    scenario = SCENARIOS[number % len(SCENARIOS)]
    turn = number // len(SCENARIOS) + 5 * (number % len(SCENARIOS))
    rig = ("board", "cmm")[turn % 2] if kind == "calibrate-camera" else ""
    for later in range(100):
        found = _tried(kind, scenario, rng, (turn + 2 * later, rig, small))
        if found is not None:
            return found
    raise RuntimeError(f"nothing that could be planted shows in case {number}")


def _tried(kind: str, scenario: str, rng: np.random.Generator, at: tuple[int, str, bool]) -> Case | None:
    """Return a case; None where nothing of the effect that was drawn shows in the scene that was drawn."""
    turn, rig, small = at
    scene = _scene(kind, scenario, rng, rig, small)
    known = [name for name, plant in PLANTS[kind].items() if (scene.rig or "") in plant.rigs]
    wanted: list[str] = []
    if scenario.endswith("x"):
        wanted = [known[(turn // 2 if rig else turn) % len(known)]]
    elif "two effects" in scenario:
        wanted = rng.choice(known, 2, replace=False).tolist()
        lens = [name for name in wanted if PLANTS[kind][name].left_out]
        if wanted[0].partition(",")[0] == wanted[1].partition(",")[0] or len(lens) == 2:
            return None
    scene = without(scene, [PLANTS[kind][name] for name in wanted], wanted)
    images = read(scene, rng)
    hidden: list[Hidden] = []
    for name in wanted:
        times = float(scenario.split()[-1][:-1]) if scenario.endswith("x") else float(rng.uniform(2, 4))
        made = planted(images, rng, name, times)
        if made is None:
            return None
        images = made[0]
        hidden.append(made[1])
    wrong: frozenset[tuple[str, ...]] = frozenset()
    if "outside" in scenario:
        images, one = unknown(images, rng, OUTSIDE[turn % len(OUTSIDE)], float(rng.uniform(2, 3.5)))
        hidden.append(one)
    if "outliers" in scenario:
        images, wrong = spoilt(images, rng, 0.02)
    if "noisier" in scenario:
        images = noisier(images, rng)
    ratio = 2.0 if "half" in scenario else 0.5 if "double" in scenario else 1.0
    return Case(scenario, replace(images, declared=1 / ratio).adjusted, tuple(hidden), wrong, ratio)


def without(scene: Scene, plants: list[Plant], names: list[str]) -> Scene:
    left_out = tuple(dict.fromkeys(name for plant in plants for name in plant.left_out))
    scene = replace(scene, rolling="rolling-shutter" in names)
    if "clamping-angle" in names:
        return replace(scene, angle_free=False, unknowns=scene.unknowns[:6])
    return scene.without(left_out) if scene.lens_free else scene


SCENARIOS = (
    "nothing",
    "nothing, few",
    "nothing, 2 % outliers",
    "nothing, noise declared half",
    "nothing, noise declared double",
    "nothing, one image noisier",
    "nothing",
    "an effect of 1x",
    "an effect of 1.5x",
    "an effect of 2x",
    "an effect of 3x",
    "2 % outliers and an effect of 2x",
    "noise declared half and an effect of 2x",
    "one image noisier and an effect of 3x",
    "few and an effect of 2x",
    "two effects",
    "two effects",
    "outside the table",
    "outside the table",
    "outside the table",
)
"""Few: 8 images of 20 targets (board), 20 places seen twice (cmm), 8 images of one of 4 targets each (part)"""
