"""Units, tables and numbers as people write them: read rightly, or refused with what is wrong."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Case = Callable[[str], Path]
Metrocli = Callable[..., Any]


def test_a_density_in_grams_per_cubic_centimetre(case: Case, metrocli: Metrocli) -> None:
    case("13-centimetres")
    more = ("--set", "monte_carlo.trials=10000", "--output", "d.h5", "--json")
    for unit, value in (("g/cm^3", 14.967), ("kg/dm^3", 14.967), ("kg/m^3", 14967.0)):
        ran = metrocli("report-uncertainty", "density.yaml", "--set", f"measurands.rho.unit={unit}", "--force", *more)
        assert json.loads(ran.out)["estimates"]["rho"]["value"] == pytest.approx(value, rel=1e-4)


def test_a_mesh_in_centimetres(case: Case, metrocli: Metrocli) -> None:
    case("13-centimetres")
    ran = metrocli("fit-part", "part.yaml")
    assert ran.code == 3 and "write `nominal_unit: cm`" in ran.err
    assert metrocli("fit-part", "part.yaml", "--set", "nominal_unit=cm").code in (0, 6)


def test_a_pitch_and_targets_in_centimetres(case: Case, metrocli: Metrocli) -> None:
    case("13-centimetres")
    assert "unit" not in metrocli("check", "board.yaml").err
