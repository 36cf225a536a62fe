"""Why no pose leaves the minimum overstock everywhere: surfaces that contradict each other, and motions left open."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from metrocli.adjust.decompositions import pivoted_qr
from metrocli.arrays import Array, Index, Mask
from metrocli.errors import UndeterminedError
from metrocli.frozen import dataclass
from metrocli.tasks.fit_part.fit import LEAST_MOTION, max_least_overstock_of_many
from metrocli.tasks.fit_part.nominals import on_own_patches
from metrocli.tasks.fit_part.stock import LinearStock, Stock
from metrocli.words import in_a_row

_OPEN = 1e-4
"""Singular value, relative to the largest, below which a motion changes no overstock"""
_OF_FACETS = 0.5
"""Share of the change of the overstock that a smooth surface must have: with less, the facets of the mesh bring it"""
_NO_TURN = 1e-3
"""Turn over shift of a step, both as motions of the points [mm], up to which it is a shift: rounding leaves far less"""
_SETS = 4
"""Contradictions that a refusal lists, at most"""
_TOLERANCE = 1e-6
"""Shortfall of the least overstock [mm] that is not counted"""


@dataclass(frozen=True)
class Contradiction:
    """The smallest set of surfaces that cannot all have the minimum overstock."""

    surfaces: tuple[str, ...]
    least: float
    """Largest least overstock that they allow [mm]"""
    points: tuple[int, ...]
    """Points that hold it"""
    without: tuple[float, ...] = ()
    """Largest least overstock of the part without each of the surfaces [mm]: inf without limit, nan if none is left"""


def feasible(least: float, minimum: float) -> bool:
    """Return whether the largest least overstock allows a minimum."""
    return least >= minimum - _TOLERANCE


def contradictions(stock: Stock, minimum: float, to_part: Array) -> list[Contradiction]:
    """Return sets of contradicting surfaces that share none, until the other surfaces have the minimum together.

    The first one holds the largest least overstock of all, and has what the part leaves without its surfaces. There are
    at most `_SETS`. `to_part` has the largest least overstock.
    """
    stock, rows, begun, duals = _contradicting(stock, minimum, to_part)
    first = contradiction(stock, duals, minimum, to_part, begun)
    left_out = (stock.surface != stock.nominal.names.index(name) for name in first.surfaces)
    without = tuple(_least(stock, others, to_part, begun)[0] for others in left_out)
    sets = [replace(first, points=tuple(rows[list(first.points)].tolist()), without=without)]
    while len(sets) < _SETS:
        named = {name for contradiction in sets for name in contradiction.surfaces}
        others = ~np.isin(stock.surface, [stock.nominal.names.index(name) for name in named])
        if not others.any():
            break
        stock, begun, rows = stock.of(others), begun.of(others), rows[others]
        _, least, duals = max_least_overstock_of_many(stock, to_part, begun=begun)
        if feasible(least, minimum):
            break
        further = contradiction(stock, duals, minimum, to_part, begun)
        if feasible(further.least, minimum):
            break
        sets.append(replace(further, points=tuple(rows[list(further.points)].tolist())))
    return sets


def _contradicting(stock: Stock, minimum: float, to_part: Array) -> tuple[Stock, Index, LinearStock, Array]:
    """Return points that cannot all have the minimum, with their rows, their overstock at the pose, and their duals.

    On a mesh a point counts for its own patch alone: in a notch, a wall that is left out would still hold points of the
    floor, which then stood for it. One that has the level of no patch nearby counts for none. Only where the others
    have the minimum it counts for the nearest, and only where each patch alone has the minimum, the walls hold points
    of others.
    """
    every = np.arange(len(stock.measured))
    tried, patches = [(stock, every)], stock.nominal.apart()
    if patches is not None:
        alone, at_level = on_own_patches(stock, patches, to_part)
        tried = [(alone, every[at_level]), (alone, every), *tried]
    for part, rows in tried:
        some = part.of(rows)
        begun = some.at(to_part)
        _, least, duals = max_least_overstock_of_many(some, to_part, begun=begun)
        if not feasible(least, minimum):
            break
    return some, rows, begun, duals


def contradiction(stock: Stock, duals: Array, minimum: float, to_part: Array, begun: LinearStock) -> Contradiction:
    """Return the smallest set of contradicting surfaces; without any one of them the others have the minimum.

    The surfaces that hold the largest least overstock contradict each other. Each is left out in turn, and stays out if
    the rest still does (deletion filter of Chinneck and Dravnieks 1991). Then smaller sets of them are tried. `begun`
    is the overstock at the pose from which all are sought.
    """

    def together(surfaces: Sequence[int]) -> bool:
        enough = minimum - _TOLERANCE
        return _least(stock, np.isin(stock.surface, surfaces), to_part, begun, enough)[0] >= enough

    holding = np.unique(stock.surface[duals > 0]).tolist()
    chosen = holding
    for number in holding:
        rest = [other for other in chosen if other != number]
        if rest and not together(rest):
            chosen = rest
    # the filter leaves a set of which each surface is needed, which need not be the smallest
    smaller = (some for size in range(1, len(chosen)) for some in combinations(holding, size))
    chosen = next((list(some) for some in smaller if not together(some)), chosen)
    # the search is local, and may get round on a mesh where it goes on beyond the minimum
    for surfaces in (chosen, holding):
        rows = np.isin(stock.surface, surfaces)
        least, held = _least(stock, rows, to_part, begun)
        if not feasible(least, minimum):
            break
    points = tuple(np.flatnonzero(rows)[held > 0].tolist())
    return Contradiction(tuple(stock.nominal.names[surface] for surface in surfaces), least, points)


def _least(stock: Stock, rows: Mask, to_part: Array, begun: LinearStock, enough: float = np.inf) -> tuple[float, Array]:
    """Return the largest least overstock of some points and their duals, nan without points."""
    if not rows.any():
        return np.nan, np.zeros(0)
    return max_least_overstock_of_many(stock.of(rows), to_part, enough, begun.of(rows))[1:]


def refuse(
    contradictions: Sequence[Contradiction], names: Sequence[str], minimum: float, whole: float, hint: str
) -> UndeterminedError:
    """Return the error of an infeasible fit; `whole` is the largest least overstock of all surfaces [mm].

    `hint` is another cause, such as points on the wrong side, or empty.
    """
    first, *further = contradictions
    together = in_a_row(first.surfaces)
    points = ", ".join(names[row] for row in first.points[:8])
    # rounded down: what is offered has to be possible
    possible = np.floor(whole * 100) / 100
    what = (
        f"`minimum: {possible:.2f} mm` would do for all surfaces"
        if possible > 0
        else f"no minimum above {possible:.2f} mm would do: material is missing"
    )
    several = len(first.surfaces) > 1
    contradict = "surfaces that contradict each other" if several else "surface that contradicts itself"
    each = [
        f"{least:.3f} mm without {name}" if np.isfinite(least) else f"unlimited overstock without {name}"
        for name, least in zip(first.surfaces, first.without, strict=True)
        if not np.isnan(least)
    ]
    lines = [
        f"no pose of the ideal part leaves {minimum:g} mm of overstock everywhere",
        f"  {contradict}: {together}",
        f"  by how much: they leave at most {first.least:.3f} mm at their lowest points, "
        f"{minimum - first.least:.3f} mm less than required (points {points})",
        *(["  without any one of these surfaces the others of them have the minimum"] if several else []),
        *([f"  the whole part leaves {in_a_row(each)}"] if each else ["  the part has no other surface"]),
        *(
            f"  beside them: {in_a_row(set_of_points.surfaces)} (at most {set_of_points.least:.3f} mm)"
            for set_of_points in further
        ),
        f"  {what}",
    ]
    lines += [f"  or: {hint}"] if hint else []
    return UndeterminedError("\n".join(lines))


def wrong_side(turned: Sequence[str]) -> str:
    """Return the sentence about surfaces whose material seems to be on the other side."""
    return (
        f"the points of {in_a_row(turned)} lie on the wrong side of the surface: with its material on the other side "
        "the overstock varies less than half as much; turn its normal over, or exchange "
        "`material: inside` and `outside`"
    )


def all_inside(level: Array, of_mesh: bool) -> str:
    """Return the sentence about points that are all inside the ideal part, by the level of each surface; or nothing."""
    known = level[~np.isnan(level)]
    if (known >= 0).any():
        return ""
    cause = (
        "the mesh may be that of the raw part, or the points those of another part"
        if of_mesh
        else "if the normals point into the material, turn them over, and exchange `material: inside` and `outside`"
    )
    return (
        f"the points of every surface lie on the wrong side, inside the ideal part (levels {known.min():.2f} to "
        f"{known.max():.2f} mm): {cause}"
    )


def must_be_determined(stock: Stock, to_part: Array, aim: str) -> tuple[str, ...]:
    """Raise UndeterminedError if the points leave a motion of the part open that its aim does not decide.

    For least-motion an open motion is not a fault: the part stays there as it was. Returns sentences about that.
    """
    local = stock.at(to_part)
    smooth = stock.smooth_rows(local)
    motions = [motion_in_words(local, motion) for motion in _null_space(smooth, local.rows)]
    if motions and aim == LEAST_MOTION:
        return (f"the overstock does not change with {in_a_row(motions)}: there the part stays where it was",)
    if motions:
        raise UndeterminedError(
            f"the points give {6 - len(motions)} independent constraints of the 6 that a pose needs\n"
            f"  undetermined, since no overstock changes: {in_a_row(motions)}\n"
            "  what would determine it: points on a surface across that motion, or `aim: least-motion`"
        )
    # of the differences to the mean: motions that change all overstocks alike
    alike = _null_space(smooth - smooth.mean(axis=0), local.rows - local.rows.mean(axis=0))
    if alike and aim != LEAST_MOTION:
        raise UndeterminedError(
            f"the aim '{aim}' does not determine the pose\n"
            "  undetermined, since the overstock of all points changes alike: "
            f"{in_a_row([motion_in_words(local, motion) for motion in alike])}\n"
            "  what would determine it: points on an opposite surface, or `aim: least-motion`"
        )
    return ()


def motions_without(stock: Stock, local: LinearStock, chosen: Mask) -> list[str]:
    """Return the motions that change the overstock of no chosen point, in words."""
    smooth, rows = stock.smooth_rows(local) * chosen[:, None], local.rows * chosen[:, None]
    return [motion_in_words(local, motion) for motion in _null_space(smooth, rows)]


def open_motions(stock: Stock, to_part: Array) -> list[Array]:
    """Return the steps of the pose that change no overstock, each (6,)."""
    local = stock.at(to_part)
    return _null_space(stock.smooth_rows(local), local.rows)


def _null_space(smooth: Array, rows: Array) -> list[Array]:
    """Return the steps of the pose that change nothing, each (6,): turns, then shifts, along axes where they can be.

    Nothing but what facets bring: `smooth` (n, 6) are the derivatives without them, `rows` (n, 6) with them.
    """
    eigenvalues, vectors = np.linalg.eigh(smooth.T @ smooth)
    with_facets = ((rows @ vectors) ** 2).sum(axis=0)
    steps = vectors[:, eigenvalues < np.maximum(_OPEN**2 * eigenvalues[-1], _OF_FACETS**2 * with_facets)]
    # turned so that as many steps as can be have no turn: a mixture of turns and shifts would not be in words
    _, _, mix = np.linalg.svd(steps[3:], full_matrices=True)
    steps = (steps @ mix.T).T
    turned = ~_is_shift(steps)
    turns, shifts = steps[turned], steps[~turned][:, :3]
    return [*_along_axes(turns[:, 3:]) @ turns, *np.pad(_along_axes(shifts) @ shifts, ((0, 0), (0, 3)))]


def _along_axes(directions: Array) -> Array:
    """Return the mixture (k, k) of directions (k, 3), k independent ones, that runs along axes where it can."""
    # the pivots take those axes first that lie most in the directions
    back = np.linalg.pinv(directions)
    along, _, _ = pivoted_qr(back @ directions)
    return np.asarray(along.T[: len(directions)] @ back)


def _is_shift(step: Array) -> Mask:
    """Return whether steps (..., 6) have no turn that counts."""
    return np.asarray(np.linalg.norm(step[..., 3:], axis=-1) < _NO_TURN * np.linalg.norm(step[..., :3], axis=-1))


def motion_in_words(local: LinearStock, step: Array) -> str:
    """Return a step of the pose in words: a shift, or a turn about an axis in the part frame."""
    turn = step[3:] / local.lever
    if _is_shift(step):
        return f"a shift along {_direction(step[:3])}"
    axis = turn / np.linalg.norm(turn)
    # where `u + turn x (p - c)` is along the axis alone
    through = local.centre + np.cross(turn, step[:3]) / (turn @ turn)
    place = ", ".join(f"{value:.0f}" for value in through.round() + 0.0)
    return f"a turn about the direction {_direction(axis)} through ({place}) mm"


def _direction(vector: Array) -> str:
    unit = vector / np.linalg.norm(vector)
    for k, name in enumerate("xyz"):
        if abs(unit[k]) > 0.999:
            return name
    return "(" + ", ".join(f"{value:.2f}" for value in unit) + ")"
