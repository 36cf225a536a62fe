"""Mistakes in the files of a network: how often each is recognised, and what is offered for files that are right.

    python -m benchmarks network_mistakes [COUNT] [NAME ...]    # 20 networks for each mistake unless given

Networks are drawn afresh by the plain formulas of the tests, and written with one mistake. Three times as many are
right: a third of them as they are, a third with wrong readings, a third with an error of the tracker beyond its noise.
Bars: each mistake recognised in all, and a wrong correction offered for 1 % of the right files at most.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from simulated.network import Network, network, polar, sigmas

from benchmarks.bars import Rate
from metrocli.diagnosis.mistakes import without_mistakes
from metrocli.project.adjuster import adjuster, others_of
from metrocli.project.inputs import read_inputs
from metrocli.project.job import load

COUNT = 20
MAKES: tuple[dict[str, Any], ...] = (
    {"faces": 2, "stations": 4, "points": 20},
    {"faces": 1, "stations": 4, "points": 20},
    {"faces": 2, "stations": 3, "points": 16, "levelled": True},
    {"faces": 1, "stations": 3, "points": 16, "mixed": True},
)
DEGREE, GON = 180 / np.pi, 200 / np.pi
Rng = np.random.Generator


@dataclass(frozen=True)
class Files:
    """A network as it is written, and words by which its mistake is recognised."""

    net: Network
    words: tuple[str, ...]
    header: str = "az_rad,el_rad,d_mm"
    edits: tuple[tuple[str, Callable[[list[str]], list[str]]], ...] = ()
    """What becomes of the lines of a file"""

    def write(self, folder: Path) -> Path:
        job = self.net.write(folder, header=self.header)
        for name, edit in self.edits:
            path = folder / f"{name}.csv"
            path.write_text("\n".join(edit(path.read_text().splitlines())) + "\n")
        return job


def _as(net: Network, azimuth: float = 1.0, elevation: float = 1.0, distance: float = 1.0) -> Network:
    return replace(net, seen=net.seen * [azimuth, elevation, distance])


def gon_for_degrees(net: Network, rng: Rng) -> Files:
    return Files(_as(net, GON, GON), ("are in gon",), "az_deg,el_deg,d_mm")


def degrees_for_gon(net: Network, rng: Rng) -> Files:
    return Files(_as(net, DEGREE, DEGREE), ("are in deg",), "az_gon,el_gon,d_mm")


def clockwise(net: Network, rng: Rng) -> Files:
    return Files(_as(net, -1.0), ("counts clockwise", "az has the wrong sign"))


def zenith(net: Network, rng: Rng) -> Files:
    seen = net.seen.copy()
    seen[:, 1] = np.pi / 2 - seen[:, 1]
    return Files(replace(net, seen=seen), ("zenith",))


def metres(net: Network, rng: Rng) -> Files:
    return Files(_as(net, distance=1e-3), ("d_mm is in m",))


def unmarked_face(net: Network, rng: Rng) -> Files:
    """Azimuths of face 2 are raw and elevations are reduced; in half of the files nothing marks the face."""
    net = net if (net.face == 2).any() else network(rng, **MAKES[0])
    seen = net.seen.copy()
    seen[net.face == 2, 0] += np.pi
    face = np.ones_like(net.face) if rng.random() < 0.5 else net.face
    return Files(replace(net, seen=seen, face=face, times=True), ("face 2",))


def points_at_a_station(net: Network, rng: Rng) -> Files:
    point, station = net.point.copy(), int(rng.integers(len(net.places)))
    a, b = rng.choice(len(net.points), 2, replace=False).tolist()
    here = net.station == station
    point[here & (net.point == a)], point[here & (net.point == b)] = b, a
    names = net.names[a], net.names[b]
    tail = f"are exchanged at station S{station + 1}"
    return Files(replace(net, point=point), (f"{names[0]} and {names[1]} {tail}", f"{names[1]} and {names[0]} {tail}"))


def points_of_the_list(net: Network, rng: Rng) -> Files:
    near = net.near.copy()
    a, b = rng.choice(net.given or len(net.points), 2, replace=False).tolist()
    near[[a, b]] = near[[b, a]]
    names = net.names[a], net.names[b]
    words = tuple(f"{one} and {other} are exchanged" for one, other in (names, names[::-1]))
    return Files(replace(net, near=near), words)


def stations_over_marks(net: Network, rng: Rng) -> Files:
    """Two levelled stations over marks, which others see, stand in the list with each other's mark."""
    over = _over_marks(network(rng, 4, 12, levelled=True), rng)
    a, b = rng.choice(4, 2, replace=False).tolist()
    names = f"S{a + 1}", f"S{b + 1}"
    words = tuple(f"{one} and {other} are exchanged" for one, other in (names, names[::-1]))

    def exchanged(lines: list[str]) -> list[str]:
        return [_renamed(line, dict(zip(names, names[::-1], strict=True))) for line in lines]

    return Files(over.net, words, edits=(*over.edits, ("stations", exchanged)))


