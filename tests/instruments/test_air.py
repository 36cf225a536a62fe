"""The refractive index of air against published values.

Sources: Ciddor, Applied Optics 35, 1566 (1996), tables 1 to 3, as the test files of two public programs quote them (the paper's last
digit is 1e-9). NIST, Engineering Metrology Toolbox, Index of Refraction of Air: values for checking programs, both
equations, as the tests of two other public programs quote them. NIST multiplies the vapour term of Birch and Downs by
292.75 K/T; the equation of 1994 does not, so the test does it here.
"""

from __future__ import annotations

import pytest

from metrocli.instruments.air import Weather, ciddor, edlen, index, saturated

NM, HPA_OF_KPA = 1e-6, 10.0
NIST = [
    # degC, percent, kPa, nm, Ciddor, modified Edlén
    (20, 0, 101.325, 633, 1.000271800, 1.000271799),
    (20, 0, 60, 633, 1.000160924, 1.000160920),
    (20, 0, 120, 633, 1.000321916, 1.000321918),
    (50, 0, 100, 633, 1.000243285, 1.000243270),
    (5, 0, 100, 633, 1.000282756, 1.000282750),
    (-40, 0, 100, 633, 1.000337580, 1.000337471),
    (50, 100, 120, 633, 1.000287924, 1.000287864),
    (40, 75, 120, 633, 1.000299418, 1.000299406),
    (20, 100, 100, 633, 1.000267394, 1.000267394),
    (40, 100, 110, 1700, 1.000270247, 1.000270237),
    (20, 0, 101.325, 1700, 1.000268479, 1.000268483),
    (40, 100, 110, 300, 1.000289000, 1.000288922),
    (20, 0, 101.325, 300, 1.000286581, 1.000286579),
    (-40, 0, 120, 300, 1.000427233, 1.000427072),
]  # fmt: skip
DRY = [(20, 80, 21458.0), (20, 100, 26824.4), (20, 120, 32191.6), (10, 100, 27774.7), (30, 100, 25937.2)]
"""Table 1 at 633 nm: degC, kPa, 1e8 (n - 1)"""
MOIST = [
    # degC, Pa, vapour in Pa, ppm of CO2; the second row of the table is left out, since its copies differ
    (19.526, 102094.8, 1065, 510, 27392.9),
    (19.173, 102993.0, 641, 450, 27682.4),
    (19.173, 103006.0, 642, 440, 27685.8),
    (19.188, 102918.8, 706, 450, 27658.7),
    (19.189, 102927.8, 708, 440, 27660.8),
    (19.532, 103603.2, 986, 600, 27802.0),
    (19.534, 103596.2, 962, 600, 27800.8),
    (19.534, 103599.2, 951, 610, 27802.2),
]  # fmt: skip
"""Table 2 at 633 nm"""
EXTREME = [
    # degC, kPa, percent; 19896.5 is printed as 19996.5, against the paper's own column of differences
    (20, 80, 75, 21394.0), (20, 120, 75, 32127.8), (40, 80, 75, 19896.5),
    (40, 120, 75, 29941.8), (50, 80, 100, 19058.4), (50, 120, 100, 28792.4),
]  # fmt: skip
"""Table 3 at 633 nm"""


@pytest.mark.parametrize("row", NIST, ids=str)
def test_both_equations_give_the_values_of_nist(row: tuple[float, ...]) -> None:
    t, humidity, p, light, by_ciddor, by_edlen = row
    weather, dry = (Weather(t, HPA_OF_KPA * p, h) for h in (humidity, 0.0))
    assert index("ciddor", weather, light * NM) == pytest.approx(by_ciddor, abs=1e-9, rel=0)
    without = index("edlen", dry, light * NM)
    modified = without - (without - index("edlen", weather, light * NM)) * 292.75 / (t + 273.15)
    assert modified == pytest.approx(by_edlen, abs=1e-9, rel=0)


def test_ciddors_own_tables_are_met_within_their_last_digit() -> None:
    rows = [(ciddor(t, HPA_OF_KPA * p, 0.0, 633 * NM), value) for t, p, value in DRY]
    rows += [(ciddor(t, p / 100, vapour, 633 * NM, 1e-6 * co2), value) for t, p, vapour, co2, value in MOIST]
    rows += [(index("ciddor", Weather(t, HPA_OF_KPA * p, h), 633 * NM), value) for t, p, h, value in EXTREME]
    for found, value in rows:
        assert 1e8 * (found - 1) == pytest.approx(value, abs=0.1)


def test_edlens_equation_near_what_birch_and_downs_measured() -> None:
    """Their measurements, quoted in table 2 of Ciddor with an uncertainty of 3e-8; CO2 is 450 ppm in the equation."""
    assert 1e8 * (edlen(19.526, 1020.948, 1065.0, 633 * NM) - 1) == pytest.approx(27392.3, abs=3)
    assert 1e8 * (edlen(19.188, 1029.188, 706.0, 633 * NM) - 1) == pytest.approx(27659.1, abs=3)


def test_saturated_vapour_at_the_fixed_points_of_iapws() -> None:
    """IAPWS-IF97 table 35: 0.353658941e-2 MPa at 300 K; over ice 611.657 Pa at 273.16 K (Wagner et al. 1994)."""
    assert saturated(300 - 273.15) == pytest.approx(3536.58941, rel=1e-8)
    assert saturated(-1e-9) == pytest.approx(611.15, rel=1e-3)
    assert saturated(-1e-9) == pytest.approx(float(saturated(0.0)), rel=2e-4)


def test_figures_of_the_page_on_air() -> None:
    def at(t: float = 20.0, p: float = 1013.25, h: float = 50.0, equation: str = "ciddor") -> float:
        return 1e6 * float(index(equation, Weather(t, p, h), 632.99 * NM))

    assert at(20.5) - at(19.5) == pytest.approx(-0.95, abs=0.005)
    assert at(p=1013.75) - at(p=1012.75) == pytest.approx(0.27, abs=0.005)
    assert at(h=50.5) - at(h=49.5) == pytest.approx(-0.0085, abs=1e-4)
    more = 1e6 * float(index("ciddor", Weather(20.0, 1013.25, 50.0), 632.99 * NM, 550e-6)) - at()
    assert more == pytest.approx(0.014, abs=5e-4)
    for t, h, apart in ((16, 50, 0.0), (24, 50, 0.0), (40, 75, 0.131)):
        change = (at(t, h=0.0, equation="edlen") - at(t, h=h, equation="edlen")) * (1 - 292.75 / (t + 273.15))
        assert change == pytest.approx(apart, abs=0.01)
