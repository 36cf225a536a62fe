"""Images of several cameras that are given as those of one: their names pair, and so do the poses of their cameras."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from itertools import combinations

import numpy as np

from metrocli.diagnosis.corrections import Mistake
from metrocli.errors import InputError, UndeterminedError
from metrocli.instruments import camera
from metrocli.tasks.calibrate_camera.multi_camera.system import CameraSystem
from metrocli.tasks.calibrate_camera.multi_camera.task import prepared
from metrocli.tasks.calibrate_camera.settings import CameraSettings, Files, OneOfSeveral, Settings
from metrocli.tasks.job import Job
from metrocli.tasks.shared.images.camera_parameters import unit_of
from metrocli.words import in_a_row

_FORMS = (r"(.*?)(\d+)(\D*)", r"(\D*)(\d+)(.*)")
"""The last number of a name is that of the exposure, or the first: left07.jpg, 07_camera1.jpg"""
_MOST, _FEWEST = 6, 3
"""Most cameras, and fewest exposures that two have in common"""
_APART = 0.01
"""Smallest distance of two cameras, in distances of the board: a single one can return to its places"""
_STEPS = 400
_WRITTEN = ("model", "convention", "base", "estimate", "image_size")


def as_several(job: Job[Settings, Files]) -> Iterator[tuple[Mistake, Job[Settings, Files]]]:
    """Yield the cameras to which the images of a job may belong, fixed to each other, if their names pair.

    Poses of a single camera do not pair: those of two then have fewer unknowns, and fit no better unless they are two.
    """
    settings = job.settings
    if settings.rig != "board" or job.effects:
        return
    given = {entry.name: getattr(settings.camera, entry.name) for entry in fields(CameraSettings)}
    names = job.files.images.names if job.files.images is not None else _names(job.files)
    cameras = {name: OneOfSeveral(**given, images=shape) for name, shape in paired(names).items()}
    if not cameras or not _are_apart(job, cameras):
        return
    shapes = in_a_row([several.images for several in cameras.values()])
    wrote = [f'{name}: {{images: "{several.images}"}}' for name, several in cameras.items()]
    entries: dict[str, str | Sequence[str]] = {"camera": ""}
    for name, several in cameras.items():
        entries |= {f"cameras.{name}.{key}": text for key, text in _entries(several).items()}
    yield (
        Mistake(
            "camera",
            f"images {shapes} are of {len(cameras)} cameras that are fixed to each other",
            f"cameras: {{{', '.join(wrote)}}} in place of camera",
            sort="cameras",
            entries=entries,
            steps=_STEPS,
        ),
        replace(job, settings=replace(settings, cameras=cameras)),
    )


def _names(files: Files) -> tuple[str, ...]:
    return tuple(dict.fromkeys(files.observations.texts("image"))) if files.observations is not None else ()


def paired(images: Sequence[str]) -> dict[str, str]:
    """Return names of cameras with those of their images, such as left*.jpg, if images of all have the same numbers.

    An empty dictionary if they do not.
    """
    for form in _FORMS:
        parts = [re.fullmatch(form, image) for image in images]
        numbers: dict[tuple[str, str], set[str]] = {}
        for part in parts:
            if part is not None:
                numbers.setdefault((part[1], part[3]), set()).add(part[2])
        few = any(len(a & b) < _FEWEST for a, b in combinations(numbers.values(), 2))
        if None in parts or few or not 2 <= len(numbers) <= _MOST:
            continue
        cameras = {_named(before, after): f"{before}*{after}" for before, after in sorted(numbers)}
        if len(cameras) == len(numbers):
            return cameras
    return {}


def _named(before: str, after: str) -> str:
    """Return the name of a camera from what its images have before and after their number, without the ending."""
    words = re.findall(r"[A-Za-z0-9]+", f"{before} {re.sub(r'[.][A-Za-z0-9]{1,4}$', '', after)}")
    return "_".join(words) or "camera"


def _are_apart(job: Job[Settings, Files], cameras: dict[str, OneOfSeveral]) -> bool:
    """Return whether the images of each exposure are those of cameras beside each other, by each alone."""
    try:
        system: CameraSystem = prepared(job, cameras)
    except (UndeterminedError, InputError):
        return False
    far = np.linalg.norm(system.blocks[camera.VIEW].values[:, :3], axis=1)
    apart = np.linalg.norm(system.blocks[camera.MOUNT].values[1:, :3], axis=1)
    # one camera at places that it came back to has a distance of 0 between its series (docs/decisions/263)
    return bool((apart > _APART * np.median(far)).all())


def _entries(several: OneOfSeveral) -> dict[str, str | Sequence[str]]:
    """Return what a job writes for a camera."""
    usual = OneOfSeveral(images="")
    write: dict[str, str | Sequence[str]] = {"images": several.images}
    for key in _WRITTEN:
        value = getattr(several, key)
        if value is not None and value != getattr(usual, key):
            write[key] = value if isinstance(value, str) else [str(number) for number in value]
    if several.pixel_size is not None:
        write["pixel_size"] = f"{several.pixel_size:.10g} mm"
    return write | {key: f"{value:.15g} {unit_of(key)}".strip() for key, value in several.given().items()}
