"""The laws that every effect obeys, tested at its link: 0 at 0, each parameter changes something, exact derivatives."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from metrocli.adjust.model.blocks import Array, Block
from metrocli.adjust.model.chain import Link, Local, Step
from metrocli.adjust.model.observations import Observations
from metrocli.effects.acting import Acting
from metrocli.effects.effect import Effect, Parameter

_N = 16
_STEP = 1e-3
"""Step of the differences, as a share of the plausible size"""
_AGREES = 1e-6
_SAMPLE = {"axis": "x", "pair": "xy"}


class _Conditions(dict[str, Array]):
    """Conditions of readings: any name has values, between 0.1 and 1."""

    def __missing__(self, name: str) -> Array:
        self[name] = np.random.default_rng(len(self)).uniform(0.1, 1.0, _N)
        return self[name]


def broken(effect: Effect, places: Sequence[Acting]) -> Iterator[str]:
    """Yield a sentence for each law that an effect breaks, for a kind of job with these places to act."""
    for what in ("cause", "source", "reveal"):
        if not getattr(effect, what) and not effect.definition:
            yield f"it has no {what}"
    if not all(one.plausible > 0 for one in effect.parameters):
        yield "a plausible size is not above zero"
    if effect.link is None:
        return
    link = effect.link("own", {key: _name(key, places) for key in effect.keys})
    size = next((len(one.components) for one in places if one.quantity is link.takes), 0)
    if link.takes is not link.gives or not size:
        yield f"it acts on {link.takes.value if link.takes else 'nothing'}, which this kind of job does not have"
    elif tuple(link.blocks) == ("own",):
        yield from _of_link(effect, link, size)


def _name(key: str, places: Sequence[Acting]) -> str:
    split = next((one.split[key] for one in places if key in one.split), {})
    return _SAMPLE.get(key) or next(iter(split), key)


def _of_link(effect: Effect, link: Link, size: int) -> Iterator[str]:
    value = np.random.default_rng(3).uniform(0.2, 0.9, (size, _N))
    conditions = _Conditions()
    plain = {one.name: 0.5 * one.plausible for one in effect.parameters}
    scanned = {one.name: _middle(one, conditions) for one in effect.scanned}

    def step(sizes: Mapping[str, float], at: Array = value, move: Array | None = None) -> Step:
        row = np.array([[*sizes.values(), *scanned.values()]])
        names = tuple(one.name for one in effect.all_parameters)
        block = Block("own", row, names, space=effect.space)
        block = block if move is None else block.moved(move)
        observations = Observations(np.zeros((size, _N)), np.ones(1), conditions=conditions)
        return link.step(at, Local({"own": block}, observations, frozenset({"own"})))

    if not np.allclose(step(dict.fromkeys(plain, 0.0)).value, value, rtol=0, atol=1e-12):
        yield "it is not 0 where all its parameters are 0"
    here = step(plain)
    for number, one in enumerate(effect.parameters):
        move = np.zeros((1, len(effect.all_parameters)))
        move[0, number] = _STEP * one.plausible
        change = (step(plain, move=move).value - step(plain, move=-move).value) / (2 * move[0, number])
        stated = np.broadcast_to(here.by_block["own"][:, number], change.shape)
        if not np.abs(change).max() > 0:
            yield f"its parameter '{one.name}' changes nothing"
        elif np.abs(change - stated).max() > 1e3 * _STEP**2 * np.abs(change).max() + _AGREES * np.abs(change).max():
            yield f"its derivative by '{one.name}' is not that of its values"
    for number in range(size):
        move = np.zeros((size, 1))
        move[number] = _STEP
        change = (step(plain, value + move).value - step(plain, value - move).value) / (2 * _STEP)
        by_input = np.zeros((size, size, 1)) if here.by_input is None else here.by_input
        stated = np.broadcast_to(by_input[:, number], change.shape)
        if np.abs(change - stated).max() > 1e3 * _STEP**2 + _AGREES:
            yield "its derivative by the quantity on which it acts is not that of its values"
            return


def _middle(parameter: Parameter, conditions: Mapping[str, Array]) -> float:
    if parameter.grid is None:
        return 1.0
    values = parameter.grid(conditions)
    return float(values[len(values) // 2])
