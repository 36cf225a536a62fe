"""Refractive index of air, by the equations of Ciddor 1996 and of Edlén as revised by Birch and Downs 1994.

Both are for the phase of light in moist air, that of Edlén with 450 ppm of carbon dioxide. The pressure of saturated
water vapour is that of IAPWS, over ice below 0 degC (Huang 1998; Stone and Zimmerman, NIST, Index of Refraction of Air,
appendix A).
"""

from __future__ import annotations

import numpy as np

from metrocli.arrays import Array
from metrocli.frozen import dataclass

CIDDOR, EDLEN = "ciddor", "edlen"
"""Names of the two equations"""
_KELVIN = 273.15
_PA_OF_HPA, _UM_OF_MM = 100.0, 1e3
STANDARD_CARBON_DIOXIDE = 450e-6
"""Part of carbon dioxide by volume of the air of both equations"""


@dataclass(frozen=True)
class Weather:
    """Temperature [degC], pressure [hPa] and relative humidity [percent] of the air, numbers or (n,)."""

    temperature: float | Array
    pressure: float | Array
    humidity: float | Array

    @property
    def vapour(self) -> Array:
        """Partial pressure of the water vapour [Pa]."""
        return np.asarray(np.asarray(self.humidity) / 100 * saturated(self.temperature))


def index(equation: str, weather: Weather, wavelength: float, carbon_dioxide: float = STANDARD_CARBON_DIOXIDE) -> Array:
    """Return the refractive index of the air for light of a vacuum wavelength [mm], by one of the two equations.

    Only Ciddor's has a term of the carbon dioxide.
    """
    if equation == EDLEN:
        return edlen(weather.temperature, weather.pressure, weather.vapour, wavelength)
    return ciddor(weather.temperature, weather.pressure, weather.vapour, wavelength, carbon_dioxide)


def saturated(temperature: float | Array) -> Array:
    """Return the pressure of saturated water vapour [Pa] at a temperature [degC] (IAPWS-IF97 eq. 30; over ice 1993)."""
    kelvin = np.asarray(temperature, dtype=float) + _KELVIN
    omega = kelvin - 0.238555575678 / (kelvin - 650.175348448)
    a = omega**2 + 1167.05214528 * omega - 724213.167032
    b = -17.0738469401 * omega**2 + 12020.8247025 * omega - 3232555.03223
    c = 14.9151086135 * omega**2 - 4823.26573616 * omega + 405113.405421
    over_water = 1e6 * (2 * c / (-b + np.sqrt(b**2 - 4 * a * c))) ** 4
    theta = kelvin / 273.16
    over_ice = 611.657 * np.exp(-13.928169 * (1 - theta**-1.5) + 34.7078238 * (1 - theta**-1.25))
    # both are evaluated everywhere: outside its range each is finite, and `where` drops it
    return np.asarray(np.where(kelvin < _KELVIN, over_ice, over_water))


def edlen(temperature: float | Array, pressure: float | Array, vapour: float | Array, wavelength: float) -> Array:
    """Return the refractive index by Edlén's equation (Birch and Downs 1994, Metrologia 31, 315, eq. 1 to 3).

    Temperature in degC, pressure in hPa, partial pressure of the vapour in Pa, vacuum wavelength in mm.
    """
    t, p = np.asarray(temperature, dtype=float), np.asarray(pressure, dtype=float) * _PA_OF_HPA
    s = (_UM_OF_MM * wavelength) ** -2
    standard = 1e-8 * (8342.54 + 2406147 / (130 - s) + 15998 / (38.9 - s))
    dry = standard * p / 96095.43 * (1 + 1e-8 * (0.601 - 0.00972 * t) * p) / (1 + 0.0036610 * t)
    return np.asarray(1 + dry - vapour * (3.7345 - 0.0401 * s) * 1e-10)


def ciddor(
    temperature: float | Array,
    pressure: float | Array,
    vapour: float | Array,
    wavelength: float,
    carbon_dioxide: float = STANDARD_CARBON_DIOXIDE,
) -> Array:
    """Return the refractive index by Ciddor's equations (Applied Optics 35, 1566, 1996, appendices A and B).

    Temperature in degC, pressure in hPa, partial pressure of the vapour in Pa, vacuum wavelength in mm, part of
    carbon dioxide by volume. `n - 1 = (rho_a / rho_as) (n_as - 1) + (rho_v / rho_vs) (n_vs - 1)`, rho the densities of
    dry air (a) and vapour (v). The standards (s) are dry air at 15 degC and 1013.25 hPa and
    vapour at 20 degC and 13.33 hPa.
    """
    t, p = np.asarray(temperature, dtype=float), np.asarray(pressure, dtype=float) * _PA_OF_HPA
    s = (_UM_OF_MM * wavelength) ** -2
    enhanced = 1.00062 + 3.14e-8 * p + 5.60e-7 * t**2
    moles = enhanced * vapour / p
    of_air = 1e-8 * (5792105 / (238.0185 - s) + 167917 / (57.362 - s))
    of_air *= 1 + 0.534 * (carbon_dioxide - STANDARD_CARBON_DIOXIDE)
    of_vapour = 1.022e-8 * (295.235 + 2.6422 * s - 0.032380 * s**2 + 0.004028 * s**3)
    density = p / (t + _KELVIN) / _compressibility(t, p, moles)
    dry_air = (1 - moles) * density / _standard_density(15.0, 101325.0, 0.0)
    vapours = moles * density / _standard_density(20.0, 1333.0, 1.0)
    return np.asarray(1 + dry_air * of_air + vapours * of_vapour)


def _compressibility(t: Array, p: Array, moles: Array) -> Array:
    """Return the compressibility of moist air (BIPM 1991; Davis 1992)."""
    ratio = p / (t + _KELVIN)
    first = 1.58123e-6 - 2.9331e-8 * t + 1.1043e-10 * t**2
    first = first + (5.707e-6 - 2.051e-8 * t) * moles + (1.9898e-4 - 2.376e-6 * t) * moles**2
    return np.asarray(1 - ratio * first + ratio**2 * (1.83e-11 - 0.765e-8 * moles**2))


def _standard_density(t: float, p: float, moles: float) -> float:
    """Return moles in a volume, times the gas constant, which all densities share."""
    return p / (t + _KELVIN) / float(_compressibility(np.array(t), np.array(p), np.array(moles)))