def height_of_the_other_sign(net: Network, rng: Rng) -> Files:
    net = network(rng, **MAKES[3])
    row = int(rng.integers(len(net.heights)))
    heights = [(a, b, -v if i == row else v) for i, (a, b, v) in enumerate(net.heights)]
    return Files(replace(net, heights=tuple(heights)), ("wrong sign",))


def _renamed(line: str, names: dict[str, str]) -> str:
    first, _, rest = line.partition(",")
    return f"{names.get(first, first)},{rest}"


def _over_marks(net: Network, rng: Rng) -> Files:
    """Return a levelled network with a mark below each station, which the other stations see."""
    m, n = len(net.places), len(net.points)
    heights = rng.uniform(200, 1500, m)
    marks = net.places - np.outer(heights, [0, 0, 1])
    i, k = np.nonzero(~np.eye(m, dtype=bool))
    seen = polar(np.einsum("nab,na->nb", net.rotations[i], marks[k] - net.places[i]))
    seen = seen + rng.normal(size=seen.shape) * sigmas(seen)
    more = replace(
        net,
        points=np.concatenate([net.points, marks]),
        near=np.concatenate([net.near, marks + rng.normal(0, 0.5, marks.shape)]),
        station=np.concatenate([net.station, i]),
        point=np.concatenate([net.point, n + k]),
        face=np.concatenate([net.face, np.ones_like(i)]),
        seen=np.concatenate([net.seen, seen]),
    )

    def stations(lines: list[str]) -> list[str]:
        rows = [f"{line},{more.names[n + i]},{heights[i]:.9g},0" for i, line in enumerate(lines[1:])]
        return ["station,instrument,over,height_mm,sigma_height_mm", *rows]

    return Files(more, (), edits=(("stations", stations),))


def right(number: int, net: Network, rng: Rng) -> Files:
    """Return files without a mistake."""
    if number % 3 == 1:
        rows = rng.choice(len(net.seen), 3, replace=False)
        change = np.zeros_like(net.seen)
        change[rows] = rng.normal(size=(3, 3)) * [0.01, 0.01, 30.0]
        return Files(net.with_effect(change), ())
    if number % 3 == 2:
        odd = np.where(net.face == 1, 1.0, -1.0)
        size = rng.uniform(30, 300)
        tilt, index, zero = (
            2e-6 * size * odd / np.cos(net.seen[:, 1]),
            2e-6 * size * odd,
            np.full(len(odd), size * 2e-3),
        )
        return Files(net.with_effect(np.stack([tilt, index, zero], axis=1) * rng.integers(0, 2, 3)), ())
    return _over_marks(net, rng) if net.levelled and number % 2 else Files(net, ())


MISTAKES: dict[str, Callable[[Network, Rng], Files]] = {
    "gon for deg": gon_for_degrees,
    "deg for gon": degrees_for_gon,
    "clockwise": clockwise,
    "zenith": zenith,
    "metres for mm": metres,
    "face 2 not marked": unmarked_face,
    "points exchanged at a station": points_at_a_station,
    "points exchanged in the list": points_of_the_list,
    "stations exchanged": stations_over_marks,
    "height of the wrong sign": height_of_the_other_sign,
}


def offered(files: Files, folder: Path) -> list[str]:
    """Return the corrections that `diagnose` offers, in words; the failure if the job has no solution."""
    job = load(files.write(folder))
    held, adjust = read_inputs(job), adjuster(job)
    try:
        mistaken = without_mistakes(held, adjust, others_of(job, held, adjust))[1]
    except Exception as error:  # what a user would see in place of a correction
        return [f"{type(error).__name__}: {str(error).splitlines()[0]}"]
    return [] if mistaken is None else [str(one) for one in mistaken.mistakes]


def main(arguments: list[str]) -> int:
    """Print the cases that are not right, then the rates; return 1 where a bar is not met."""
    count = int(arguments[0]) if arguments else COUNT
    wanted = arguments[1:] or [*MISTAKES, "right"]
    met = True
    with tempfile.TemporaryDirectory() as where:
        for name in wanted:
            begin, known = time.process_time(), 0
            cases = 3 * count if name == "right" else count
            for number in range(cases):
                rng = np.random.default_rng([39, number, len(name)])
                net = network(rng, **MAKES[number % len(MAKES)])
                files = right(number, net, rng) if name == "right" else MISTAKES[name](net, rng)
                said = offered(files, Path(where))
                good = any(word in said[0] for word in files.words) if said else not files.words
                known += good
                if not good:
                    print(f"  {name}, case {number}: {said or 'nothing'} for {files.words or 'nothing'}", flush=True)
            took = (time.process_time() - begin) / cases
            what = "nothing offered" if name == "right" else "recognised"
            rate = Rate(f"{name}: {what}", known, cases, least=0.99 if name == "right" else 1.0)
            print(f"{rate}\n  {took:.1f} s of CPU a case", flush=True)
            met &= rate.met
    return int(not met)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
