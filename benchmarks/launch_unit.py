"""python -m benchmarks launch_unit: how well a launch unit is located, and whether the beam is where it is planned.

Poses are simulated by the plain formulas of the contract, with their own random draws.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from metrocli.tasks.locate_launch_unit.lines import Reach, ReceiverLine, across, commanded, measurable
from metrocli.tasks.locate_launch_unit.margin import Margin, Uncertainty, Window, beam_position
from metrocli.tasks.locate_launch_unit.plan import planned_measurement
from metrocli.tasks.locate_launch_unit.readings import AlignedPoses
from metrocli.tasks.locate_launch_unit.settings import Axes, LaunchUnitNoise, PlannedLines
from metrocli.tasks.locate_launch_unit.solve import How, Located, locate
from metrocli.units import find_unit

Array = npt.NDArray[np.float64]
ARCSEC = find_unit("arcsec", "angle").inside(1.0)
UM = find_unit("um", "length")
PAPER = np.array([0.0, 1000.0, 1500.0, 0.3])
PAPER_RECEIVERS = np.array([[-1200.0, 200.0, 500.0], [0.0, 200.0, 500.0], [1200.0, 200.0, 500.0]])
PAPER_NOISE = LaunchUnitNoise(50e-6)
TABLE_2 = np.array([0.08, 0.01, -0.04])
EVERYWHERE = Reach(np.array([[-5000.0, 5000.0]] * 3), 50.0, 300.0, 4000.0)
WINDOW = Window(0.25, 500e-6)
NAMES = ("x", "y", "z", "xy", "yz", "xz")


@dataclass(frozen=True)
class Truth:
    """A unit and receivers that see it."""

    unit: Array
    """x y z gamma"""
    receivers: Array
    distances: bool

    def read(self, noise: LaunchUnitNoise, rng: np.random.Generator) -> AlignedPoses:
        """Return aligned poses as read."""
        n = len(self.receivers)
        beam = self.receivers - self.unit[:3]
        azimuth, length = np.arctan2(beam[:, 1], beam[:, 0]), np.linalg.norm(beam, axis=1)
        tilt = np.arcsin(beam[:, 2] / length)
        angles = np.stack([azimuth - self.unit[3], tilt, -tilt, azimuth + np.pi])
        angles = (angles + rng.normal(size=angles.shape) * noise.encoder + np.pi) % (2 * np.pi) - np.pi
        distance = length + rng.normal(size=n) * (noise.distance or 0.0) if self.distances else np.full(n, np.nan)
        names = tuple(f"P{i}" for i in range(n))
        return AlignedPoses(names, self.receivers, np.zeros((n, 3)), np.zeros(n), angles, distance, {})


def somewhere(n: int, distances: bool) -> Truth:
    """Return n receivers in a machine of 2 x 1 x 1 m around a unit below it."""
    rng = np.random.default_rng(n)
    return Truth(np.array([900.0, 400.0, -250.0, 2.9]), rng.uniform([0, 0, 50], [2000, 1000, 1000], (n, 3)), distances)


def error(located: Located, truth: Truth) -> Array:
    """Return x y z gamma minus the truth."""
    off = located.values - truth.unit
    off[3] = (off[3] + np.pi) % (2 * np.pi) - np.pi
    return off


def ideal() -> None:
    """Kuprin et al., table 1."""
    paper = Truth(PAPER, PAPER_RECEIVERS, True)
    still = LaunchUnitNoise(5 * ARCSEC, 1e-3)
    readings = paper.read(LaunchUnitNoise(0.0, 0.0), np.random.default_rng(0))
    for method in ("adjustment", "lines", "closed-loop"):
        off = np.abs(error(locate(readings, still, How(method)), paper))
        print(f"ideal scenario (table 1), {method}: off by at most {off[:3].max():.1e} mm, {off[3]:.1e} rad")


def scatter(draws: int = 1000) -> None:
    """Kuprin et al., table 2: encoders of 50 urad."""
    paper, rng = Truth(PAPER, PAPER_RECEIVERS, False), np.random.default_rng(1)
    exact = paper.read(LaunchUnitNoise(0.0), rng)
    for method in ("adjustment", "lines"):
        stated = locate(exact, PAPER_NOISE, How(method)).covariance
        located = [locate(paper.read(PAPER_NOISE, rng), PAPER_NOISE, How(method)) for _ in range(draws)]
        errors = np.array([error(one, paper) for one in located])
        ratio = errors.std(axis=0) / np.sqrt(np.diag(stated))
        square = np.einsum("ni,ij,nj->n", errors, np.linalg.inv(stated), errors)
        table2 = float(TABLE_2 @ np.linalg.solve(stated[:3, :3], TABLE_2))
        std = ", ".join(f"{UM.outside(s):.0f}" for s in np.sqrt(np.diag(stated))[:3])
        print(
            f"scenario with errors (table 2), {method}: states {std} um; scatter of {draws} over stated, x y z gamma: "
            f"{np.array2string(ratio, precision=3)}; mean chi2 of 4: {square.mean():.2f}; "
            f"0.08 0.01 -0.04 mm has chi2 {table2:.1f} (95 % bound 7.8)"
        )


def coverage(draws: int = 1000) -> None:
    """Share of the true places inside the stated 95 % ellipsoid."""
    noise, rng = LaunchUnitNoise(5 * ARCSEC, 1e-3), np.random.default_rng(2)
    for n in (2, 3, 5, 20):
        for distances in (False, True):
            truth = somewhere(n, distances)
            inside, sigma0 = 0, 0.0
            for _ in range(draws):
                located = locate(truth.read(noise, rng), noise)
                off = error(located, truth)
                inside += bool(off @ np.linalg.solve(located.covariance, off) < 9.488)
                sigma0 += located.solution.sigma0**2 / draws if located.solution else 0.0
            std = np.sqrt(np.diag(located.covariance))
            print(
                f"{n:2d} poses, {'with' if distances else 'no'} distances: {inside / draws:.1%} inside the 95 % "
                f"ellipsoid, mean sigma0^2 {sigma0:.3f}, "
                f"s(x y z) {np.array2string(UM.outside(std[:3]), precision=1)} um"
            )


def methods() -> None:
    """What the paper's methods give away."""
    noise = LaunchUnitNoise(5 * ARCSEC, 1e-3)
    for n in (3, 8, 20):
        truth = somewhere(n, True)
        exact = truth.read(LaunchUnitNoise(0.0, 0.0), np.random.default_rng(0))
        best = np.sqrt(np.diag(locate(exact, noise).covariance))
        without = Truth(truth.unit, truth.receivers, False).read(LaunchUnitNoise(0.0), np.random.default_rng(0))
        angles = np.sqrt(np.diag(locate(without, noise).covariance))
        for method in ("lines", "closed-loop"):
            worse = np.sqrt(np.diag(locate(exact, noise, How(method)).covariance))
            over = angles if method == "lines" else best
            print(
                f"{n:2d} poses, {method}: standard uncertainties of x y z gamma over those of the adjustment "
                f"{'of the same angles' if method == 'lines' else 'of the same readings'} "
                f"{np.array2string(worse / over, precision=1)}; with distances the adjustment has "
                f"{np.array2string(UM.outside(best[:3]), precision=1)} um"
            )


