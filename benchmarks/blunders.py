"""Wrong lengths: how often the right one is named, how often a good one, and how far gross errors move the points.

Each case is a network of its own of 100 points in 2 m x 1 m x 1 m with one length off, tracers spread around it. The
rates depend on that: with 60 points and tracers moved about by 200 mm at random, six tracers locate 86 % of 2 um.
Located: the first suspect is the wrong length. Point only: it is the length's point, with its tracer said to be one of
several, the right one among them (with four tracers none can be identified). False: other suspects, a case.

    python -m benchmarks.blunders [CASES]
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from metrocli.doubt import doubts_of
from metrocli.result import Result
from metrocli.table import Table
from metrocli.tasks.multilaterate import task as multilaterate
from metrocli.tasks.multilaterate.settings import Inputs, Settings
from metrocli.tasks.shared.lengths import LengthNoise
from metrocli.uncertainty.predicted import COMMON, CORE

Array = npt.NDArray[np.float64]
NOISE = LengthNoise(1e-4, 1e-7)
VOLUME = np.array([2000.0, 1000.0, 1000.0])
PLACES = np.array(
    [
        [-0.2, -0.6, 0.1], [1.2, -0.5, -0.2], [0.5, 1.7, 0.0], [0.6, 0.4, 2.2],
        [1.3, 1.5, 1.2], [-0.3, 1.3, 1.4], [-0.3, -0.6, 1.8], [1.4, 0.6, 0.5],
    ]
)  # fmt: skip
POINTS = 100


@dataclass(frozen=True)
class Measured:
    """A network with its readings (points, tracers)."""

    points: Array
    nominal: Array
    readings: Array
    sigma: Array

    def run(self, outliers: str = "report") -> Result:
        """Return the result of the job."""
        n, m = self.readings.shape
        point, tracer = np.divmod(np.arange(n * m), m)
        names = np.char.add("P", np.arange(n).astype(str))
        lengths = Table(
            {"point": names[point], "tracer": np.char.add("T", tracer.astype(str)), "length": self.readings.ravel()},
            {"length": "mm"},
        )
        points = Table({"point": names, **dict(zip("xyz", self.nominal.T, strict=True))}, dict.fromkeys("xyz", "mm"))
        settings = Settings(Inputs(Path("-"), Path("-")), NOISE, outliers=outliers)
        return multilaterate.run(multilaterate.TASK.job(settings, lengths, points))


def measured(m: int, rng: np.random.Generator, count: int = POINTS) -> Measured:
    """Return a network at random."""
    points = rng.uniform(0, 1, (count, 3)) * VOLUME
    tracers = (PLACES[:m] + rng.normal(0, 0.02, (m, 3))) * VOLUME
    distance = np.linalg.norm(points[:, None] - tracers, axis=2)
    sigma = np.sqrt(NOISE.constant**2 + (NOISE.proportional * distance) ** 2)
    readings = distance - rng.uniform(200, 900, m) + rng.normal(size=distance.shape) * sigma
    return Measured(points, points + rng.normal(0, 0.02, points.shape), readings, sigma)


@dataclass(frozen=True)
class Rates:
    """What the cases show."""

    located: float
    point_only: float
    false: float


def rates(m: int, size: float, cases: int) -> Rates:
    """Return how often a length that is `size` [mm] off is the first suspect, and the other suspects a case."""
    located = point_only = false = 0
    for case in range(cases):
        rng = np.random.default_rng([m, case])
        network = measured(m, rng)
        i, j = int(rng.integers(POINTS)), int(rng.integers(m))
        network.readings[i, j] += size * rng.choice([-1, 1])
        suspects = network.run().tables["suspects"]
        named = list(zip(*(suspects.texts(name) for name in ("point", "tracer", "or")), strict=True))
        right = [_right(one, f"P{i}", f"T{j}") for one in named]
        located += right[:1] == ["located"]
        point_only += right[:1] == ["point only"]
        false += right.count("")
    return Rates(located / cases, point_only / cases, false / cases)


def _right(named: tuple[str, str, str], point: str, tracer: str) -> str:
    """Return how a suspect matches the wrong length: "located", "point only", or nothing that is right."""
    if named[0] != point:
        return ""
    if named[1] == tracer:
        return "located"
    return "point only" if named[1] == "ambiguous" and tracer in named[2].split() else ""


def moved(m: int, share: float, cases: int) -> Iterator[tuple[float, float, int]]:
    """Yield how far gross errors of 100 sigma in a share of the lengths move the points, in uncertainties then stated.

    Each gives the shift of coordinates (root mean square) against the same measurement without gross errors, after the
    best fit of both: of all points, and of those of which no length was wrong; and the number of points left out.
    """
    for case in range(cases):
        rng = np.random.default_rng([7, m, case])
        clean = measured(m, rng)
        spoilt = rng.random(clean.readings.shape) < share
        off = np.where(spoilt, 100 * clean.sigma * rng.choice([-1, 1], clean.readings.shape), 0.0)
        good = clean.run().tables["points"]
        found = Measured(clean.points, clean.nominal, clean.readings + off, clean.sigma).run("remove").tables["points"]
        rows = [good.texts("point").index(name) for name in found.texts("point")]
        reference, places = good.stacked("xyz")[rows], found.stacked("xyz")
        shift = (_fitted(places, reference) - reference) / found.stacked(["sx", "sy", "sz"])
        clean_ones = ~spoilt[rows].any(axis=1)
        yield _rms(shift), _rms(shift[clean_ones]), POINTS - len(rows)


def held(m: int, share: float, cases: int) -> Iterator[tuple[float, float, bool]]:
    """Yield of networks of 20 points with lengths wrong by 8 to 60 sigma: how well distances are stated.

    Each gives the share of 95 % intervals that hold the true distance between two points, the root mean square of the
    error in standard uncertainties, and whether the result may be used.
    """
    for case in range(cases):
        rng = np.random.default_rng([8, m, case])
        net = measured(m, rng, 20)
        spoilt = rng.random(net.sigma.shape) < share
        size = rng.uniform(8, 60, net.sigma.shape) * rng.choice([-1, 1], net.sigma.shape)
        off = np.where(spoilt, size * net.sigma, 0.0)
        result = Measured(net.points, net.nominal, net.readings + off, net.sigma).run("remove")
        table, own = result.tables["points"], result.arrays["points_covariance"]
        true, places = net.points[[int(name[1:]) for name in table.texts("point")]], table.stacked("xyz")
        a, b = np.triu_indices(len(places), 1)
        line = places[a] - places[b]
        found = np.linalg.norm(line, axis=1)
        both = result.arrays[COMMON]
        cross = np.einsum("nik,kl,njl->nij", both[a], result.arrays[CORE], both[b])
        of_line = own[a] + own[b] - cross - cross.transpose(0, 2, 1)
        std = np.sqrt(np.einsum("ni,nij,nj->n", line, of_line, line)) / found
        z = (found - np.linalg.norm(true[a] - true[b], axis=1)) / std
        yield float((np.abs(z) < 1.96).mean()), _rms(z), not doubts_of(result, ())


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))


def _fitted(points: Array, reference: Array) -> Array:
    """Return points after the best shift and turn onto the reference (Kabsch 1976)."""
    centre, target = points.mean(axis=0), reference.mean(axis=0)
    u, _, vt = np.linalg.svd((points - centre).T @ (reference - target))
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return np.asarray((points - centre) @ turn + target)


def main() -> None:
    """Print the rates."""
    cases = int(sys.argv[1]) if len(sys.argv) > 1 else 500
    for m in (4, 5, 6, 8):
        for size in (0.0, 1e-3, 2e-3, 5e-3):
            found = rates(m, size, cases)
            what = f"{m} tracers, {size:.0e} mm off" if size else f"{m} tracers, nothing off"
            print(
                f"{what:26} located {found.located:6.1%}  point only {found.point_only:6.1%}  "
                f"false {found.false:.3f} a case",
                flush=True,
            )
    for m in (5, 6, 8):
        shifts = np.array(list(moved(m, 0.05, max(cases // 5, 1))))
        print(
            f"{m} tracers, 5 % off by 100 sigma: points move by {np.median(shifts[:, 0]):.2f} standard uncertainties "
            f"(median of {len(shifts)} cases; more than 1 in {(shifts[:, 0] > 1).sum()}, at most "
            f"{shifts[:, 0].max():.2f}), those without a wrong length by "
            f"{np.median(shifts[:, 1]):.2f} (at most {shifts[:, 1].max():.2f}); "
            f"{shifts[:, 2].mean():.1f} of {POINTS} points left out"
        )
    found = np.array(list(held(6, 0.05, cases)))
    shares, rms = found[:, 0], np.sqrt((found[:, 1] ** 2).mean())
    print(
        f"6 tracers, 20 points, 5 % off by 8 to 60 sigma: 95 % intervals of distances hold {shares.mean():.1%} "
        f"(+- {shares.std() / np.sqrt(cases):.1%}), errors are {rms:.2f} standard uncertainties; "
        f"{found[:, 2].mean():.0%} of {cases} may be used"
    )


if __name__ == "__main__":
    main()
