"""The largest change of the delivered result that an effect makes without being found.

Method: docs/algorithms/what-can-be-seen.md (what a measurement can see).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from metrocli.adjust.model.blocks import Array, Space
from metrocli.adjust.model.observations import Index
from metrocli.diagnosis.adjusted_job import AdjustedJob
from metrocli.diagnosis.linear.candidates import Candidate, CandidateGroup
from metrocli.diagnosis.linear.projection import FLAT, VISIBLE, Linearised
from metrocli.frozen import dataclass

_WEIGHTS = (0.0, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.05, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.97)
"""Weights of what the readings show against what is usual, of which the one with the lowest bound is taken"""
POWER = 0.95
"""Probability with which an effect is found that changes the result by more"""
_AT_ONCE, _FEWEST_AT_ONCE = 500_000, 6
"""Numbers of the columns of alternatives that are held at once, as many as a cache holds, and the fewest columns"""
_MOST_OF_FORMS, _FEWEST_FORMS = 1_000_000, 8
"""Unknowns times columns of the forms (values of a scan) of an effect, and how many forms are looked at in any case"""
_MOST_NUMBERS = 4_000_000
"""Unknowns times readings above which only the own member of each reading is considered"""
_FOLLOWS = 1e-6
"""Difference of the result and what moves, relative to the move, that is rounding"""
_TWO_SIDED = 1.96
"""Standard deviations that 5 % of normal errors exceed"""
_VANISHED = 1e-100
"""Norm of a column that counts as 0: the square of a smaller one can be"""
_ROUNDING = 1e-15
"""Least eigenvalue of a bound, relative to its largest"""
_NOTHING = 1e-9
"""Change of the result, relative to the change of all readings, that is rounding"""


@dataclass(frozen=True)
class UndetectedBias:
    """The largest change of the delivered result that is not found with 95 % power, and the member it moves."""

    size: float
    """Length of the change over the columns of the member, in the unit of the block"""
    member: str = ""
    """Name of the member that moves most, such as the point"""


def undetected_bias(
    job: AdjustedJob, system: Linearised, family: CandidateGroup, chosen: Sequence[int], gram: Array, reach: Array
) -> UndetectedBias:
    """Return the largest change of a delivered member by undetected sizes theta of some alternatives of a family.

    theta is undetected while `theta' A theta < lambda s^2`, with its Gram matrix A = G'MG and, in `reach`[:, 0]
    (alternatives,), the non-centrality lambda of 95 % power times the variance of the noise. It is usual while
    `theta' C theta < 1`, with C diagonal and sizes up to `reach`[:, 1] times the plausible ones: directions that the
    readings hardly show end there. The change of member m is `S_m theta`. Its largest length under both conditions is
    at most the spectral norm of `S_m B^(-1/2)`, with `B = w A/(lambda s^2) + (1 - w) C` and any w (Lagrange).
    """
    step = max(_AT_ONCE // (system.rows * gram.shape[1]), _FEWEST_AT_ONCE // gram.shape[1], 1)
    best = 0.0, 0
    for start in range(0, len(chosen), step):
        some = slice(start, start + step)
        best = max(best, _of_some(job, system, family, chosen[some], gram, reach[some], best[0]))
    return _at_member(job, *best)


def forms_for(system: Linearised, parameters: int) -> int:
    """Return how many forms of an effect of so many parameters are looked at: fewer where there are many unknowns."""
    return max(_MOST_OF_FORMS // (system.layout.width * parameters), _FEWEST_FORMS)


def _of_some(
    job: AdjustedJob,
    system: Linearised,
    family: CandidateGroup,
    chosen: Sequence[int],
    gram: Array,
    reach: Array,
    least: float,
) -> tuple[float, int]:
    """Return the largest change by some alternatives, and its member; 0 if it is not above `least`."""
    at = list(chosen)
    scale = np.where(family.raw[at] > _VANISHED, family.raw[at], 1.0)
    scaled = gram[at] / (scale[:, :, None] * scale[:, None, :])
    values, vectors = np.linalg.eigh(scaled)
    seen = values > np.maximum(VISIBLE**2, FLAT * values[:, -1:])
    shown = (vectors * np.where(seen, values, 0.0)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    shown = shown / np.where(reach[:, 0] > 0, reach[:, 0], 1.0)[:, None, None]
    farthest = np.stack([_plausible(family.alternatives[i]) for i in at]) * reach[:, 1, None] * scale
    usual = np.eye(farthest.shape[1]) / farthest[:, :, None] ** 2
    shift = _shifts(job, system, family.absorbed_by(system, at))
    shift *= np.where(_is_rounding(system, shift, scale), 0.0, 1 / scale)
    _without_moves(job, [family.alternatives[i] for i in at], scale, shift)
    squares = np.einsum("mckp,mckq->kmpq", shift, shift)
    # one bound is the lowest: that of the readings where these show all directions well, the usual one where none
    narrow = seen.all(axis=1) & (np.linalg.eigvalsh(shown - usual) >= 0).all(axis=1)
    blind = ~seen.any(axis=1)
    best = _largest(squares[narrow], shown[None, narrow], least)
    best = max(best, _largest(squares[blind], usual[None, blind], max(best[0], least)))
    rest = ~(narrow | blind)
    wide = np.stack([w * shown[rest] + (1 - w) * usual[rest] for w in _WEIGHTS])
    return max(best, _largest(squares[rest], wide, max(best[0], least)))


def hidden_by_readings(job: AdjustedJob, system: Linearised, rows: Index, errors: Array) -> UndetectedBias:
    """Return the largest change of the delivered result by one of some errors of single rows, in their sigma."""
    if len(rows) * system.layout.width > _MOST_NUMBERS and system.is_local(job.delivered.block):
        return _of_own_members(job, system, rows, errors)
    moved = _shifts(job, system, system.basis.rows(rows).T[:, :, None] * errors[:, None])
    squares = (moved**2).sum(axis=1)
    at = np.unravel_index(int(np.argmax(squares)), squares.shape) if squares.size else (0, 0)
    return _at_member(job, float(np.sqrt(squares[at])) if squares.size else 0.0, int(at[0]))


def hidden_by_scatter(
    job: AdjustedJob, system: Linearised, families: Sequence[CandidateGroup], std: float
) -> UndetectedBias:
    """Return the change of the delivered result that sizes at all places, which scatter by `std`, exceed in 5 %.

    It is of the member, and along its direction, of the largest variance.
    """
    squares: Array | float = 0.0
    for family in families:
        moved = _shifts(job, system, family.absorbed_by(system, range(len(family.alternatives))))
        flat = moved.reshape(*moved.shape[:2], -1)
        squares = squares + flat @ np.swapaxes(flat, 1, 2)
    largest = np.linalg.eigvalsh(squares)[:, -1] if np.ndim(squares) else np.zeros(1)
    best = int(np.argmax(largest))
    return _at_member(job, _TWO_SIDED * std * float(np.sqrt(max(largest[best], 0.0))), best)


def _of_own_members(job: AdjustedJob, system: Linearised, rows: Index, errors: Array) -> UndetectedBias:
    """Return the largest change of the member that a row concerns, such as its point: others move far less."""
    moved = system.solver.own_change(system.basis, rows)[:, list(job.delivered.columns)] * errors[:, None]
    sizes = np.linalg.norm(moved, axis=1)
    best = int(np.argmax(sizes))
    return UndetectedBias(
        float(sizes[best]), job.model.blocks[job.delivered.block].members[system.basis.member[rows[best]]]
    )


def _plausible(alternative: Candidate) -> Array:
    """Return the largest usual size of each column of an alternative, (parameters,)."""
    effect = alternative.effect
    if effect.space is Space.WAVE:
        # both steps are lengths of the phasor
        return np.full(len(alternative.parameters), effect.plausible)
    first = effect.parameters[0].dimension
    known = {p.name: effect.plausible if p.dimension == first else p.plausible for p in effect.parameters}
    return np.array([known[name] for name in alternative.parameters])


def _shifts(job: AdjustedJob, system: Linearised, absorbed: Array) -> Array:
    """Return the change of the delivered members by unit parameters, (members, columns, alternatives, parameters)."""
    change = system.solver.change(absorbed)
    return job.delivered.of(lambda block: system.shift(change, block, job.delivered.columns))


def _without_moves(job: AdjustedJob, alternatives: Sequence[Candidate], scale: Array, shift: Array) -> None:
    """Take off, in place, what effects move itself: a result that follows the move of a target has no error by it."""
    for number, candidate in enumerate(alternatives):
        moved = job.delivered.moved(candidate.effect, candidate.where)
        if moved is not None:
            moved = moved / scale[number]
            off = shift[:, :, number] - moved
            shift[:, :, number] = np.where(np.abs(off) < _FOLLOWS * np.abs(moved).max(), 0.0, off)


def _is_rounding(system: Linearised, shift: Array, scale: Array) -> Array:
    size = np.sqrt(np.einsum("mckq,mckq->kq", shift, shift))
    return np.asarray(size < _NOTHING * system.typical_scale * scale)


def _largest(squares: Array, bounds: Array, least: float = 0.0) -> tuple[float, int]:
    """Return the largest over all alternatives, and its member, of the length that each bound allows at most.

    `S_m theta` over `theta' B theta < 1` has as its largest length the root of the largest eigenvalue of
    `S_m'S_m B^-1`, for `squares` S'S (alternatives, members, q, q) and `bounds` B (bounds, alternatives, q, q). The
    trace is no less. So eigenvalues are needed only for members, bounds and alternatives whose traces exceed the
    largest length that is known. The length is 0 if none is above `least`.
    """
    k, m, q, _ = squares.shape
    values, vectors = np.linalg.eigh(bounds)
    # a direction that the readings hardly show has an eigenvalue of rounding, which can be below 0
    root = vectors / np.sqrt(np.maximum(values, _ROUNDING * values[..., -1:]))[..., None, :]
    inverse = root @ np.swapaxes(root, -1, -2)
    traces = np.stack(
        [(squares.reshape(k, m, q * q) @ root_of_inverse.reshape(k, q * q, 1))[:, :, 0] for root_of_inverse in inverse]
    )
    highest = traces.max(axis=2, initial=0.0)
    at_most = highest.min(axis=0)
    best = least**2, -1
    for at in np.argsort(-at_most).tolist():
        if at_most[at] <= best[0]:
            break
        lowest = np.inf, 0
        for w in np.argsort(highest[:, at]).tolist():
            # an eigenvalue is at least the mean of all
            if lowest[0] > best[0] and highest[w, at] / q < lowest[0]:
                lowest = min(lowest, _of_members(squares[at], traces[w, at], root[w, at], best[0]))
        best = max(best, lowest)
    return (float(np.sqrt(best[0])), best[1]) if best[1] >= 0 else (0.0, 0)


def _of_members(squares: Array, traces: Array, root: Array, known: float) -> tuple[float, int]:
    """Return the largest eigenvalue of `root' S'S root` over all members, and its member; up to `known` any of them."""
    first = int(np.argmax(traces))
    least = _eigenvalues(squares[[first]], root)[0]
    more = np.flatnonzero(traces > max(least, known))
    values = np.append(_eigenvalues(squares[more], root), least)
    best = int(np.argmax(values))
    return float(values[best]), int(np.append(more, first)[best])


def _eigenvalues(squares: Array, root: Array) -> Array:
    """Return the largest eigenvalue of `root' squares root` of each, (n,)."""
    return np.asarray(np.linalg.eigvalsh(root.T @ squares @ root)[:, -1])


def _at_member(job: AdjustedJob, change: float, member: int) -> UndetectedBias:
    """Return a change with the name of its member, and of its block where there are several: axis Y -260."""
    if change == 0:
        return UndetectedBias(0.0)
    blocks = job.delivered.blocks
    for block in blocks:
        members = job.model.blocks[block].members
        if member < len(members):
            return UndetectedBias(change, f"{block} {members[member]}" if len(blocks) > 1 else members[member])
        member -= len(members)
    raise IndexError(member)
