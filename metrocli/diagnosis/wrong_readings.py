"""Wrong readings, each with what is as likely instead: other readings, and effects at its place.

Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Mask
from metrocli.adjust.robust import as_likely
from metrocli.diagnosis.evidence.measurement import Measurement
from metrocli.diagnosis.evidence.parts import Fixed
from metrocli.diagnosis.evidence.prices import gain_of_columns
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
    """Return a wrong reading with what would explain as much in its place, beside all else."""
    m, taken = state.measurement, state.taken_by(part)
    keys = m.keys_of(part.number)
    _, rank, explained = state.of_readings(taken)
    # an error of several components can always explain more: only readings of its rank compare
    explained = np.where(rank == rank[part.number], explained, 0.0)
    own = float(explained[part.number])
    known = [other.number for other in state.readings]
    instead = _instead(state, part, own, explained, state.of_readings()[2])
    instead[known] = False
    rivals = np.flatnonzero(instead)
    others = tuple(m.keys_of(at) for at in rivals[np.argsort(-explained[rivals], kind="stable")].tolist())
    effects = tuple(_at_its_place(state, part, taken, places, own))
    return Outlier(keys, float(np.sqrt(own / state.variance)), others, effects)


def _instead(state: State, part: Fixed, own: float, explained: Array, beside: Array) -> Mask:
    """Return which of others explain as much as a wrong reading, and leave it nothing to explain.

    `own` is the squares that the reading explains, `explained` those of each other without it, `beside` with it. One
    that explains something else explains as much with it: both are wrong then, or the other is due to chance.
    """
    # capped at its own: `as_likely` compares with the largest of all
    alike = as_likely(np.append(np.minimum(explained, own), own) / state.variance)[:-1]
    # both together explain own + beside, in either order
    still = np.maximum(own + beside - explained, 0.0)
    gain = gain_of_columns(still, np.array(part.rank), state.fit.squares + own - explained, state.freedoms)
    return alike & (gain < part.price)


def _places(m: Measurement) -> Places:
    """Return the alternatives of each place: family and number, by the names of what they act on."""
    places: dict[frozenset[tuple[str, str]], list[tuple[int, int]]] = {}
    for family, candidates in enumerate(m.families):
        for number, alternative in enumerate(() if candidates.unknown else candidates.alternatives):
            place = zip(alternative.effect.keys, alternative.instance, strict=True)
            places.setdefault(frozenset(place), []).append((family, number))
    return places


def _at_its_place(state: State, part: Fixed, taken: Array, places: Places, own: float) -> Iterator[Candidate]:
    """Yield the best form of each effect at the place of a reading that explains as much as the error of the reading.

    Where it also changes other readings, these contradict it unless they are much less certain.
    """
    keys = state.measurement.keys_of(part.number)
    # a reading of a tracer, a point and a pose lies at each of these, and at each combination
    here = [combination for size in range(1, len(keys) + 1) for combination in combinations(keys.items(), size)]
    families: dict[int, list[int]] = {}
    for place in here:
        for family, number in places.get(frozenset(place), ()):
            families.setdefault(family, []).append(number)
    for family, numbers in families.items():
        explained, beside = (state.of_family(family, without)[0][numbers] for without in (taken, None))
        best = int(np.argmax(explained))
        if _instead(state, part, own, explained, beside)[best]:
            yield state.measurement.alternative((family, numbers[best]))
