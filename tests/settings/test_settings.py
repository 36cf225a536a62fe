"""Settings: nodes to frozen dataclasses."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from metrocli.errors import Fault
from metrocli.project import yaml_text
from metrocli.settings import BAD, Choice, Either, ListOf, MapOf, Number, Text, Whole, WithUnit
from metrocli.units import DIMENSIONS
from metrocli.words import nearest


def value_of(spec: Any, text: str) -> Any:
    """Read `text` as the value of a key."""
    node = yaml_text.parse(f"key: {text}\n", "job.yaml", Path()).get("key")
    faults: list[Fault] = []
    value = spec.read(node, faults)
    assert (value is BAD) == bool(faults)
    return faults[0] if faults else value


@pytest.mark.parametrize(
    ("spec", "text", "value"),
    [
        (Text(), "012345", "012345"),
        (Text(), "no", "no"),
        (Text(), "12:30:00", "12:30:00"),
        (Text(), "2026-01-01", "2026-01-01"),
        (Text(), "1e-6", "1e-6"),
        (Text(), "'null'", "null"),
        (Text(), "Su\u0308d", "S\u00fcd"),
        (Number(), "1e-6", 1e-6),
        (Number(), "+5e-4", 5e-4),
        (Number(), "012", 12.0),
        (Whole(), "012", 12),
        (Choice("on", "off"), "on", "on"),
        (WithUnit("length"), "2 m", 2000.0),
        (ListOf(WithUnit("angle")), "[1 rad, 2 mrad]", (1.0, 0.002)),
        (MapOf(Number()), "{a: 1, b: 2}", {"a": 1.0, "b": 2.0}),
        (MapOf(Number()), "{Su\u0308d: 1}", {"S\u00fcd": 1.0}),
        (Either(WithUnit("pixel"), Choice("estimated")), "0.1 px", 0.1),
        (Either(WithUnit("pixel"), Choice("estimated")), "estimated", "estimated"),
        (Either(Choice("all"), ListOf(Text())), "[a]", ("a",)),
    ],
)
def test_values_are_read_from_their_text(spec: Any, text: str, value: object) -> None:
    assert value_of(spec, text) == value


def test_either_tells_the_fault_that_was_meant() -> None:
    spec = Either(WithUnit("pixel"), Choice("estimated"))
    assert "has no unit" in value_of(spec, "0.1").message
    assert "such as '0.1 px', or estimated" in value_of(spec, "guess").hint
    assert "a list" in value_of(spec, "[1 px]").message


OUT_OF_RANGE = [
    (WithUnit("length"), "1e300 mm", "too large"), (WithUnit("length"), "10.1 km", "too large"),
    (WithUnit("length"), "10100 m", "too large"), (WithUnit("length"), "-10100 m", "too low"),
    (WithUnit("pixel", positive=True), "1e300 px", "too large"), (WithUnit("pixel", positive=True), "1e-300 px", "too small"),
    (WithUnit("angle"), "721 deg", "too large"), (WithUnit("temperature"), "-1 K", "too low"),
    (WithUnit("ratio"), "1e31 um/m", None), (WithUnit("ratio"), "1e37 um/m", "too large"), (Number(), "1e31", "too large"),
    (WithUnit("length"), "10000 m", None), (WithUnit("angle"), "-720 deg", None), (WithUnit("temperature"), "0 K", None),
]  # fmt: skip


@pytest.mark.parametrize(("spec", "text", "message"), OUT_OF_RANGE)
def test_a_quantity_beyond_what_it_can_be_is_refused(spec: WithUnit | Number, text: str, message: str | None) -> None:
    found = value_of(spec, text)
    assert isinstance(found, float) if message is None else message in found.message


def test_near_words() -> None:
    assert nearest("tolerence", ["tolerance", "title"]) == "tolerance"
    assert nearest("pixel-size", ["pixel_size"]) == "pixel_size"
    assert nearest("zzz", ["tolerance"]) is None


@pytest.mark.parametrize("dimension", DIMENSIONS)
def test_each_dimension_says_what_it_expects(dimension: str) -> None:
    assert DIMENSIONS[dimension].example in WithUnit(dimension).expects
