"""Estimates of the effects in an adjusted model, for the result."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from metrocli.adjust.adjustment import covariance_at
from metrocli.adjust.datum import Datum
from metrocli.adjust.model.blocks import Block
from metrocli.adjust.solution import Solution
from metrocli.arrays import Array
from metrocli.effects.model import Added, Model
from metrocli.result import Estimate
from metrocli.table import Table

if TYPE_CHECKING:
    from metrocli.adjust.coupled_fields import FieldSolution

Adjusted: TypeAlias = "Solution | FieldSolution"
"""Solution of any adjustment"""


def estimates(added: Sequence[Added], solution: Adjusted) -> tuple[Estimate, ...]:
    """Return the estimated parameters of all effects that have a block of their own, named `dead-path-drift.LT2.rate`.

    If several effects share a label, the second is named `dead-path-jump.LT2 2.step` and so on, as in /effects.
    """
    rows = []
    for label, addition in _labelled(addition for addition in _own(added) if not addition.std):
        block, std = solution.blocks[addition.block], solution.std(addition.block)
        for at, p in enumerate(addition.effect.parameters):
            if p.name in addition.columns:
                value, spread = float(block.values[-1, at]), float(std[-1, at])
                rows.append(Estimate(f"{label}.{p.name}", value, spread, p.unit, p.dimension))
    return tuple(rows)


def absorbed(added: Sequence[Added], solution: Solution, datum: Datum | None) -> tuple[Added, ...]:
    """Return the effects that make a model undetermined: fixing any one of them would make it determined."""
    return tuple(
        addition
        for addition in _own(added)
        if covariance_at(
            {**solution.blocks, addition.block: solution.blocks[addition.block].fixed()}.values(),
            solution.groups,
            datum,
        ).outcome.good
    )


def absorbed_in_words(added: Sequence[Added], solution: Solution, datum: Datum | None = None) -> list[str]:
    """Return the lines of a message on the effects that make a model undetermined; an empty list if none does."""
    lines = []
    for addition in absorbed(added, solution, datum):
        lines.append(f"  why: the other unknowns of this job absorb {addition.label}: leave it out")
        lines += [f"  what would determine it: {addition.effect.reveal}"] if addition.effect.reveal else []
    return lines


def true_values(model: Model) -> dict[str, float]:
    """Return the true parameters of all effects in a simulated model, by the names of their estimates."""
    return {
        f"{label}.{p.name}": float(model.blocks[addition.block].values[-1, model.blocks[addition.block].column(p.name)])
        for label, addition in _labelled(addition for addition in model.added if not addition.std)
        for p in addition.effect.all_parameters
    }


def free_blocks(added: Sequence[Added]) -> tuple[str, ...]:
    """Return the names of the blocks that belong to effects, for the covariance of all estimates (`Solution.joint`).

    Effects at all places of a kind have no estimates, only a table in /effects.
    """
    return tuple(addition.block for addition in _own(added) if not addition.std)


def tables(added: Sequence[Added], solution: Adjusted) -> tuple[dict[str, Table], dict[str, Array]]:
    """Return the contents of /effects: the parameters of each effect, estimated and applied, and their covariance."""
    by_name: dict[str, Table] = {}
    arrays: dict[str, Array] = {}
    for label, addition in _labelled(added):
        block = solution.blocks[addition.block]
        if addition.effect.definition:
            by_name[f"effects/{label}/definition"] = Table({"define": np.array([addition.effect.definition])})
        if addition.std:
            by_name[f"effects/{label}/parameters"] = _everywhere(addition, block, solution.std(addition.block))
            continue
        chosen = [block.column(p.name) for p in addition.effect.all_parameters]
        row = len(block.members) - 1
        places = row * block.size + np.array(chosen)
        scale = block.space.by_step(block.values).ravel()[places]
        covariance = solution.covariance_or_raise().of(addition.block)[np.ix_(places, places)] * scale[:, None] * scale
        columns = {
            "name": np.array([p.name for p in addition.effect.all_parameters]),
            "value": block.values[row, chosen],
            "std": np.sqrt(np.maximum(np.diag(covariance), 0.0)),
            "unit": np.array([p.unit for p in addition.effect.all_parameters]),
            "estimated": np.array([p.name in addition.columns for p in addition.effect.all_parameters]),
        }
        by_name[f"effects/{label}/parameters"], arrays[f"effects/{label}/covariance"] = Table(columns), covariance
    return by_name, arrays


def _everywhere(addition: Added, block: Block, std: Array) -> Table:
    """Return the parameters of an effect that acts at all places, place by place."""
    names, first = [p.name for p in addition.effect.parameters], 0 if addition.effect.is_smooth else 1
    chosen, count = [block.column(name) for name in names], len(block.members) - first
    places = {key: np.repeat(np.array(block.members[1:]), len(names)) for key in addition.effect.keys}
    columns = places | {
        "name": np.tile(np.array(names), count),
        "value": block.values[first:, chosen].ravel(),
        "std": std[first:, chosen].ravel(),
        "unit": np.tile(np.array([p.unit for p in addition.effect.parameters]), count),
        "estimated": np.ones(count * len(names), dtype=bool),
    }
    return Table(columns)


def _own(added: Sequence[Added]) -> list[Added]:
    return [addition for addition in added if addition.effect.link is not None]


def _labelled(added: Iterable[Added]) -> Iterator[tuple[str, Added]]:
    """Yield each effect with a unique label."""
    seen: Counter[str] = Counter()
    for addition in added:
        seen[addition.label] += 1
        yield addition.label if seen[addition.label] == 1 else f"{addition.label} {seen[addition.label]}", addition
