"""Lengths, bars, heights and given points that contradict the set-ups are named; left out, the rest is right."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from simulated.network import Network, network

from metrocli.formats import hdf5

Metrocli = Callable[..., Any]


def hall(seed: int = 5) -> Network:
    return network(np.random.default_rng(seed), stations=3, points=12, mixed=True)


def length(net: Network) -> Network:
    lengths = net.lengths.copy()
    lengths[0, 3] += 5000.0
    return replace(net, lengths=lengths)


def height(net: Network) -> Network:
    return replace(net, heights=tuple((a, b, v + 4000.0 * (i == 0)) for i, (a, b, v) in enumerate(net.heights)))


def test_one_reading_is_named(tmp_path: Path, metrocli: Metrocli) -> None:
    ran = metrocli("adjust-network", height(hall()).write(tmp_path))
    assert ran.code == 5 and "height difference P001/P005 by 4e+03 mm" in ran.err, ran.err
    assert not (tmp_path / "result.h5").exists()


def test_one_bar_of_two_does_not_bend_the_network(tmp_path: Path, metrocli: Metrocli) -> None:
    """The median of two residuals is as far off as the wrong one: nothing but the set-ups tells which it is."""
    net = hall()
    (first, second, value), other = net.bars[0], net.bars[-1]
    ran = metrocli("adjust-network", replace(net, bars=((first, second, value + 90_000.0), other)).write(tmp_path))
    assert ran.code == 5 and "contradict the set-ups: bar" in ran.err and "by 9e+04 mm" in ran.err, ran.err


@pytest.mark.alike
@pytest.mark.parametrize("wrong", [length, height])
def test_one_reading_is_left_out(wrong: Callable[[Network], Network], tmp_path: Path, metrocli: Metrocli) -> None:
    net = hall()
    ran = metrocli("adjust-network", wrong(net).write(tmp_path, more="outliers: remove\n"))
    assert ran.code == 0, ran.err
    result = hdf5.read(tmp_path / "result.h5")[0]
    assert len(result.tables["rejected"]) == 1
    order = [net.names.index(name) for name in result.tables["points"].texts("point")]
    assert np.abs(result.tables["points"].stacked("xyz") - net.points[order]).max() < 0.1


def bars_in_metres(net: Network) -> Network:
    return replace(net, bars=tuple((a, b, v / 1000) for a, b, v in net.bars))


def heights_in_metres(net: Network) -> Network:
    return replace(net, heights=tuple((a, b, v / 1000) for a, b, v in net.heights))


WHOLE = {"write length_m in the heading": bars_in_metres, "write dh_m in the heading": heights_in_metres}


@pytest.mark.alike
@pytest.mark.parametrize("words", WHOLE)
def test_a_wrong_unit_is_found(words: str, tmp_path: Path, metrocli: Metrocli) -> None:
    ran = metrocli("adjust-network", WHOLE[words](hall()).write(tmp_path))
    assert ran.code == 3 and words in ran.err, ran.err
    assert "contradict the set-ups: most of them are off by" in ran.err


def test_two_wrong_given_points_are_named_together(tmp_path: Path, metrocli: Metrocli) -> None:
    net = hall(15)
    near = net.near.copy()
    near[5:9] = net.points[5:9] + np.random.default_rng(3).normal(0, 0.01, (4, 3))
    near[0] += [0.3, 0.0, 0.2]
    near[2] += [0.0, -0.4, 0.0]
    ran = metrocli("diagnose", replace(net, near=near, given=(0, 1, 2, 3, 5, 6, 7, 8)).write(tmp_path), "--quick")
    assert ran.code == 0, ran.err
    assert "given-point P001" in ran.out and "given-point P003" in ran.out
