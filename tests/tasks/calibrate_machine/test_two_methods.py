"""One machine from lengths and at standstill: the results agree within their joint uncertainty."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.machine_lengths import agreement_of, twice
from metrocli.formats import hdf5
from metrocli.record import Record

RUNS = 3


@pytest.mark.slow
def test_lengths_and_standstill_agree_within_their_joint_uncertainty() -> None:
    """Three machines: 207 degrees of freedom of the tables, and as many of the volume."""
    found = [agreement_of(*twice(seed, points=120)) for seed in range(100, 100 + RUNS)]
    for chi2, dof in (
        (sum(one.compared.chi2 for one in found), sum(one.compared.dof for one in found)),
        (sum(one.volume_chi2[0] for one in found), sum(one.volume_chi2[1] for one in found)),
    ):
        assert dof > 150
        assert chi2 == pytest.approx(dof, abs=3 * np.sqrt(2 * dof))
    # neighbouring places of one machine share their errors, so the share of three machines scatters by 4 %
    assert np.mean([one.volume < 1 for one in found]) == pytest.approx(0.954, abs=0.12)


def test_compare_holds_the_two_results_against_each_other(tmp_path: Path, metrocli: Callable[..., Any]) -> None:
    one, other, machine = twice(7, points=120)
    for name, result in (("lengths", one), ("standstill", other)):
        hdf5.write(tmp_path / f"{name}.h5", result, Record("", (), "0", "2026-01-01T00:00:00Z"))
    ran = metrocli("compare", tmp_path / "lengths.h5", tmp_path / "standstill.h5", "--json")
    assert ran.code == 0, ran.err
    listed_at, expected = json.loads(ran.out), agreement_of(one, other, machine).compared
    assert listed_at["chi2"] == pytest.approx(expected.chi2) and listed_at["dof"] == expected.dof
    assert listed_at["p_value"] > 1e-3
