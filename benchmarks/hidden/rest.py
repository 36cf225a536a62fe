"""A realistic rest: beside white noise each tracer, image or axis has an error that varies smoothly, by chance.

Its standard deviation is drawn between 0.3 and 1 of the noise, its length of correlation between 1/32 and 1/4 of the
range. It is a sum of 200 waves of random frequencies (squared-exponential covariance), so nothing of it is shared with
the processes that the diagnosis knows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from benchmarks.hidden import images, lengths, machine
from benchmarks.hidden.case import Case, Hidden
from benchmarks.hidden.scenes import board_scene

Array = npt.NDArray[np.float64]
SIZES = (0.3, 1.0)
LENGTHS = (1 / 32, 1 / 4)
_WAVES = 200


def smooth(rng: np.random.Generator, places: Array) -> Array:
    """Return a smooth random error at places (n, k), shares of the range, of a random length and size, (n,)."""
    length = np.exp(rng.uniform(*np.log(LENGTHS)))
    frequencies = rng.normal(size=(places.shape[1], _WAVES)) / length
    waves = np.cos(places @ frequencies + rng.uniform(0, 2 * np.pi, _WAVES))
    return np.asarray(rng.uniform(*SIZES) * np.sqrt(2 / _WAVES) * waves.sum(axis=1))


def of_each(rng: np.random.Generator, places: Array, unit: npt.NDArray[np.intp]) -> Array:
    """Return independent smooth errors of each unit, in standard deviations of the noise, (n,)."""
    shares = (places - places.min(axis=0)) / np.ptp(places, axis=0)
    found = np.zeros(len(unit))
    for number in np.unique(unit):
        found[unit == number] = smooth(rng, shares[unit == number])
    return found


def of_lengths(rng: np.random.Generator, turn: int, times: float) -> Case | None:
    """Return a network whose tracers each have a smooth error in time, with an effect of so many times its size."""
    m, hidden = lengths.measurement(rng, int(rng.integers(60, 101))), list[Hidden]()
    known = (*lengths.EVERYWHERE, *lengths.AT_ONE)
    if times:
        m, one = lengths.planted(m, rng, known[turn % len(known)], times)
        hidden.append(one)
    read = replace(m, length=m.length + of_each(rng, m.t[:, None], m.tracer) * m.sigma)
    return Case(_words(times), read.adjusted, tuple(hidden))


def of_images(rng: np.random.Generator, turn: int, times: float) -> Case | None:
    """Return images of a board that each have a smooth error over the image."""
    known = [name for name, plant in images.PLANTS["calibrate-camera"].items() if "board" in plant.rigs]
    wanted = [known[turn % len(known)]] if times else []
    plants = [images.PLANTS["calibrate-camera"][name] for name in wanted]
    read, hidden = images.read(images.without(board_scene(rng, 12, (9, 7)), plants, wanted), rng), list[Hidden]()
    for name in wanted:
        made = images.planted(read, rng, name, times)
        if made is None:
            return None
        read = made[0]
        hidden.append(made[1])
    off = [of_each(rng, read.uv, read.scene.view) * read.scene.noise for _ in range(2)]
    return Case(_words(times), replace(read, uv=read.uv + np.stack(off, axis=1)).adjusted, tuple(hidden))


def of_machine(rng: np.random.Generator, turn: int, times: float) -> Case | None:
    """Return points of a machine with a smooth error in time of each component of the tracker's readings."""
    m, hidden = machine.measurement(rng, machine.SIZE), list[Hidden]()
    known = list(machine.PARAMETERS)
    if times:
        m, one = machine.planted(m, rng, known[turn % len(known)], times)
        hidden.append(one)
    every = np.zeros(len(m.t), dtype=np.intp)
    off = np.stack([of_each(rng, m.t[:, None], every) for _ in range(3)], axis=1)
    read = replace(m, read=m.read + np.linalg.solve(m.white, off[:, :, None])[:, :, 0])
    return Case(_words(times), read.adjusted, tuple(hidden))


def _words(times: float) -> str:
    return f"a smooth rest and an effect of {times:g}x" if times else "a smooth rest"


@dataclass(frozen=True)
class Rest:
    """How cases of a kind of job are made."""

    case: Callable[[np.random.Generator, int, float], Case | None]

    def cases(self, count: int, times: float) -> list[Case]:
        """Return seeded cases."""
        found: list[Case] = []
        number = 0
        while len(found) < count:
            made = self.case(np.random.default_rng([77, round(10 * times), number]), number, times)
            number += 1
            if made is not None:
                found.append(made)
        return found


KINDS = {
    "multilaterate": Rest(of_lengths),
    "calibrate-camera": Rest(of_images),
    "calibrate-machine": Rest(of_machine),
}
