"""Wrong readings, each with what is as likely instead: other readings, and effects at its place.

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.robust import as_likely
from metrocli.diagnosis.evidence.measurement import Measurement
from metrocli.diagnosis.evidence.parts import Fixed
from metrocli.diagnosis.evidence.state import State
from metrocli.diagnosis.linear.candidates import Candidate
from metrocli.frozen import dataclass

Places = Mapping[frozenset[tuple[str, str]], list[tuple[int, int]]]


@dataclass(frozen=True)
class Outlier:
    """A reading that is wrong (gross error)."""

    keys: Mapping[str, str]
    test: float
    """Its error in standard deviations, with all other findings in the model"""
    others: tuple[Mapping[str, str], ...] = ()
    """Readings whose error would explain the misfit about as well, the likeliest first"""
    effects: tuple[Candidate, ...] = ()
    """Effects at the place of the reading, such as a bad pose, that would explain it about as well"""


def wrong_readings(state: State) -> tuple[Outlier, ...]:
    """Return the wrong readings of a state, the largest first, each with the test of it beside all else."""
    places = _places(state.measurement) if state.readings else {}
    return tuple(sorted((_outlier(state, part, places) for part in state.readings), key=lambda outlier: -outlier.test))


def _outlier(state: State, part: Fixed, places: Places) -> Outlier:
    """Return a wrong reading with what would explain as much, beside all else."""
    m, taken = state.measurement, state.taken_by(part)
    keys, variance = m.keys_of(part.number), state.variance
    _, rank, explained = state.of_readings(taken)
    # an error of several components can always explain more: only readings of its rank compare
    squares = np.where(rank == rank[part.number], explained, 0.0) / variance
    own = float(squares[part.number])
    known = {other.number for other in state.readings}
    # capped at its own: `as_likely` compares with the largest of all
    rivals = [at for at in np.flatnonzero(as_likely(np.minimum(squares, own))).tolist() if at not in known]
    rivals.sort(key=lambda at: -squares[at])
    others = tuple(m.keys_of(at) for at in rivals)
    effects = tuple(_at_its_place(state, taken, places, keys, own))
    return Outlier(keys, float(np.sqrt(own)), others, effects)


def _places(m: Measurement) -> Places:
    """Return the alternatives of each place: family and number, by the names of what they act on."""
    places: dict[frozenset[tuple[str, str]], list[tuple[int, int]]] = {}
    for family, candidates in enumerate(m.families):
        for number, alternative in enumerate(() if candidates.unknown else candidates.alternatives):
            place = zip(alternative.effect.keys, alternative.instance, strict=True)
            places.setdefault(frozenset(place), []).append((family, number))
    return places


def _at_its_place(
    state: State, taken: Array, places: Places, keys: Mapping[str, str], own: float
) -> Iterator[Candidate]:
    """Yield the best form of each effect at the place of a reading that explains as much as the error of the reading.

    Where it also changes other readings, these contradict it unless they are much less certain.
    """
    # a reading of a tracer, a point and a pose lies at each of these, and at each combination
    here = [combination for size in range(1, len(keys) + 1) for combination in combinations(keys.items(), size)]
    families: dict[int, list[int]] = {}
    for place in here:
        for family, number in places.get(frozenset(place), ()):
            families.setdefault(family, []).append(number)
    for family, numbers in families.items():
        explained = state.of_family(family, taken)[0][numbers] / state.variance
        best = int(np.argmax(explained))
        if as_likely(np.array([own, explained[best]]))[1]:
            yield state.measurement.alternative((family, numbers[best]))
