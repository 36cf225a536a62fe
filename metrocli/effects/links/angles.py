"""Effects on angles that encoders and trackers read."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np

from metrocli.adjust.model.chain import LinkContext, Step
from metrocli.adjust.model.derivatives import through
from metrocli.adjust.model.quantities import AtQuantity, OfBlock, Quantity
from metrocli.arrays import Array
from metrocli.effects.acting import Variable, components
from metrocli.effects.links.own import OwnTerms
from metrocli.expressions.expression import parse
from metrocli.frozen import dataclass
from metrocli.geometry.rotations import rotation_from_vector
from metrocli.instruments.tracker import POLAR, cartesian, face, polar


@dataclass(frozen=True)
class Harmonic(AtQuantity):
    """A harmonic of one encoder: `phi += c cos k phi + s sin k phi` for one of two angles; columns c, s [rad].

    k = 1 is an eccentric disc, k = 2 an oval or bent one.
    """

    component: int
    order: int = 1

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the angles (2, n)."""
        c, s = local.rows(self.block)
        angle, n = self.order * value[self.component], value.shape[1]
        cos, sin = np.cos(angle), np.sin(angle)
        moved = value.copy()
        moved[self.component] += c * cos + s * sin
        by_angles = np.tile(np.eye(2)[:, :, None], n)
        by_angles[self.component, self.component] += self.order * (s * cos - c * sin)
        by_block = np.zeros((2, 2, n))
        by_block[self.component] = cos, sin
        return Step(moved, by_angles, {self.block: by_block})


@dataclass(frozen=True)
class NonOrthogonality(AtQuantity):
    """The tilt axis is not square to the base axis: `base += angle tan(tilt)`; column angle [rad]."""

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the angles (2, n)."""
        angle, n = local.rows(self.block)[0], value.shape[1]
        tangent = np.tan(value[1])
        by_angles = np.tile(np.eye(2)[:, :, None], n)
        by_angles[0, 1] = angle * (1 + tangent**2)
        by_block = np.zeros((2, 1, n))
        by_block[0, 0] = tangent
        return Step(np.stack([value[0] + angle * tangent, value[1]]), by_angles, {self.block: by_block})


@dataclass(frozen=True)
class BaseTilt(AtQuantity):
    """The base axis is `Rx(tx) Ry(ty) z`, so the unit sees a beam b as `Ry(-ty) Rx(-tx) b`; columns tx, ty [rad]."""

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the beam (3, n)."""
        tx, ty = local.rows(self.block)[:, 0]
        cx, sx, cy, sy = np.cos(tx), np.sin(tx), np.cos(ty), np.sin(ty)
        about_x = np.array([[1, 0, 0], [0, cx, sx], [0, -sx, cx]])
        about_y = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]])
        first = about_x @ value
        x, y, z = first
        seen = about_y @ first
        by_tx = about_y @ np.stack([np.zeros_like(y), z, -y])
        by_ty = np.stack([-sy * x - cy * z, np.zeros_like(y), cy * x - sy * z])
        by_beam = through(about_y[:, :, None], about_x[:, :, None])
        return Step(seen, by_beam, {self.block: np.stack([by_tx, by_ty], axis=1)})


_FACE = Variable("face", "1", lambda value, local: Step(face(local)[None]))
_VARIABLES = (*components(POLAR, ("rad", "rad", "mm")), _FACE)


def polar_terms(block: str, name: str, parameters: tuple[str, ...], adds: Mapping[str, str]) -> OwnTerms:
    """Return the link of an effect that adds terms to some of azimuth, elevation and distance.

    The terms are in the parameters, in these three, and in `face`, which is 1 in face 1 and -1 in face 2.
    """
    return _terms(block, name, parameters, tuple(adds.items()))


@lru_cache(maxsize=256)
def _terms(block: str, name: str, parameters: tuple[str, ...], adds: tuple[tuple[str, str], ...]) -> OwnTerms:
    """Return the terms of a link, parsed once."""
    parsed = tuple((POLAR.index(which), parse(text)) for which, text in adds)
    return OwnTerms(block, Quantity.POLAR, name, parsed, parameters, (), _VARIABLES)


@dataclass(frozen=True)
class OnPoint:
    """A link on azimuth, elevation and distance, as it moves the point of an instrument that reads coordinates.

    Points on the vertical axis of the instrument have no azimuth.
    """

    link: OwnTerms
    takes = gives = Quantity.POINT_IN_TRACKER

    @property
    def blocks(self) -> tuple[str, ...]:
        """The blocks of the link."""
        return self.link.blocks

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point (3, n)."""
        seen, to_polar = polar(value)
        moved = self.link.step(seen, local)
        before, _ = cartesian(seen)
        after, back = cartesian(moved.value)
        by_input = through(through(back, np.asarray(moved.by_input)), to_polar)
        by_block = {name: through(back, by_unknowns) for name, by_unknowns in moved.by_block.items()}
        # as a difference the effect adds exactly nothing where its parameters are 0
        return Step(value + (after - before), by_input, by_block)


@dataclass(frozen=True)
class Tilted(OfBlock):
    """The axes of an instrument turn from a time on: `v <- R(rx, ry, 0)' v`; columns rx, ry [rad], at [s]."""

    takes = gives = Quantity.POINT_IN_TRACKER

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point (3, n)."""
        later = later_than(local, self.block)
        rx, ry = local.rows(self.block)[:2] * later
        first = _turned_back(1, ry)
        second = _turned_back(0, rx)
        x, _, z = level = _seen_through(first, value)
        moved = _seen_through(second, level)
        by_block = np.zeros((3, 3, len(later)))
        by_block[:, 0] = np.stack([np.zeros_like(x), moved[2], -moved[1]]) * later
        by_block[:, 1] = _seen_through(second, np.stack([-z, np.zeros_like(x), x])) * later
        return Step(moved, through(second, first), {self.block: by_block})


@dataclass(frozen=True)
class Turned(OfBlock):
    """An instrument turns about its standing axis from a time on: `v <- Rz(rz)' v`; columns rz [rad], at [s]."""

    takes = gives = Quantity.POINT_IN_TRACKER

    def step(self, value: Array, local: LinkContext) -> Step:
        """Return the point (3, n)."""
        later = later_than(local, self.block)
        back = _turned_back(2, local.rows(self.block)[0] * later)
        moved = _seen_through(back, value)
        by_block = np.zeros((3, 2, len(later)))
        by_block[:2, 0] = np.stack([moved[1], -moved[0]]) * later
        return Step(moved, back, {self.block: by_block})


def _turned_back(axis: int, angle: Array) -> Array:
    """Return `R'` of turns about an axis, (3, 3, n)."""
    vector = np.zeros((len(angle), 3))
    vector[:, axis] = angle
    return np.ascontiguousarray(np.transpose(rotation_from_vector(vector), (2, 1, 0)))


def _seen_through(back: Array, value: Array) -> Array:
    return np.stack([(row * value).sum(axis=0) for row in back])


def later_than(local: LinkContext, block: str) -> Array:
    """Return 1 for readings from the time `at` on, the last column of the block, else 0, (n,)."""
    return np.asarray(local.observations.conditions["t"] >= local.rows(block)[-1], dtype=float)
