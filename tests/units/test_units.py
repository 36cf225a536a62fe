"""Units: a golden list of texts, each right or refused with a hint."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from texts import texts

from metrocli import units
from metrocli.units import QuantityError, parse_quantity

RIGHT = [
    ("0.1 mm", "length", 0.1), ("0.1mm", "length", 0.1), ("1 m", "length", 1000.0), ("0.1 um", "length", 1e-4),
    ("0.1 µm", "length", 1e-4), ("0.1 \u03bcm", "length", 1e-4), ("25 nm", "length", 2.5e-5), ("-.5 mm", "length", -0.5),
    ("1e-3 m", "length", 1.0), ("+2.5E+1 um", "length", 0.025), ("  3 mm ", "length", 3.0), ("633 nm", "wavelength", 6.33e-4),
    ("20 arcsec", "angle", math.pi / 32400), ("90 deg", "angle", math.pi / 2), ("90°", "angle", math.pi / 2),
    ("1 arcmin", "angle", math.pi / 10800), ("5 urad", "angle", 5e-6), ("5 µrad", "angle", 5e-6), ("3 mrad", "angle", 3e-3),
    ("6.15 mm/m", "slope", 6.15e-3), ("0.1 um/m", "ratio", 1e-7), ("0.1 µm/m", "ratio", 1e-7), ("2 ppm", "ratio", 2e-6),
    ("2 %", "ratio", 0.02), ("20.5 degC", "temperature", 20.5), ("20.5 °C", "temperature", 20.5), ("0 K", "temperature", -273.15),
    ("0.5 K", "temperature difference", 0.5), ("3 mK", "temperature difference", 3e-3), ("11.5e-6 1/K", "expansion", 11.5e-6),
    ("11.5 um/m/K", "expansion", 11.5e-6), ("11.5 ppm/K", "expansion", 11.5e-6), ("1013.25 hPa", "pressure", 1013.25),
    ("101325 Pa", "pressure", 1013.25), ("50 percent", "humidity", 50.0), ("50%", "humidity", 50.0), ("2 min", "time", 120.0),
    ("1 h", "time", 3600.0), ("0.1 px", "pixel", 0.1), ("0.6 um/min", "speed", 1e-5), ("0.5 kg", "mass", 0.5),
    ("5 mV", "voltage", 5e-3), ("100 Ω", "resistance", 100.0),
]  # fmt: skip
REFUSED = [
    ("0,1 mm", "length", "decimal comma", "write '0.1 mm'"), ("5 Mm", "length", "unknown unit", "did you mean 'mm'"),
    ("0.5 kg", "length", "of a mass, not of a length", "allowed"), ("20", "length", "has no unit", "write e.g. '20 mm'"),
    ("0.02", "angle", "has no unit", "0.02 rad"),
    ("1e-6", "length", "has no unit", "1e-6 mm"), ("nan mm", "length", "not a number", "0.1 mm"), ("inf mm", "length", "not a number", ""),
    ("1e400 mm", "length", "too large", ""), ("umm", "length", "not a number", ""), ("1 umm", "length", "unknown unit", "allowed: mm"),
    ("3 mm + 2 um", "length", "is not one unit", ""), ("25 +/- 0.1 mm", "length", "is not one unit", ""),
    ("(1.5+L/350) um", "length", "not a number", ""), ("0.5 px", "length", "distance in the image", "allowed"),
    ("1 MM", "length", "unknown unit", "'mm'"), ("1 000 mm", "length", "is not one unit", ""), ("", "length", "not a number", ""),
    ("3 mm/m", "angle", "of a slope, not of an angle", "arcsec"), ("20 arcsec", "slope", "of an angle, not of a slope", "mm/m"),
    ("5 deg", "temperature", "of an angle", "degC"), ("1 degC", "temperature difference", "cannot be the unit", "write '1 K'"),
    ("20 mm", "pixel", "of a length", "px"), ("2 ppm", "slope", "a ratio", "um/m"), ("1 microns", "length", "unknown unit", "'um'"),
    ("5 inch", "length", "is the inch", "'127 mm'"), ("0.1 in", "length", "is the inch", "0.1 inch is 2.54 mm"), ("\u22125 mm", "length", "not a number", ""), ("1_000 mm", "length", "is not one unit", ""),
    ("0x10 mm", "length", "is not one unit", ""), ("5 seconds", "time", "unknown unit", "'s'"), ("1,000.5 mm", "length", "is not one unit", ""),
]  # fmt: skip


@pytest.mark.parametrize(("text", "dimension", "value"), RIGHT)
def test_quantities_are_read(text: str, dimension: str, value: float) -> None:
    assert parse_quantity(text, dimension) == pytest.approx(value, rel=1e-15, abs=1e-13)


@pytest.mark.parametrize(("text", "dimension", "message", "hint"), REFUSED)
def test_other_texts_are_refused_with_a_hint(text: str, dimension: str, message: str, hint: str) -> None:
    with pytest.raises(QuantityError) as caught:
        parse_quantity(text, dimension)
    assert message in caught.value.message
    assert caught.value.hint
    assert hint in caught.value.hint


def test_a_unit_with_another_prefix_is_no_slip() -> None:
    """An offered unit would change the number by a power of ten: a nanoradian is not a milliradian, and a mPa s is not a mPa."""
    for dimension in units.DIMENSIONS.values():
        for word in (prefix + symbol for symbol in dimension.symbols for prefix in "YZEPTGMkhdcmunpfaz"):
            # Mm is so often typed for mm that the question is asked
            assert word in dimension.symbols or word[:2] == "Mm" or not units.unit_meant(word, dimension.symbols), word
    everything = tuple({symbol for dimension in units.DIMENSIONS.values() for symbol in dimension.symbols})
    for word in ("mPas", "Nmm", "km/h", "in/min", "mile"):
        assert not units.unit_meant(word, everything), word


@pytest.mark.parametrize("dimension", units.DIMENSIONS)
def test_each_example_is_a_quantity_and_matches_the_pattern(dimension: str) -> None:
    import re

    example = units.DIMENSIONS[dimension].example
    assert math.isfinite(parse_quantity(example, dimension))
    assert re.search(units.quantity_pattern(dimension), example)


@given(st.floats(-1e9, 1e9), st.sampled_from([(d.name, u.symbol) for d in units.DIMENSIONS.values() for u in d.units]))
def test_a_unit_there_and_back(value: float, case: tuple[str, str]) -> None:
    unit = units.find_unit(case[1], case[0])
    assert unit.inside(unit.outside(value)) == pytest.approx(value, rel=1e-14, abs=1e-12 + abs(unit.offset) * 1e-15)


@given(texts(20), st.sampled_from(list(units.DIMENSIONS)))
def test_any_text_is_read_or_refused(text: str, dimension: str) -> None:
    try:
        assert math.isfinite(parse_quantity(text, dimension))
    except QuantityError as error:
        assert error.hint


@pytest.mark.parametrize(
    ("value", "std", "shown"),
    [
        (12.345678, 0.00123, ("12.3457", "0.0012")), (0.0999, 0.0996, ("0.10", "0.10")), (123456.0, 7000.0, ("123500", "7000")),
        (3.0, 0.0, ("3", "0")), (1e-8, 2e-9, ("0.0000000100", "0.0000000020")), (-0.5, 0.25, ("-0.50", "0.25")),
        (1.0, float("nan"), ("not determined",) * 2), (1.0, float("inf"), ("not determined",) * 2),
    ],
)  # fmt: skip
def test_two_digits_of_the_uncertainty_are_shown(value: float, std: float, shown: tuple[str, str]) -> None:
    assert units.rounded(value, std) == shown


def test_very_small_values_are_shown_in_powers_of_ten() -> None:
    assert units.rounded(1.23e-14, 1e-16) == ("1.230e-14", "1.0e-16")


@pytest.mark.parametrize(
    ("text", "dimension", "value"),
    [
        ("10 cm", "length", 100.0),
        ("2 dm", "length", 200.0),
        ("1.5 km", "length", 1.5e6),
        ("1 ft", "length", 304.8),
        ("2 feet", "length", 609.6),
        ("100 gon", "angle", np.pi / 2),
        ("10 mgon", "angle", np.pi / 20000),
        ("30 psi", "pressure", 2068.4271879508483),
    ],
)
def test_units_of_people_are_read(text: str, dimension: str, value: float) -> None:
    """NIST SP 811, appendix B: 1 ft = 304.8 mm, 1 psi = 6894.757 Pa; 400 gon are a turn."""
    assert units.parse_quantity(text, dimension) == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(("value", "dimension"), [(123.0, "length"), (1.5707, "angle"), (70.0, "pressure")])
def test_reports_choose_none_of_them(value: float, dimension: str) -> None:
    assert units.readable(value, dimension)[1] not in ("cm", "dm", "km", "ft", "gon", "mgon", "psi")


@pytest.mark.parametrize("text", ["5 cl", "5 hm", "3 mil", "5 pt", "2 g", "7 kp"])
def test_no_unit_is_proposed_that_would_change_the_size(text: str) -> None:
    """A symbol that resembles another one is mostly another unit."""
    with pytest.raises(units.QuantityError) as raised:
        units.parse_quantity(text, "length")
    assert "did you mean" not in raised.value.hint


def test_column_endings() -> None:
    assert set(units.suffixes("length")) == {"mm", "m", "um", "nm", "cm", "dm", "km", "ft"}
    assert "um_per_m" in units.suffixes("ratio")
    assert units.suffix_of("1/K") == "per_K"
    assert units.suffix_of("1") == ""


@pytest.mark.parametrize(("value", "text"), [(0.2149, "0.21"), (99.7, "100"), (1230.0, "1200"), (3e-7, "3e-07")])
def test_two_digits_are_no_power_of_ten_where_a_plain_number_will_do(value: float, text: str) -> None:
    assert units.two_digits(value) == text


def test_sizes_for_sentences() -> None:
    assert units.sized(2.14e-4, "length") == "0.21 um"
    assert units.sized(5.04e-6, "length") == "5 nm"
    assert (
        units.sized(math.inf, "length")
        == units.roughly(math.inf, "um")
        == units.two_digits(math.nan)
        == "not determined"
    )


def test_columns_of_small_numbers_are_in_a_smaller_unit() -> None:
    assert units.column_unit(1354.0, "mm") == (1.0, "mm")
    assert units.column_unit(0.00025, "mm") == (0.001, "um")
    assert units.column_unit(2e-6, "rad") == (pytest.approx(1e-6), "urad")
    assert units.column_unit(2e-6, "px") == (1.0, "px")
    assert units.column_unit(0.0, "mm") == (1.0, "mm")


def test_a_value_in_the_unit_of_a_condition() -> None:
    assert units.as_stated(9.25e-5, "mm", "< 100 nm") == (pytest.approx(92.5), "nm")
    assert units.as_stated(2e-7, "1", "<= 1 um/m") == (pytest.approx(0.2), "um/m")
    assert units.as_stated(1.2, "1", "< 1.5") == (1.2, "1")


def test_an_angle_is_a_slope_only_where_both_agree_within_its_uncertainty() -> None:
    # tan 0.0124 - 0.0124 = 0.0124^3 / 3 = 6.4e-7
    assert units.as_slope(0.0124, 3e-6) == (pytest.approx(12.4), pytest.approx(3e-3), "mm/m")
    # a part that is turned by 3.8 deg has a slope of 66.86 mm/m, not of 66.76
    assert units.as_slope(0.0667567, 8e-6) == (
        pytest.approx(3.82488, abs=1e-5),
        pytest.approx(4.58e-4, rel=1e-2),
        "deg",
    )


def test_a_change_that_rounding_makes_has_no_size() -> None:
    """A table had `4.3e-13 nm`."""
    assert [units.changed_by(size, "length") for size in (4.3e-19, 0.0, 4.3e-7)] == ["below rounding"] * 2 + ["0.43 nm"]
