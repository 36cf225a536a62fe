"""Two coupled fields whose readings are steep where they start: the first steps go too far, and are shortened."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from metrocli.adjust.coupled_fields import Fields, adjust_fields
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.model.chain import Chain, LinkContext, Step
from metrocli.adjust.model.groups import Group
from metrocli.adjust.model.observations import Observations
from metrocli.adjust.model.quantities import OfBlock, Quantity
from metrocli.adjust.outcome import Outcome
from metrocli.frozen import dataclass

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Steep(OfBlock):
    """A reading of `x + 2 tanh x`: its derivative is 3 at 0, and 1 where it is read."""

    takes = None
    gives = Quantity.LENGTH

    def step(self, value: Any, local: LinkContext) -> Step:
        x = local.rows(self.block)
        return Step(x + 2 * np.tanh(x), by_block={self.block: (1 + 2 / np.cosh(x) ** 2)[None]})


@dataclass(frozen=True)
class Plus(OfBlock):
    """The reading plus the unknown of the other field."""

    takes = gives = Quantity.LENGTH

    def step(self, value: Any, local: LinkContext) -> Step:
        return Step(value + local.rows(self.block), by_block={self.block: np.ones((1, 1, value.shape[1]))})


def fields(net: Array, local: Array) -> Fields:
    """Readings of each member of the net, and of the sum with one of the local members; the design is x = 3."""
    count = len(net)
    blocks = {name: Block(name, np.zeros((count, 1)), ("x",), tuple("abcdef"[:count])) for name in ("net", "local")}
    index = {name: np.arange(count) for name in blocks}
    values = net + 2 * np.tanh(net)
    alone = Observations(values[None], np.ones(1), {"net": index["net"]})
    both = Observations((values + local)[None], np.ones(1), index)
    groups = (Group("alone", Chain((Steep("net"),)), alone), Group("both", Chain((Steep("net"), Plus("local"))), both))
    places, conditions = np.arange(count)[:, None, None], {"net": np.zeros((0, count, 1))}
    nominal = {**blocks, "net": blocks["net"].with_values(np.full((count, 1), 3.0))}
    return Fields(blocks, groups, "net", "local", places, lambda _: nominal, conditions)


def test_a_start_where_readings_are_steep_leads_to_the_minimum() -> None:
    net, local = np.array([2.5, 3.0, 4.0]), np.array([1.0, -2.0, 3.0])
    solution = adjust_fields(fields(net, local)).solution
    assert solution.outcome is Outcome.CONVERGED
    assert solution.blocks["net"].values[:, 0] == pytest.approx(net, abs=1e-5)
    assert solution.blocks["local"].values[:, 0] == pytest.approx(local, abs=1e-5)
