"""What a planned network will determine, what it cannot see, and where further stations would stand best."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import product
from types import MappingProxyType

import numpy as np

from metrocli.adjust.adjustment import covariance_at
from metrocli.adjust.solution import Solution, residuals_of
from metrocli.arrays import Array, Index
from metrocli.effects.effect import Effect
from metrocli.effects.extension import can_act, with_conditions, with_effect
from metrocli.effects.requested import RequestedEffect
from metrocli.errors import InputError, UndeterminedError
from metrocli.instruments import tracer as t
from metrocli.plan import Plan
from metrocli.result import Estimate, ShownTable
from metrocli.table import Table
from metrocli.tasks.adjust_network import KIND
from metrocli.tasks.adjust_network.effects import STEERING
from metrocli.tasks.adjust_network.problem import Network
from metrocli.tasks.adjust_network.settings import INTERFEROMETER, Files, NetworkSimulation, Settings
from metrocli.tasks.adjust_network.simulation import designed, true_network
from metrocli.tasks.adjust_network.unknowns import seen_points
from metrocli.tasks.adjust_network.usual import of_instrument
from metrocli.tasks.shared.tracker_effects import TRACKER_EFFECTS
from metrocli.units import find_unit, roughly, two_digits

_GRID = 4
"""Places along each side of the region that are tried"""
_SEED = 1
_MARGIN = 0.1
_INSTRUMENT = "instrument"
_UP = "up"
_ON_ITS_SIDE = {"x": np.pi / 2, "y": np.pi}
"""Standing axes of an instrument on its side, each with its gamma"""
_BLIND = 100.0
"""Standard deviations of an effect, in its largest usual size, from which the network cannot see it"""


def planned(settings: Settings, files: Files, effects: tuple[RequestedEffect, ...]) -> Plan:
    """Return what the stations of the list will determine, and where further ones would stand best.

    Raises InputError without points or places of stations, UndeterminedError if the network is not determined.
    """
    requested = settings.plan
    truth = NetworkSimulation(faces=1 if requested is None else requested.faces)
    network = _network(settings, files, truth, effects)
    solution = _solution(network)
    seen = tuple(_seen(network))
    tables = {"points": _points(network, solution), "effects": Table.of_rows(_HEAD, [row[:-1] for row in seen])}
    notes = [*_quality(network, solution), *_blind(seen)]
    if requested is not None and requested.region is not None:
        chosen, table = _further(settings, files, truth, effects)
        tables["candidates"] = table
        notes += chosen
    return Plan(KIND.name, tuple(notes), tuple(_figures(network, solution)), tables, shown=(ShownTable("effects"),))


_HEAD = ("effect [text]", "instrument [text]", "std", "unit [text]", "usual [text]", "seen")


def _network(
    settings: Settings,
    files: Files,
    truth: NetworkSimulation,
    effects: tuple[RequestedEffect, ...],
    axes: Mapping[str, str] = MappingProxyType({}),
) -> Network:
    """Return the network at its truth; `axes` has the standing axes of its further stations."""
    rolled = {station: _ON_ITS_SIDE[axis] for station, axis in axes.items() if axis != _UP}
    network = true_network(settings, designed(settings, files, truth), np.random.default_rng(_SEED), rolled)
    return network.with_effects(effects)


def _solution(network: Network) -> Solution:
    model = network.model
    solution = covariance_at(model.blocks.values(), list(model.groups), model.datum)
    if not solution.outcome.good:
        lines = [f"  {combination}" for combination in solution.undetermined[:8]]
        raise UndeterminedError("\n".join([solution.outcome.value, *lines]))
    return solution


def _read(network: Network) -> Index:
    """Return the numbers of the points that a reading concerns: others are no unknowns, with a variance of 0."""
    return np.flatnonzero(seen_points(network.readings))


def _points(network: Network, solution: Solution) -> Table:
    block, read = solution.blocks[t.POINT], _read(network)
    places, std = block.values[read], solution.std(t.POINT)[read]
    return Table.of({"point": np.array(block.members)[read], "x y z [mm]": places, "sx sy sz [mm]": std})


def _worth(network: Network, solution: Solution, aim: str) -> float:
    """Return the root mean square standard uncertainty that a plan makes small: of coordinates, or of distances."""
    if aim == "pairs":
        return _of_pairs(network, solution)
    std = solution.std(t.POINT)[_read(network)]
    return float(np.sqrt((std**2).mean()))


def _of_pairs(network: Network, solution: Solution) -> float:
    """Return the root mean square standard uncertainty of the distances of all pairs of points."""
    block = solution.blocks[t.POINT]
    n = len(block.members)
    joint = solution.covariance_or_raise().of(t.POINT).reshape(n, 3, n, 3)
    read = _read(network)
    first, second = (read[ends] for ends in np.triu_indices(len(read), 1))
    away = block.values[first] - block.values[second]
    unit = away / np.linalg.norm(away, axis=1)[:, None]
    own = joint[np.arange(n), :, np.arange(n)]
    between = joint[first, :, second]
    whole = own[first] + own[second] - between - np.swapaxes(between, 1, 2)
    return float(np.sqrt(np.einsum("na,nab,nb->n", unit, whole, unit).mean()))


def _quality(network: Network, solution: Solution) -> Iterator[str]:
    std = solution.std(t.POINT)
    worst = int(np.argmax(std.max(axis=1)))
    name = solution.blocks[t.POINT].members[worst]
    typical = roughly(_worth(network, solution, "points"), "um")
    yield f"points: {typical} (standard uncertainty of a coordinate, root mean square)"
    yield f"  the least certain is {name}: {roughly(float(std[worst].max()), 'um')}"
    least = min(
        float(residuals_of(solution, group).redundancy.min()) for group in solution.groups if group.observations.count
    )
    yield f"  least redundancy of a reading: {least:.2f}"


def _seen(network: Network) -> Iterator[tuple[object, ...]]:
    """Yield how well the network determines each error of each instrument, beside all its unknowns.

    The rows have the columns of `_HEAD`, then the standard deviation in the largest usual size of the effect.
    """
    model = with_conditions(network.model)
    for effect in TRACKER_EFFECTS:
        if effect.name == STEERING:
            continue
        for name, instrument in network.readings.instruments.items():
            at = of_instrument(replace(effect, where=("instrument",)), instrument)
            if instrument.type != INTERFEROMETER and can_act(model, at, {"instrument": name}):
                yield from _of_effect(network, at, name)


def _of_effect(network: Network, effect: Effect, name: str) -> Iterator[tuple[object, ...]]:
    model = with_effect(with_conditions(network.model), effect, [(name,)], {})
    solution = covariance_at(model.blocks.values(), list(model.groups), model.datum)
    block = model.added[-1].block
    for k, parameter in enumerate(effect.parameters):
        std = float(solution.std(block)[-1, k]) if solution.outcome.good else float("inf")
        seen = std < effect.plausible
        label = f"{effect.name}.{parameter.name}"
        # in the unit of the usual sizes beside it
        unit = effect.usual.rpartition(" ")[2] if parameter.dimension else parameter.unit
        size = find_unit(unit, parameter.dimension).outside(std) if parameter.dimension else std
        yield label, name, size, unit, effect.usual, seen, std / effect.plausible


def _blind(seen: tuple[tuple[object, ...], ...]) -> Iterator[str]:
    names = list(dict.fromkeys(str(row[0]).partition(".")[0] for row in seen if not row[5]))
    if names:
        yield f"the network cannot see: {', '.join(names)} (table effects)"
    if "tracker-scale" in names:
        yield "  the scale of a single instrument needs a bar, given points or an interferometer"


def _figures(network: Network, solution: Solution) -> Iterator[Estimate]:
    yield Estimate("points", 0.0, _worth(network, solution, "points"), "mm")
    few = len(solution.blocks[t.POINT].members) < 500
    yield Estimate("pairs", 0.0, _of_pairs(network, solution) if few else float("nan"), "mm")


def _further(
    settings: Settings, files: Files, truth: NetworkSimulation, effects: tuple[RequestedEffect, ...]
) -> tuple[list[str], Table]:
    """Return where further stations stand best: each is the best of a grid beside those before it."""
    requested = settings.plan
    assert requested is not None and requested.region is not None
    low, high = np.array(requested.region.low), np.array(requested.region.high)
    margin = _MARGIN * (high - low)
    sides = [np.linspace(a + m, b - m, _GRID) for a, b, m in zip(low, high, margin, strict=True)]
    instrument = settings.of_further_stations
    if instrument is None:
        raise InputError("a further station needs a tracker or a total station among `instruments`")
    tried = (_UP, *_ON_ITS_SIDE) if requested.rolled else (_UP,)
    axes: dict[str, str] = {}
    lines, rows = [], []
    for number in range(requested.stations):
        name = f"NEW{number + 1}"
        best: tuple[float, Array, str] | None = None
        for place in map(np.array, product(*sides)):
            more = _with_station(files, name, instrument, place)
            for axis in tried:
                try:
                    worth = _value(_network(settings, more, truth, effects, {**axes, name: axis}), requested.aim)
                except UndeterminedError:
                    continue
                rows.append((name, *place.tolist(), worth, *((axis,) if requested.rolled else ())))
                if best is None or worth < best[0]:
                    best = worth, place, axis
        if best is None:
            break
        worth, place, axis = best
        files, axes[name] = _with_station(files, name, instrument, place), axis
        at = ", ".join(f"{coordinate:.0f}" for coordinate in place)
        stands = "" if axis == _UP else f", on its side with its standing axis along {axis}"
        size = (
            f"{two_digits(100 * worth)} % of the largest usual errors"
            if requested.aim == _INSTRUMENT
            else roughly(worth, "um")
        )
        lines.append(f"a further station at ({at}) mm{stands}: {requested.aim} {size}")
    head = ("station [text]", "x [mm]", "y [mm]", "z [mm]", "worth", *(("axis [text]",) if requested.rolled else ()))
    return lines, Table.of_rows(head, rows)


def _value(network: Network, aim: str) -> float:
    """Return what a plan makes small; for the instrument the mean square of its errors in their usual sizes."""
    solution = _solution(network)
    if aim != _INSTRUMENT:
        return _worth(network, solution, aim)
    shares = [float(str(row[-1])) for row in _seen(network)]
    return float(np.sqrt(np.mean(np.minimum(shares, _BLIND) ** 2))) if shares else float("inf")


def _with_station(files: Files, name: str, instrument: str, place: Array) -> Files:
    """Return the files with one more station; its sightings are planned with the others."""
    new = {"station": np.array([name]), "instrument": np.array([instrument])}
    new |= {axis: np.array([value]) for axis, value in zip("xyz", place, strict=True)}
    return replace(files, stations=files.stations.extended(new))
