"""A realistic rest: beside white noise each tracer, image or axis has an error that varies smoothly, by chance.

Its standard deviation is drawn between 0.3 and 1 of the noise, its length of correlation between 1/32 and 1/4 of the
range. It is a sum of 200 waves of random frequencies (squared-exponential covariance), so nothing of it is shared with
the processes that the diagnosis knows.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, ndtri

from benchmarks.hidden import images, lengths, machine
from benchmarks.hidden.case import Case, Hidden
from benchmarks.hidden.scenes import board_scene, sight

Array = npt.NDArray[np.float64]
SIZES = (0.3, 1.0)
LENGTHS = (1 / 32, 1 / 4)
DRAW = 78
"""Number of the drawing of all cases"""
_WAVES = 200
_EVEN = 0.8
"""Power with which the smallest size is found"""


@dataclass(frozen=True)
class Size:
    """The size of an effect in multiples of the smallest that is found; 0 for nothing hidden."""

    times: float
    beside_rest: bool = False
    """Whether the smallest is that beside the rest; otherwise it is that beside white noise"""

    def __str__(self) -> str:
        if not self.times:
            return "nothing hidden"
        return f"{self.times:g}x beside the rest" if self.beside_rest else f"{self.times:g}x beside white noise"


def smooth(rng: np.random.Generator, places: Array) -> tuple[Array, Array]:
    """Return a smooth random error at places (n, k), shares of the range, (n,), and its covariance (n, n).

    Length and size are random.
    """
    length = np.exp(rng.uniform(*np.log(LENGTHS)))
    frequencies = rng.normal(size=(places.shape[1], _WAVES)) / length
    waves = np.cos(places @ frequencies + rng.uniform(0, 2 * np.pi, _WAVES))
    size = rng.uniform(*SIZES)
    apart = ((places[:, None] - places) ** 2).sum(axis=2) / length**2
    return size * np.sqrt(2 / _WAVES) * waves.sum(axis=1), size**2 * np.exp(-apart / 2)


def of_each(rng: np.random.Generator, places: Array, unit: npt.NDArray[np.intp]) -> tuple[Array, Array]:
    """Return independent smooth errors of each unit, in standard deviations of the noise, and their covariance."""
    shares = (places - places.min(axis=0)) / np.ptp(places, axis=0)
    found, covariance = np.zeros(len(unit)), np.zeros((len(unit), len(unit)))
    for number in np.unique(unit):
        own = np.flatnonzero(unit == number)
        found[own], covariance[np.ix_(own, own)] = smooth(rng, shares[own])
    return found, covariance


def of_lengths(rng: np.random.Generator, turn: int, size: Size) -> Case | None:
    """Return a network whose tracers each have a smooth error in time, with an effect of a size."""
    m, hidden, power = lengths.measurement(rng, int(rng.integers(60, 101))), list[Hidden](), None
    off, covariance = of_each(rng, m.t[:, None], m.tracer)
    read = replace(m, length=m.length + off * m.sigma)
    if size.times:
        known = (*lengths.EVERYWHERE, *lengths.AT_ONE)
        beside = covariance if size.beside_rest else None
        read, one = lengths.planted(read, rng, known[turn % len(known)], size.times, beside)
        hidden.append(one)
        power = _power(m, read.length - m.length - off * m.sigma, covariance, size)
    return Case(str(size), read.adjusted, tuple(hidden), power=power)


def _power(m: lengths.Measurement, change: Array, covariance: Array, size: Size) -> float:
    """Return the power of a test of the effect alone in a network."""
    white, known = (lengths.size_beside(m, change, one) for one in (np.zeros_like(covariance), covariance))
    return _power_of(white, known, size)


def _power_of(white: float, known: float, size: Size) -> float:
    """Return the power of a test of the effect alone, whose level shows the least size in 80 % of the cases.

    `white` and `known` are what shows of the effect, in standard deviations, beside white noise and beside the rest.
    """
    least = (known if size.beside_rest else white) / size.times
    return float(ndtr(known - (least - float(ndtri(_EVEN)))))


def _shown(taken: Array, change: Array, covariance: Array) -> tuple[float, float]:
    """Return what shows of a whitened change (rows,) that columns (rows, k) do not absorb, beside white noise and rest.

    It is the norm of what is left of `L^-1 d` beside `L^-1 J`, with `L L' = I + covariance`.
    """
    found = []
    for one in (np.zeros_like(covariance), covariance):
        lower = np.linalg.cholesky(np.eye(len(one)) + one)
        basis, _ = np.linalg.qr(np.linalg.solve(lower, taken))
        own = np.linalg.solve(lower, change)
        found.append(float(np.linalg.norm(own - basis @ (basis.T @ own))))
    return found[0], found[1]


def _together(several: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Return independent errors (n,) of several components side by side, (n, d), and their covariance (n d, n d)."""
    n, d = len(several[0][0]), len(several)
    covariance = np.zeros((n, d, n, d))
    for component, (_, own) in enumerate(several):
        covariance[:, component, :, component] = own
    return np.stack([off for off, _ in several], axis=1), covariance.reshape(n * d, n * d)


