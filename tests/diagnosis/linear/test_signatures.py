"""The columns that an effect adds, found from its own link alone, against the whole chain linearised anew."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from benchmarks.hidden_effects import KINDS
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.linear import signatures
from metrocli.diagnosis.linear.candidates import Candidate
from metrocli.diagnosis.linear.families import instances
from metrocli.diagnosis.linear.linearised import linearised
from metrocli.diagnosis.linear.projection import scatter
from metrocli.effects.extension import can_act

ALL: dict[str, Callable[[], AdjustedJob]] = {kind: campaign.case(0).adjusted for kind, campaign in KINDS.items()}


@pytest.mark.parametrize("kind", ALL)
def test_columns_are_those_of_the_whole_chain(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    adjusted = ALL[kind]()
    system = linearised(adjusted.model)
    places = {
        (effect.name, effect.by): (effect, place)
        for effect in adjusted.effects
        if not effect.of_one_reading
        for place in instances(adjusted.model, effect)[-1:]
        if can_act(adjusted.model, effect, dict(zip(effect.keys, place, strict=True)))
    }
    assert len(places) >= 5
    fast = {}
    for anew in (False, True):
        if anew:
            monkeypatch.setattr(signatures, "columns_by_splicing", lambda *_: None)
        for key, (effect, place) in places.items():
            scanned = tuple((parameter.name, 3.0) for parameter in effect.scanned)
            columns = Candidate(effect, place, scanned).signature(system)
            if not anew:
                fast[key] = columns
            else:
                rounding = 1e-12 * np.abs(columns).max(initial=0.0)
                np.testing.assert_allclose(fast[key], columns, rtol=1e-12, atol=rounding)


@pytest.mark.parametrize("readings", [0, 4])
def test_derivatives_are_added_where_all_readings_use_one_column_and_where_they_do_not(readings: int) -> None:
    jacobian = np.arange(2.0 * 3 * readings).reshape(2, 3, readings)
    for columns in (np.tile([4, -1, 0], (readings, 1)), np.arange(3 * readings).reshape(readings, 3) % 5 - 1):
        full, expected = np.zeros((2, readings, 2, 5))
        scatter(full, jacobian, columns)
        for reading, parameter in np.ndindex(*columns.shape):
            if columns[reading, parameter] >= 0:
                expected[reading, :, columns[reading, parameter]] += jacobian[:, parameter, reading]
        assert np.array_equal(full, expected)
