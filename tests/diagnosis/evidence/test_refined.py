"""Scanned parameters are refined between the values that the scan tried."""

from types import SimpleNamespace

import numpy as np

from metrocli.diagnosis.evidence.refined import _Scan
from metrocli.diagnosis.linear.candidates import Candidate
from metrocli.tasks.adjust_network.effects import EFFECTS


def test_forms_of_a_cause_without_the_parameter_are_no_neighbours() -> None:
    """A point moved at a time, or from a station on: both stand in one family of `point-moved`."""
    by_time, by_station = (effect for effect in EFFECTS if effect.name == "point-moved")
    sizes = ("dx", "dy", "dz")
    tried = [Candidate(by_time, ("P1",), (("at", at),), sizes) for at in (100.0, 200.0, 300.0)]
    other = Candidate(by_station, ("P1",), (("from_station", 2.0),), sizes)
    times = np.arange(90.0, 330.0, 20.0)
    readings = SimpleNamespace(observations=SimpleNamespace(conditions={"t": times}))
    m = SimpleNamespace(
        families=[SimpleNamespace(alternatives=(*tried, other))],
        job=SimpleNamespace(model=SimpleNamespace(readings=[readings])),
    )
    scan = _Scan(SimpleNamespace(measurement=m), SimpleNamespace(family=0, number=1), "at")
    found = scan._between(tried[1])
    assert found.min() > 100
    assert found.max() < 300
