"""Directions that a set of views leaves undetermined (open), named by pattern, and the views that would remove them.

Six rigid motions of the machine error, six of the artefact error and one common scale are open for every set of views.
Further open directions form families of fields. A family has the name of a pattern that lies within the open
directions. Such a pattern gives eigenvalues 1 of `Q' P Q`, where Q is an orthonormal basis of the open machine errors
and P the projector onto the pattern.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from metrocli.adjust.coupled_fields import FieldDesign, in_datum
from metrocli.adjust.decompositions import thin_svd
from metrocli.arrays import Array, Mask
from metrocli.frozen import dataclass
from metrocli.instruments import ball_grid as bg
from metrocli.tasks.selfcal_grid.determination.patterns import patterns
from metrocli.tasks.selfcal_grid.problem import GridProblem
from metrocli.tasks.selfcal_grid.settings import Rotate, turn_in_words

_ONE = 1e-6
_NEGLIGIBLE = 1e-6
_QUARTER = np.pi / 2
_TURNS = 30
_ENOUGH = 1 / 3


@dataclass(frozen=True)
class UndeterminedFields:
    """Undetermined fields of one pattern."""

    pattern: str
    count: int


@dataclass(frozen=True)
class Remedy:
    """A further view, and the number of directions that it would leave open."""

    words: str
    left: int


@dataclass(frozen=True)
class Open:
    """The directions that the views leave undetermined."""

    scale: bool
    """Whether the common scale is undetermined"""
    families: tuple[UndeterminedFields, ...]
    """Further directions, beyond the rigid motions and the scale"""
    remedies: tuple[Remedy, ...]
    """Views that would remove some of the families, the best first"""

    @property
    def count(self) -> int:
        """Total number of undetermined directions."""
        return 12 + self.scale + sum(family.count for family in self.families)

    def sentences(self) -> list[str]:
        """Return what is undetermined and what would determine it, in words."""
        fixed = "; the scale is that of the lengths"
        scale = ", 1 common scale: give one calibrated length to fix it" if self.scale else fixed
        rigid = "6 rigid motions of the machine error, 6 of the artefact error"
        lines = [f"{self.count} directions undetermined: {rigid}{scale}"]
        if self.families:
            families = "; ".join(f"{family.pattern} ({family.count})" for family in self.families)
            lines.append(f"the views also leave undetermined: {families}")
        if self.remedies:
            least = self.remedies[0].left
            best = [remedy.words for remedy in self.remedies if remedy.left == least]
            lines.append(f"a further view {' or '.join(best)} would leave {least} directions undetermined")
        return lines


def opened(problem: GridProblem, design: FieldDesign) -> Open:
    """Return the open directions of a design with their names and remedies."""
    scale = not problem.scale_given
    extra = design.null.shape[1] - 12 - scale
    if extra <= 0:
        return Open(scale, (), ())
    mountings = tuple(_loose_mountings(problem, design))
    basis, fields = _machine_fields(design)
    families = tuple(_families(problem, basis, fields, extra - sum(mounting.count for mounting in mountings)))
    tried = (Remedy(words, _left_with(problem, design, view)) for words, view in candidates())
    remedies = sorted(tried, key=lambda remedy: remedy.left)
    return Open(scale, families + mountings, tuple(remedy for remedy in remedies if remedy.left < design.null.shape[1]))


def determined(problem: GridProblem, design: FieldDesign) -> dict[str, Mask]:
    """Return which entries of both fields and of the mountings are determined apart from rigid motion and scale.

    At a determined entry the open directions Z equal a combination E M of the standard directions E (rigid motion and
    scale). M minimises `sum_i |Z_i - E_i M|` over the fields, by reweighted least squares, which makes as many rows as
    possible agree. If less than a third of the entries agree, M is the ordinary least squares fit over all entries,
    which corresponds to the datum over all of them.
    """
    columns = {name: design.partition.columns[name] for name in (bg.MACHINE, bg.ARTEFACT, bg.VIEW)}
    if design.null.shape[1] <= 13 - problem.scale_given:
        return {name: places >= 0 for name, places in columns.items()}
    rows = np.concatenate([places[places >= 0] for places in columns.values()])
    standard = _standard(problem)
    moves = np.concatenate([standard[name][places >= 0] for name, places in columns.items()])
    null, fields = _evened(problem, design)[rows], len(rows) - int((columns[bg.VIEW] >= 0).sum())
    moves = moves * _reach(problem, design)[rows, None]
    moves = moves / np.linalg.norm(moves, axis=0)
    agree = _agreeing(null, moves, _fit(null[:fields], moves[:fields]))
    if agree[:fields].mean() < _ENOUGH:
        agree = _agreeing(null, moves, np.linalg.lstsq(moves[:fields], null[:fields], rcond=None)[0])
    known = np.zeros(design.partition.width, dtype=bool)
    known[rows] = agree
    return {name: np.asarray(known[places] & (places >= 0)) for name, places in columns.items()}


def _reach(problem: GridProblem, design: FieldDesign) -> Array:
    """Return how far one unit of each unknown moves a ball, (unknowns,): 1, for rotations half the size of the grid."""
    reach = np.ones(design.partition.width)
    turns = design.partition.columns[bg.VIEW][:, 3:]
    reach[turns[turns >= 0]] = problem.grid.pitch * problem.grid.half.max()
    return reach


def _evened(problem: GridProblem, design: FieldDesign) -> Array:
    """Return an orthonormal basis of the open directions, with each unknown scaled to the motion of a ball."""
    return np.asarray(np.linalg.qr(design.null * _reach(problem, design)[:, None])[0])


def _agreeing(null: Array, moves: Array, fit: Array) -> Mask:
    left = np.linalg.norm(null - moves @ fit, axis=1)
    return np.asarray(left < _NEGLIGIBLE * max(float(left.max()), _NEGLIGIBLE))


def _fit(null: Array, moves: Array) -> Array:
    """Return the M that minimises `sum_i |Z_i - E_i M|`, by reweighted least squares."""
    weights = np.ones(len(null))
    for turn in range(_TURNS):
        fit = np.linalg.lstsq(moves * weights[:, None], null * weights[:, None], rcond=None)[0]
        left: Array = np.linalg.norm(null - moves @ fit, axis=1)
        # the floor falls from turn to turn: in the end all weight is with rows that agree, and none is divided by 0
        weights = 1 / np.sqrt(np.maximum(left, max(float(left.max()), 1e-12) * 0.3**turn))
    return np.asarray(fit)


def with_determined_datum(problem: GridProblem, design: FieldDesign) -> FieldDesign:
    """Return the design with its datum over the determined entries only.

    Without directions open beyond rigid motion and scale, the design stays as it is.
    """
    if design.null.shape[1] <= 13 - problem.scale_given:
        return design
    known = determined(problem, design)
    conditions = {name: given * known[name] for name, given in problem.fields.conditions.items()}
    return in_datum(replace(problem.fields, conditions=conditions), design)


def _standard(problem: GridProblem) -> dict[str, Array]:
    """Return the directions that every set of views leaves open, by block: (members, size, 12 or 13)."""
    sites, balls = problem.grid.site_places, problem.grid.ball_places
    turns = np.stack([view.turn for view in problem.views])
    shifts = np.stack([view.shift for view in problem.views]) * problem.grid.pitch
    count = 13 if not problem.scale_given else 12
    machine, artefact = np.zeros((len(sites), 3, count)), np.zeros((len(balls), 3, count))
    mounting = np.zeros((len(turns), 6, count))
    machine[:, :, :6] = bg.rigid(sites)
    mounting[:, :, :6] = -np.eye(6)
    artefact[:, :, 6:12] = bg.rigid(balls)
    # a rotation w of the artefact equals the rotation R w of the view about its shifted centre; R turns the view
    mounting[:, :3, 6:9] = -turns
    mounting[:, 3:, 9:12] = -turns
    mounting[:, :3, 9:12] = -np.cross(shifts[:, :, None], turns, axis=1)
    if not problem.scale_given:
        machine[:, :, 12], artefact[:, :, 12] = sites, -balls
        mounting[:, :3, 12] = -shifts
    return {bg.MACHINE: machine, bg.ARTEFACT: artefact, bg.VIEW: mounting}


def _machine_fields(design: FieldDesign) -> tuple[Array, Array]:
    """Return an orthonormal basis of the open machine errors, (3 sites, k), and the same as fields (sites, 3, k)."""
    columns = design.partition.columns[bg.MACHINE]
    null = np.where((columns >= 0)[:, :, None], design.null[np.maximum(columns, 0)], 0.0).reshape(columns.size, -1)
    left, sizes, _ = thin_svd(null)
    basis = left[:, sizes > 1e-9 * sizes.max(initial=1e-300)]
    return basis, basis.reshape(*columns.shape, -1)


def _families(problem: GridProblem, basis: Array, fields: Array, extra: int) -> Iterator[UndeterminedFields]:
    """Yield the families, the simplest patterns first, each without the directions of the families before it."""
    # rigid motions and the common scale are stated apart, whatever pattern contains them
    named = _within(basis, _standard(problem)[bg.MACHINE].reshape(len(basis), -1))
    left = extra
    for pattern, projector in patterns(problem):
        inside = basis.T @ projector(fields).reshape(basis.shape)
        values, vectors = np.linalg.eigh((inside + inside.T) / 2)
        open_vectors = vectors[:, values > 1 - _ONE]
        fresh = open_vectors - named @ (named.T @ open_vectors)
        new, sizes, _ = thin_svd(fresh)
        new = new[:, sizes > 1e-4]
        if new.shape[1]:
            named = np.concatenate([named, new], axis=1)
            left -= new.shape[1]
            yield UndeterminedFields(pattern, new.shape[1])
    if left > 0:
        yield UndeterminedFields("other fields that look the same in every view", left)


def _loose_mountings(problem: GridProblem, design: FieldDesign) -> Iterator[UndeterminedFields]:
    """Yield the views whose mounting is open and moves neither field, such as a view of one ball or of one row."""
    null, places = _evened(problem, design), design.partition.columns[bg.VIEW]
    fields = np.setdiff1d(np.arange(len(null)), places)
    _, sizes, mix = thin_svd(null[fields])
    alone = null @ mix[sizes < _NEGLIGIBLE].T
    for view, at in zip(problem.views, places, strict=True):
        count = int(np.linalg.matrix_rank(alone[at[at >= 0]], tol=_NEGLIGIBLE)) if alone.size else 0
        if count:
            yield UndeterminedFields(
                f"turns of view '{view.name}', whose balls are fewer than three or in a row", count
            )


def _within(basis: Array, fields: Array) -> Array:
    """Return an orthonormal basis of fields in the coordinates of `basis`."""
    inside = basis.T @ fields
    lengths = np.linalg.norm(fields, axis=0)
    inside = inside[:, lengths > 0] / lengths[lengths > 0]
    left, sizes, _ = thin_svd(inside)
    return left[:, sizes > 1e-6]


def candidates() -> Iterator[tuple[str, bg.View]]:
    """Yield simple views in words: shifts by a pitch, and turns by 90 degrees."""
    for a in range(3):
        yield f"shifted by one pitch along {'xyz'[a]}", bg.View("+", np.eye(3), np.eye(3)[a])
    for axis in "xyz":
        turn = Rotate(axis, _QUARTER).matrix
        yield turn_in_words(turn), bg.View("+", turn, np.zeros(3))


def _left_with(problem: GridProblem, design: FieldDesign, view: bg.View) -> int:
    """Return how many directions stay open with one more view: those Z c that a mounting of this view can absorb."""
    at = bg.numbers_at(problem.grid.sites, view.sites(problem.grid.balls))
    balls = np.flatnonzero(at >= 0)
    artefact = np.einsum("ab,nbk->nak", view.turn, _entries(design, bg.ARTEFACT)[balls])
    seen = _entries(design, bg.MACHINE)[at[balls]] + artefact
    flat = seen.reshape(-1, seen.shape[2])
    mounting = np.linalg.qr(bg.rigid(problem.grid.sites[at[balls]] / problem.grid.half.max()).reshape(len(flat), 6))[0]
    flat = flat - mounting @ (mounting.T @ flat)
    values = np.linalg.eigvalsh(flat.T @ flat)
    return int((values < 1e-9 * max(values.max(initial=0.0), 1e-12)).sum())


def _entries(design: FieldDesign, block: str) -> Array:
    columns = design.partition.columns[block]
    # columns of unit length: what counts as 0 below is a share of them
    null = design.null / np.linalg.norm(design.null, axis=0)
    return np.where((columns >= 0)[:, :, None], null[np.maximum(columns, 0)], 0.0)
