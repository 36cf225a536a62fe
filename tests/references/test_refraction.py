"""Coefficients of the refractive index of air that the effects quote, from Edlen's equation as Birch and Downs have it."""

from __future__ import annotations

import re

import numpy as np
import pytest

from metrocli.tasks.locate_launch_unit.effects import EFFECTS as OF_LAUNCH_UNITS
from metrocli.tasks.multilaterate.effects import EFFECTS as OF_NETWORKS

WAVELENGTH = 0.633  # um


def index(t: float, p: float, f: float) -> float:
    """n - 1 at t in degC, p and the vapour pressure f in Pa (Birch and Downs 1994, equations 1 to 3)."""
    s = 1 / WAVELENGTH**2
    standard = 1e-8 * (8342.54 + 2406147 / (130 - s) + 15998 / (38.9 - s))
    dry = p * standard / 96095.43 * (1 + 1e-8 * (0.601 - 0.00972 * t) * p) / (1 + 0.0036610 * t)
    return dry - f * (3.7345 - 0.0401 * s) * 1e-10


def vapour(t: float, humidity: float) -> float:
    """Vapour pressure in Pa (Magnus formula)."""
    return humidity * 611.2 * float(np.exp(17.62 * t / (243.12 + t)))


def test_the_formula_gives_the_index_of_standard_air() -> None:
    assert index(20, 101325, 0) == pytest.approx(2.718e-4, abs=1e-7)


@pytest.mark.parametrize("effects", [OF_NETWORKS, OF_LAUNCH_UNITS], ids=["multilaterate", "locate-launch-unit"])
def test_the_quoted_coefficients_are_those_of_the_equation(effects) -> None:  # type: ignore[no-untyped-def]
    quoted = next(effect.source for effect in effects if "Birch and Downs" in effect.source)
    relative, constant, pressure = (float(number) for number in re.findall(r"([+-]0[.]\d+) ppm/", quoted))
    p, f = 101325.0, vapour(20, 0.5)
    at_constant_humidity = 1e6 * (index(20.5, p, vapour(20.5, 0.5)) - index(19.5, p, vapour(19.5, 0.5)))
    at_constant_vapour = 1e6 * (index(20.5, p, f) - index(19.5, p, f))
    assert at_constant_humidity == pytest.approx(relative, abs=0.003)
    assert at_constant_vapour == pytest.approx(constant, abs=0.003)
    assert 1e6 * (index(20, p + 50, f) - index(20, p - 50, f)) == pytest.approx(pressure, abs=0.002)
