"""Networks with something hidden in them: how often `diagnose` names it with its place, and what is not there.

    python -m benchmarks hidden_in_networks [COUNT]        # 200 unless given

Networks are simulated by the plain formulas of the tests: trackers in both faces or in one, levelled instruments, and
interferometers with bars, heights and given points. In a third of them nothing is hidden. In the others an effect is.
Its strength is the norm of what the unknowns leave of it, in standard deviations, by the Jacobian of the dense
adjustment of the tests: 1.5 to 3 times the one that is found with 80 % power. Bars: false names at most 5 %; named with
its place 95 %, or among the alternatives 98 %.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from simulated.network import Array, Network, network
from tasks.adjust_network.dense import Dense

from benchmarks.hidden.named import print_rates, words
from metrocli.diagnosis.detectability import design, needed
from metrocli.diagnosis.diagnose import diagnose
from metrocli.diagnosis.evidence.measured_job import measurement_of
from metrocli.diagnosis.evidence.state import State
from metrocli.project.diagnosed import adjusted_job_of
from metrocli.project.job import load

COUNT, LEAST_SIZES = 200, (1.5, 3.0)
MAKES: tuple[dict[str, Any], ...] = (
    {"faces": 2, "stations": 4, "points": 30},
    {"faces": 1, "stations": 4, "points": 30},
    {"faces": 2, "stations": 3, "points": 24, "levelled": True},
    {"faces": 2, "stations": 3, "points": 24, "mixed": True},
)
Change = Callable[[Network, np.random.Generator], tuple[dict[str, str], Array]]
"""Returns where an effect acts, and by how much azimuth, elevation and distance of each reading change, (n, 3)"""


def _polar(azimuth: Callable[..., Array], elevation: Callable[..., Array], distance: Callable[..., Array]) -> Change:
    def change(net: Network, rng: np.random.Generator) -> tuple[dict[str, str], Array]:
        f = np.where(net.face == 1, 1.0, -1.0)
        a, e, d = net.seen.T
        parts = [np.broadcast_to(part(f, a, e, d), f.shape) for part in (azimuth, elevation, distance)]
        return {"instrument": "A"}, np.stack(parts, axis=1)

    return change


def _none(f: Array, a: Array, e: Array, d: Array) -> Array:
    return np.zeros(1)


def _moved(net: Network, shift: Array, station: Array, of_point: Array) -> Array:
    """Return the change of readings by a shift of points, or of stations, in the axes of the network, (n, 3)."""
    base = Dense(net)
    from simulated.network import polar

    local = np.einsum("nab,na->nb", base.r[net.station], base.x[net.point] - base.s[net.station])
    moved = local + np.einsum("nab,na->nb", base.r[net.station], shift[None] * (of_point - station)[:, None])
    change = polar(moved) - polar(local)
    change[:, 0] = np.remainder(change[:, 0] + np.pi, 2 * np.pi) - np.pi
    return np.asarray(change)


def point_moved(net: Network, rng: np.random.Generator) -> tuple[dict[str, str], Array]:
    """A point stands elsewhere from the second half of the stations on."""
    point = int(rng.integers(len(net.points)))
    later = net.station >= len(net.places) // 2
    change = _moved(net, rng.normal(size=3) * 1e-3, np.zeros(len(later)), (later & (net.point == point)).astype(float))
    return {"point": net.names[point]}, change


def station_moved(net: Network, rng: np.random.Generator) -> tuple[dict[str, str], Array]:
    """A station is pushed in the middle of its measurement."""
    station = int(rng.integers(len(net.places)))
    rows = np.flatnonzero(net.station == station)
    later = np.zeros(len(net.station))
    later[rows[rng.integers(len(rows) // 3, 2 * len(rows) // 3) :]] = 1.0
    return {"station": f"S{station + 1}"}, _moved(net, rng.normal(size=3) * 1e-3, later, np.zeros(len(later)))


CHANGES: dict[str, Change] = {
    "tracker-range-zero": _polar(_none, _none, lambda f, a, e, d: 1e-3 + 0 * d),
    "tracker-beam-offset": _polar(lambda f, a, e, d: f * 1e-3 / (d * np.cos(e)), _none, _none),
    "tracker-mirror-tilt": _polar(lambda f, a, e, d: f * 1e-6 / np.cos(e), _none, _none),
    "tracker-transit-tilt": _polar(lambda f, a, e, d: f * 1e-6 * np.tan(e), _none, _none),
    "tracker-vertical-index": _polar(_none, lambda f, a, e, d: f * 1e-6, _none),
    "tracker-azimuth-harmonic": _polar(lambda f, a, e, d: 1e-6 * np.cos(2 * a), _none, _none),
    "tracker-eccentricity": _polar(lambda f, a, e, d: f * 1e-6 * np.cos(a), _none, _none),
    "point-moved": point_moved,
    "station-moved": station_moved,
}


def in_order(net: Network) -> Network:
    """Return the network with its readings as they are made: station by station, forth in face 1 and back in face 2."""
    way = np.where(net.face == 1, net.point, -net.point)
    order = np.lexsort((way, net.face, net.station))
    rows = {name: getattr(net, name)[order] for name in ("station", "point", "face", "seen")}
    return replace(net, times=True, **rows)


def visible(net: Network, change: Array) -> float:
    """Return the norm of what the unknowns leave of a change, in standard deviations."""
    base = Dense(net)
    sigma = base.deviations()
    j = base.jacobian(base.width) / sigma[:, None]
    full = np.zeros(len(sigma))
    full[: change.size] = change.ravel()
    left, values, _ = np.linalg.svd(j, full_matrices=False)
    taken = left[:, values > 1e-9 * values[0]]
    g = full / sigma
    return float(np.linalg.norm(g - taken @ (taken.T @ g)))


def least(net: Network, folder: Path, name: str, where: dict[str, str]) -> float:
    """Return the strength of an effect that is found with 80 % power, inf if it is not tested."""
    tests = measurement_of(adjusted_job_of(load(net.write(folder))))
    for one in design(State.of(tests)).candidates:
        alternative = one.alternative
        if (alternative.effect.name, dict(alternative.where)) == (name, where) and one.testable:
            return float(np.sqrt(needed(tests, one.family, len(alternative.parameters))))
    return np.inf


def case(number: int, folder: Path) -> tuple[str, str]:
    """Return what was hidden in a case, and what was said."""
    rng = np.random.default_rng([77, number])
    net = in_order(network(rng, **MAKES[number % len(MAKES)]))
    hidden, where = "", dict[str, str]()
    if number % 3:
        names = list(CHANGES)
        hidden = names[(number // 3) % len(names)]
        where, change = CHANGES[hidden](net, rng)
        strength = visible(net, change)
        needs = least(net, folder, hidden, where)
        if strength < 1e-3 or not np.isfinite(needs):
            hidden = ""
        else:
            net = net.with_effect(change * rng.uniform(*LEAST_SIZES) * needs / strength)
    return words(diagnose(adjusted_job_of(load(net.write(folder)))), hidden, where)


def main(arguments: list[str]) -> int:
    """Print the cases that are not plainly right, then the rates; return 1 where a bar is not met."""
    count = int(arguments[0]) if arguments else COUNT
    with tempfile.TemporaryDirectory() as where:
        return print_rates((f"{n} ({MAKES[n % len(MAKES)]})", case(n, Path(where))) for n in range(count))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
