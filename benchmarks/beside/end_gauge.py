"""The end gauge of JCGM 101, 9.5: its standard uncertainty and shortest 99 % interval, or its law of propagation."""

from __future__ import annotations

import importlib
from typing import Any

from benchmarks.beside.work import Values, Work

MODEL = "Ls + D + d1 + d2 - Ls*(da*(t0 + Delta) + as_*dt) - 50000000"
T = {"Ls": (50000623.0, 25.0, 18), "D": (215.0, 6.0, 24), "d1": (0.0, 4.0, 5), "d2": (0.0, 7.0, 8)}
"""Value, standard uncertainty [nm] and degrees of freedom of the t distributions"""


def ours(trials: int) -> Work:
    """metrocli's Monte Carlo method."""
    from benchmarks.uncertainty import ours as drawn

    return lambda: _listed(*drawn(trials))


def numpy(trials: int) -> Work:
    """A script of a dozen lines."""
    from benchmarks.uncertainty import plain_numpy

    return lambda: _listed(*plain_numpy(trials))


def suncal(trials: int) -> Work:
    """suncal's Monte Carlo method."""
    program: Any = importlib.import_module("suncal")
    model = program.Model(f"l = {MODEL}")
    for name, (value, std, dof) in T.items():
        model.var(name).measure(value).typeb(dist="t", scale=std, df=dof)
    model.var("as_").measure(11.5e-6).typeb(dist="uniform", a=2e-6)
    model.var("t0").measure(-0.1).typeb(dist="normal", unc=0.2, k=1)
    model.var("Delta").measure(0).typeb(dist="arcsine", a=0.5)
    model.var("da").measure(0).typeb(dist="curvtrap", a=1e-6, d=1e-7)
    model.var("dt").measure(0).typeb(dist="curvtrap", a=0.05, d=0.025)

    def run() -> Values:
        import numpy as np

        y = np.sort(np.asarray(model.monte_carlo(samples=trials).samples["l"], dtype=float))
        inside = round(0.99 * trials)
        first = int(np.argmin(y[inside:] - y[:-inside]))
        return _listed(float(y.std()), float(y[first]), float(y[first + inside]))

    return run


def ours_propagated(_: int) -> Work:
    """metrocli's law of propagation, first order."""
    from benchmarks.uncertainty import gauge
    from metrocli.expressions.expression import parse
    from metrocli.uncertainty.propagation import propagate

    def run() -> Values:
        found = propagate({"l": parse(MODEL)}, gauge()).measurands["l"]
        return [(found.value, 0.0), (found.std, 0.0)]

    return run


def gtc(_: int) -> Work:
    """GTC's uncertain numbers."""
    program: Any = importlib.import_module("GTC")

    def run() -> Values:
        known = {name: program.ureal(*each) for name, each in T.items()}
        known |= {
            "as_": program.ureal(11.5e-6, program.tb.uniform(2e-6)),
            "t0": program.ureal(-0.1, 0.2),
            "Delta": program.ureal(0, program.tb.arcsine(0.5)),
            "da": program.ureal(0, (_trapezoid(1e-6, 1e-7))),
            "dt": program.ureal(0, (_trapezoid(0.05, 0.025))),
        }
        found = eval(MODEL, known)
        return [(float(found.x), 0.0), (float(found.u), 0.0)]

    return run


def _trapezoid(half: float, inexact: float) -> float:
    """Return the standard deviation of a curvilinear trapezoid (JCGM 101, 6.4.3.4)."""
    return float((half**2 / 3 + inexact**2 / 9) ** 0.5)


def _listed(std: float, low: float, high: float) -> Values:
    # by how much two runs of a million trials differ (JCGM 101, 9.5.2 prints whole nanometres)
    return [(std, 0.05), (low, 0.5), (high, 0.5)]
