"""Blocks: steps and differences of their spaces agree, and what is undetermined is named."""

from __future__ import annotations

import numpy as np
import pytest

from metrocli.adjust.model.blocks import Block, Space
from metrocli.adjust.rank import _named


@pytest.mark.parametrize("space", Space, ids=lambda space: space.name)
def test_a_difference_changes_by_a_step_as_its_derivative_states(space: Space) -> None:
    rng = np.random.default_rng(3)
    size = 6 if space is Space.POSE else 2
    values, reference = (rng.uniform(0.3, 0.9, (4, size)) for _ in range(2))
    found = space.difference_by_step(values, reference)
    for at, h in enumerate(1e-6 * np.eye(size)):
        step = np.tile(h, (4, 1))
        ends = [space.difference(space.moved(values, way * step), reference) for way in (1, -1)]
        assert found[:, :, at] == pytest.approx((ends[0] - ends[1]) / 2e-6, abs=1e-7)
    assert space.moved(reference, space.difference(values, reference)) == pytest.approx(values)


def test_members_that_take_part_are_named_up_to_a_number() -> None:
    block = Block("view", np.zeros((9, 1)), ("x",), tuple(f"V{i}" for i in range(9)), noun="image")

    def members(count: int) -> str:
        ((_, _, text, _),) = _named(block, (np.arange(9) < count)[:, None].astype(float))
        return text

    assert members(2) == "image V0, V1"
    assert members(3) == "image V0, V1, V2"
    assert members(4) == "image V0, V1, V2 and 1 more"
    assert members(7) == "all images"