def of_images(rng: np.random.Generator, turn: int, size: Size) -> Case | None:
    """Return images of a board that each have a smooth error over the image, with an effect of a size."""
    known = [name for name, plant in images.PLANTS["calibrate-camera"].items() if "board" in plant.rigs]
    wanted = [known[turn % len(known)]] if size.times else []
    plants = [images.PLANTS["calibrate-camera"][name] for name in wanted]
    plain = images.read(images.without(board_scene(rng, 12, (9, 7)), plants, wanted), rng)
    read, hidden, power, begun = plain, list[Hidden](), None, deepcopy(rng)
    for name in wanted:
        made = images.planted(plain, rng, name, size.times)
        if made is None:
            return None
        read, hidden = made[0], [made[1]]
    noise = plain.scene.noise
    off, covariance = _together([of_each(rng, read.uv, read.scene.view) for _ in range(2)])
    for name in wanted:
        taken = sight(plain.scene).taken
        white, beside = _shown(taken, ((read.uv - plain.uv) / noise).ravel(), covariance)
        if size.beside_rest:
            made = images.planted(plain, begun, name, size.times * white / beside)
            assert made is not None
            read, hidden = made[0], [made[1]]
            white, beside = _shown(taken, ((read.uv - plain.uv) / noise).ravel(), covariance)
        power = _power_of(white, beside, size)
    return Case(str(size), replace(read, uv=read.uv + off * noise).adjusted, tuple(hidden), power=power)


def of_machine(rng: np.random.Generator, turn: int, size: Size) -> Case | None:
    """Return points of a machine with a smooth error in time of each component, with an effect of a size."""
    plain = machine.measurement(rng, machine.SIZE)
    m, hidden, power, begun = plain, list[Hidden](), None, deepcopy(rng)
    name = list(machine.PARAMETERS)[turn % len(machine.PARAMETERS)]
    if size.times:
        m, one = machine.planted(plain, rng, name, size.times)
        hidden = [one]
    every = np.zeros(len(m.t), dtype=np.intp)
    off, covariance = _together([of_each(rng, m.t[:, None], every) for _ in range(3)])
    if size.times:
        white, beside = _shown(plain.absorbed, plain.whitened(m.read - plain.read), covariance)
        if size.beside_rest:
            m, one = machine.planted(plain, begun, name, size.times * white / beside)
            hidden = [one]
            white, beside = _shown(plain.absorbed, plain.whitened(m.read - plain.read), covariance)
        power = _power_of(white, beside, size)
    read = replace(m, read=m.read + np.linalg.solve(m.white, off[:, :, None])[:, :, 0])
    return Case(str(size), read.adjusted, tuple(hidden), power=power)


@dataclass(frozen=True)
class Rest:
    """How cases of a kind of job are made."""

    case: Callable[[np.random.Generator, int, Size], Case | None]
    sizes: tuple[Size, ...]

    def cases(self, count: int, size: Size, draw: int = DRAW) -> list[Case]:
        """Return the seeded cases of a drawing."""
        found: list[Case] = []
        number = 0
        while len(found) < count:
            seed = [draw, round(10 * size.times), int(size.beside_rest), number]
            made = self.case(np.random.default_rng(seed), number, size)
            number += 1
            if made is not None:
                found.append(made)
        return found


_SIZES = (Size(0.0), Size(2.0), Size(4.0), Size(2.0, beside_rest=True))
KINDS = {
    "multilaterate": Rest(of_lengths, _SIZES),
    "calibrate-camera": Rest(of_images, _SIZES),
    "calibrate-machine": Rest(of_machine, _SIZES),
}