def beam_off(truth: Truth, line: ReceiverLine, azimuth: float, tilt: float, distance: float) -> Array:
    """Return how far a beam passes beside and above a receiver at a distance along a line from the located unit."""
    w = np.array([np.cos(tilt) * np.cos(azimuth), np.cos(tilt) * np.sin(azimuth), np.sin(tilt)])
    start = line.points[0] - line.distance[0] * line.beam
    to = start + distance * line.beam - truth.unit[:3]
    off = (to @ w) * w - to
    beside, above, _ = across(line.beam)
    return np.array([off @ beside, off @ above])


def beams(draws: int = 1000) -> None:
    """Locate, command, aim, all with noise: the beam at 4 m against what is stated."""
    truth, rng = Truth(PAPER, PAPER_RECEIVERS, False), np.random.default_rng(3)
    for encoder, name in ((50e-6, "50 urad"), (5 * ARCSEC, "5 arcsec")):
        noise = LaunchUnitNoise(encoder)
        inside, stays = np.zeros(len(NAMES)), np.zeros(len(NAMES))
        for _ in range(draws):
            located = locate(truth.read(noise, rng), noise)
            for i, line in enumerate(measurable(located.place, NAMES, EVERYWHERE)[0]):
                aim, e = commanded(line.beam, float(located.values[3]), 0.0), rng.normal(0, encoder, 4)
                azimuth, tilt = PAPER[3] + aim["phi1"] + e[0], aim["phi2"] + e[1]
                far = beam_off(truth, line, azimuth, tilt, 4000.0)
                near = beam_off(truth, line, azimuth, tilt, float(line.distance.min()))
                spread = beam_position(line, Uncertainty(located.covariance, encoder), 4000.0)
                inside[i] += bool(far @ np.linalg.solve(spread, far) < 5.991)
                stays[i] += bool(max(np.linalg.norm(far), np.linalg.norm(near)) <= WINDOW.straightness)
        stated = [
            Margin(line, WINDOW, Uncertainty(located.covariance, encoder).draws()).probability(4000.0)
            for line in measurable(located.place, NAMES, EVERYWHERE)[0]
        ]
        for i, line_name in enumerate(NAMES):
            print(
                f"encoders {name}, line {line_name}: {inside[i] / draws:.1%} of {draws} beams at 4 m in the "
                f"stated 95 % ellipse; in range {stays[i] / draws:.1%}, stated {stated[i]:.1%}"
            )


def margins() -> None:
    """What `plan` reports on the paper's poses, with its encoders and with better ones."""
    planned = PlannedLines(Axes((-1200.0, 4200.0), (0.0, 1200.0), (0.0, 1600.0)), 50.0, 300.0)
    for encoder, name in ((50e-6, "50 urad"), (5 * ARCSEC, "5 arcsec")):
        noise = LaunchUnitNoise(encoder)
        readings = Truth(PAPER, PAPER_RECEIVERS, False).read(LaunchUnitNoise(0.0), np.random.default_rng(5))
        start = time.process_time()
        plan = planned_measurement(locate(readings, noise), planned, noise)
        print(f"plan with encoders of {name} ({time.process_time() - start:.2f} s of CPU): {'; '.join(plan.notes[1:])}")
        lines = plan.tables["lines"]
        rows = zip(*(lines.numbers(key) for key in ("far", "probability", "safe_distance")), strict=True)
        for line, (far, probability, safe) in zip(lines.texts("line"), rows, strict=True):
            print(f"  line {line} to {far:.0f} mm: {probability:.1%}; 95 % to {safe:.0f} mm")


def speed() -> None:
    """CPU time of a location."""
    noise, rng = LaunchUnitNoise(5 * ARCSEC, 1e-3), np.random.default_rng(4)
    for n in (3, 20, 200):
        readings = somewhere(n, True).read(noise, rng)
        locate(readings, noise)
        start = time.process_time()
        for _ in range(20):
            locate(readings, noise)
        print(f"{n:3d} poses: {(time.process_time() - start) / 20:.4f} s of CPU a location")


PARTS: tuple[Callable[[], None], ...] = (ideal, scatter, coverage, methods, beams, margins, speed)


if __name__ == "__main__":
    for part in PARTS:
        part()
