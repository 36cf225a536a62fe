"""Statements of an uncertainty budget, from draws of what goes into it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from benchmarks.apart.model import Array
from benchmarks.apart.statement import Rng, Simulated, Statement, of_share, of_spread, of_value

_TRIALS = 1_000_000


def gauge_block(rng: Rng, dof: bool) -> Array:
    """Draw the length of GUM H.1 [mm].

    With `dof` a standard uncertainty of few degrees of freedom is that of a t variable, and half-widths are inexact by
    the share `1/sqrt(2 dof)` (JCGM 100, G.3; JCGM 101, 6.4.3).
    """

    def normal(std: float, degrees: float) -> Array:
        return np.asarray(std * (rng.standard_t(degrees, _TRIALS) if dof else rng.normal(size=_TRIALS)))

    def uniform(half: float, degrees: float = np.inf) -> Array:
        inexact = rng.uniform(-1, 1, _TRIALS) / np.sqrt(2 * degrees) if dof else 0.0
        return np.asarray(rng.uniform(-half, half, _TRIALS) * (1 + inexact))

    ls = 50.000623 + normal(25e-6, 18)
    d = 215e-6 + normal(5.8e-6, 24) + normal(3.9e-6, 5) + normal(6.7e-6, 8)
    bed = -0.1 + rng.normal(0, 0.2, _TRIALS) + 0.5 * np.sin(rng.uniform(-np.pi, np.pi, _TRIALS))
    alpha = 11.5e-6 + uniform(2e-6)
    return np.asarray(ls + d - ls * (uniform(1e-6, 50) * bed + alpha * uniform(0.05, 2)))


def budget(place: str, facts: Mapping[str, Any], shares: Mapping[str, float]) -> Iterable[Statement]:
    """Yield the statements on the gauge block: coverage of k, of U, intervals, conformity, shares of the variance."""
    kind, trials = "report-uncertainty", facts["mc"]

    def of_k(rng: Rng) -> Simulated:
        spread = np.sqrt(rng.chisquare(facts["dof"], _TRIALS) / facts["dof"])
        inside = int((np.abs(rng.normal(size=_TRIALS)) < facts["k"] * spread).sum())
        return of_share(inside, _TRIALS, facts["probability"], facts["probability"])

    words = f"probability of k = {facts['k']:.3f} with {facts['dof']:.2f} degrees of freedom"
    yield Statement(kind, place, words, f"{facts['probability']:.2%}", of_k)

    def share_of_drawn(low: float, high: float, p: float) -> Callable[[Rng], Simulated]:
        # the program's own share has the scatter of its trials
        own = 4 * np.sqrt(p * (1 - p) / trials["trials"])

        def simulated(rng: Rng) -> Simulated:
            drawn = gauge_block(rng, dof=True)
            return of_share(int(((drawn > low) & (drawn < high)).sum()), _TRIALS, p - own, p + own)

        return simulated

    covered = trials["covered"]
    of_covered = share_of_drawn(*facts["interval"], covered)
    yield Statement(kind, place, "share of trials that U covers", f"{covered:.3%}", of_covered)
    p = facts["probability"]
    for name in ("interval", "shortest"):
        claim = f"the {'shortest ' * (name == 'shortest')}interval of Monte Carlo has"
        yield Statement(kind, place, claim, f"{p:.0%}", share_of_drawn(*trials[name], p))
    conforming = facts["tolerance"]["conformance_mc"]
    yield Statement(
        kind, place, "probability of conformity", f"{conforming:.5f}",
        share_of_drawn(*facts["tolerance"]["limits"], conforming),
    )  # fmt: skip
    second = facts["second_order"]["std"]
    yield Statement(
        kind, place, "standard uncertainty of the second order", f"{1e6 * second:.2f} nm",
        lambda rng: of_spread(gauge_block(rng, dof=False), second),
    )  # fmt: skip
    parts = {"ls": 25e-6, "d_theta": 50.000623 * 11.5e-6 * 0.05 / np.sqrt(3), "d2": 6.7e-6, "d": 5.8e-6, "d1": 3.9e-6}
    parts |= {"d_alpha": 50.000623 * 0.1 * 1e-6 / np.sqrt(3)}
    total = sum(part**2 for part in parts.values())
    for name, part in parts.items():
        text, share = f"{shares[name]:.2%}", part**2 / total
        yield Statement(
            kind, place, f"share of {name} in the variance", text,
            lambda _, share=share, name=name: of_value(share, shares[name]),
        )  # fmt: skip
