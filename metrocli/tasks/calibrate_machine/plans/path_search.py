"""Search a path of chords between the walls of the volume that determines the errors (greedy E-optimal design).

Each step finds the combinations of errors with the largest ratio of volume error to path misfit. Of random chords from
the last vertex it takes the one that is most sensitive to these combinations for its length.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from metrocli.adjust.dense_jacobian import Unknowns, rows, unit_noise, unknowns_of
from metrocli.adjust.model.blocks import Block
from metrocli.arrays import Array, Index
from metrocli.frozen import dataclass
from metrocli.instruments.machine import TOOL, Machine
from metrocli.instruments.machine_path import Path
from metrocli.instruments.tracker import LEG
from metrocli.tasks.calibrate_machine.problem import MachineProblem
from metrocli.tasks.calibrate_machine.rank.identifiability import identify, volume_matrix

_CHOICE = 40
_WORST = 6
_DENSE = 150
_LEAST = 0.3
"""Shortest chord, as a share of the volume's diagonal"""
_FLOOR = 1e-9
"""Information of a combination that no chord has seen yet, relative to the mean per length of many random chords"""

Planned = Callable[[Path], MachineProblem]


@dataclass(frozen=True)
class ChosenPath:
    """A path, and the tool of each of its legs."""

    vertices: Array
    """(n, 3)"""
    tool: Index


def edges_and_diagonals(machine: Machine) -> Path:
    """Return 12 edges, 3 middle lines, 12 face and 4 space diagonals, similar to Sanders et al. 2023, Figure 1."""
    low, high = machine.low, machine.high
    lines: list[tuple[Array, Array]] = []
    for axis in range(3):
        first, second = [i for i in range(3) if i != axis]
        for a, b in ((0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0), (0.5, 0.5)):
            start, end = np.zeros(3), np.zeros(3)
            end[axis], start[first], start[second] = 1.0, a, b
            end[first], end[second] = a, b
            lines.append((start, end))
        for side in (0.0, 1.0):
            for turn in (0.0, 1.0):
                start, end = np.full(3, side), np.full(3, side)
                start[first], end[first], start[second], end[second] = turn, 1.0 - turn, 0.0, 1.0
                lines.append((start, end))
    lines += [(np.array([a, b, 0.0]), np.array([1 - a, 1 - b, 1.0])) for a in (0.0, 1.0) for b in (0.0, 1.0)]
    start, end = (low + np.array([line[k] for line in lines]) * (high - low) for k in range(2))
    return Path(start, end, np.zeros(len(lines), dtype=np.intp), np.arange(len(lines)))


@dataclass(frozen=True)
class PathRequirements:
    """Requirements for a path: longest length [mm], largest ratio, number of tools, and seed of the random chords."""

    length: float
    ratio: float
    tools: int
    seed: int


@dataclass(frozen=True)
class _Volume:
    """The unknowns by which paths are judged, and the mean square error in the volume as a quadratic form of them."""

    planned: Planned
    held: Mapping[str, Block]
    unknowns: Unknowns
    matrix: Array

    def seen(self, path: Path) -> tuple[Array, Index]:
        """Return the Jacobian of a path's readings, (2, n, unknowns), weighted by length, and the leg of each."""
        problem = self.planned(path)
        group = unit_noise(problem.readings, 1 / np.sqrt(problem.per_reading))
        blocks = {**problem.blocks, **{name: self.held[name] for name in self.unknowns.columns}}
        return rows(group, blocks, self.unknowns), problem.readings.observations.index[LEG]

    def worst(self, seen: Array) -> tuple[float, Array]:
        """Return the worst ratio, and the worst combinations of errors, (unknowns, k), scaled by their ratio.

        `seen` is the normal matrix of the path, (unknowns, unknowns).
        """
        from scipy.linalg import eigh

        scale = 1 / np.sqrt(np.diag(seen))
        last = self.unknowns.size - 1
        values, vectors = eigh(
            self.matrix * scale[:, None] * scale,
            seen * scale[:, None] * scale,
            subset_by_index=(max(last - _WORST + 1, 0), last),
        )
        return float(np.sqrt(max(values[-1], 0.0))), scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))


def search(machine: Machine, planned: Planned, wanted: PathRequirements) -> ChosenPath:
    """Return a path that reaches the wanted ratio, or the best one found up to the longest length."""
    rng = np.random.default_rng(wanted.seed)
    volume, floor = _begin(machine, planned, wanted, rng)
    vertices, tool, length = [machine.low], [0], 0.0
    seen = np.zeros_like(floor)
    while True:
        ratio, modes = volume.worst(seen / max(length, 1.0) + floor)
        now = min(int(length / wanted.length * wanted.tools), wanted.tools - 1)
        if ratio <= wanted.ratio and now == wanted.tools - 1:
            break
        ends = _on_walls(machine, rng)
        choice = Path(
            np.repeat(vertices[-1][None], len(ends), axis=0), ends, np.full(len(ends), now), np.arange(len(ends))
        )
        keep = (choice.lengths > _LEAST * np.linalg.norm(machine.high - machine.low)) & (
            choice.lengths <= wanted.length - length
        )
        if not keep.any():
            break
        choice = Path(choice.start[keep], choice.end[keep], choice.tool[keep], np.arange(keep.sum()))
        design, leg = volume.seen(choice)
        views = ((design @ modes) ** 2).sum(axis=(0, 2))
        best = int(np.argmax(np.bincount(leg, views, minlength=len(choice.lengths)) / choice.lengths))
        part = design[:, leg == best].reshape(-1, volume.unknowns.size)
        seen, length = seen + part.T @ part, length + float(choice.lengths[best])
        if now != tool[-1]:
            vertices, tool = [*vertices, vertices[-1]], [*tool, now]
        vertices, tool = [*vertices, choice.end[best]], [*tool, now]
    return ChosenPath(np.array(vertices), np.array(tool, dtype=np.intp))


def _begin(
    machine: Machine, planned: Planned, wanted: PathRequirements, rng: np.random.Generator
) -> tuple[_Volume, Array]:
    """Return the volume by which paths are judged, and a small normal matrix as the start, from many random chords."""
    ends = np.concatenate([_on_walls(machine, rng) for _ in range(1 + _DENSE // _CHOICE)])
    tool = np.arange(len(ends)) % wanted.tools
    dense = Path(ends[:-1], ends[1:], tool[:-1], np.arange(len(ends) - 1))
    problem = planned(dense)
    held = identify(problem).blocks
    unknowns = unknowns_of(held, [name for name, block in held.items() if block.free.any() and name != TOOL])
    volume = _Volume(planned, held, unknowns, volume_matrix(problem.with_blocks(held), unknowns))
    design, _ = volume.seen(dense)
    return volume, np.diag((design**2).sum(axis=(0, 1)) / dense.length * _FLOOR)


def _on_walls(machine: Machine, rng: np.random.Generator) -> Array:
    """Return random points on the walls of the volume, (n, 3)."""
    share = rng.uniform(0.0, 1.0, (_CHOICE, 3))
    share[np.arange(_CHOICE), rng.integers(3, size=_CHOICE)] = rng.integers(2, size=_CHOICE)
    return np.asarray(np.round(machine.low + share * (machine.high - machine.low), 1))
