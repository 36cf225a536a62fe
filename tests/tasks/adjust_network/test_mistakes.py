"""Mistakes in the files of a network: names and signs exchanged, angles of another sort."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated.network import Network, network

from metrocli.project.job import load
from metrocli.project.runner import content
from metrocli.tasks.adjust_network.other_settings import other_settings

Metrocli = Callable[..., Any]


def proposed(net: Network, folder: Path) -> list[str]:
    return [mistake.words for mistake, _ in other_settings(content(load(net.write(folder))), False)]


def test_exchanged_points_are_proposed_at_their_station(tmp_path: Path) -> None:
    net = network(np.random.default_rng(51), 4, 15)
    point = net.point.copy()
    here = net.station == 2
    point[here & (net.point == 3)], point[here & (net.point == 9)] = 9, 3
    found = proposed(replace(net, point=point), tmp_path)
    assert [one for one in found if "exchanged" in one] in (
        ["P004 and P010 are exchanged at station S3"],
        ["P010 and P004 are exchanged at station S3"],
    )
    assert not [one for one in proposed(net, tmp_path) if "exchanged" in one]


def test_a_height_of_the_wrong_sign_is_proposed_with_its_line(tmp_path: Path) -> None:
    net = network(np.random.default_rng(52), 3, 12, mixed=True)
    first, *rest = net.heights
    found = proposed(replace(net, heights=((*first[:2], -first[2]), *rest)), tmp_path)
    assert [one for one in found if "sign" in one] == [
        "the height difference from P001 to P005 has the wrong sign, line 2"
    ]
    assert not [one for one in proposed(net, tmp_path) if "sign" in one]


def test_nothing_is_proposed_for_readings_that_fit(tmp_path: Path) -> None:
    job = content(load(network(np.random.default_rng(53)).write(tmp_path)))
    assert list(other_settings(job, True)) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("header", "words"),
    [("az_rad,zd_rad,d_mm", "zd is an elevation"), ("az_rad,el_rad,d_m", "d_m is in mm")],
)
def test_a_mistake_is_found_and_its_correction_fits(
    header: str, words: str, tmp_path: Path, metrocli: Metrocli
) -> None:
    job = network(np.random.default_rng(54), 3, 12).write(tmp_path, header=header)
    ran = metrocli("diagnose", job, "--json")
    found = json.loads(ran.out)
    assert (found["verdict"], found["mistake"]["what"]) == ("mistaken", words)
