"""The restricted likelihood of a state: unknowns, random effects and fixed columns beside white noise.

Errors of single units (images, beacons) are eliminated unit by unit, like the unknowns of these. What remains is one
small system of the unknowns that all readings share, the random effects that act in several units, and the fixed
columns. Method: docs/algorithms/evidence.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from metrocli.adjust.model.blocks import Array
from metrocli.adjust.model.observations import Index
from metrocli.diagnosis.linear.quadratics import factored, solved
from metrocli.frozen import dataclass

_STEPS, _FAR, _STILL = 12, 2.0, 0.01
"""Steps of the sizes at most, the largest step of ln of a variance, and the change of the likelihood that ends them"""
_LEAST = -25.0
"""Least ln of a variance ratio: nothing"""
ROUNDING = 1e-16
"""Share of the squares to which what is left of them is known"""


@dataclass(frozen=True)
class Products:
    """Products of all columns of a state, free of the local unknowns, from which its likelihood follows at any sizes.

    The shared columns stand in the order unknowns, random, fixed.
    """

    gram: Array
    """Of the shared columns, (p, p)"""
    right: Array
    """Of these with the residual, (p,)"""
    squares: float
    """Of the residual, with those that the declared noise counts for"""
    dof: float
    unknowns: int
    """Number of the shared unknowns"""
    of_shared: Index
    """Number of the random component of each shared column, -1 for the others, (p,)"""
    of_local: Index
    """Number of the random component of each local column, (k,)"""
    own: Array
    """Of the local columns of each member, (members, k, k)"""
    mixed: Array
    """Of these with the shared columns, and last with the residual, (members, k, p + 1)"""
    parts: tuple[tuple[object, int], ...] = ()
    """Keys of the shared parts and of the local ones, with their numbers of columns"""

    @cached_property
    def places(self) -> dict[object, tuple[int, int]]:
        """First column of each shared part, and that after its last."""
        ends = np.cumsum([0, *(size for _, size in self.parts)]).tolist()
        return {
            key: (a, b) for (key, _), (a, b) in zip(self.parts, pairwise(ends), strict=True) if b <= len(self.right)
        }

    @cached_property
    def fixed(self) -> int:
        """The first fixed column."""
        return self.unknowns + int((self.of_shared >= 0).sum())

    def columns(self, kept: Sequence[int], count: int) -> Index:
        """Return the shared columns without those of some of the last parts, which are the `count` fixed ones."""
        places = [*self.places.values()]
        own = [np.arange(*places[len(places) - count + j]) for j in kept]
        return np.concatenate([np.arange(self.fixed), *own])

    def keeping(self, kept: Sequence[int], count: int) -> Products:
        """Return the products without some of the `count` fixed parts."""
        at, first = self.columns(kept, count), len(self.places) - count
        parts = (*self.parts[:first], *(self.parts[first + j] for j in kept), *self.parts[first + count :])
        return replace(
            self,
            gram=_among(self.gram, at, self.fixed),
            right=self.right[at],
            of_shared=self.of_shared[at],
            mixed=self.mixed[:, :, np.append(at, -1)],
            parts=parts,
        )


@dataclass(frozen=True)
class Fit:
    """A state at some sizes of its random components."""

    products: Products
    logs: Array
    """ln of the variance of each random component, in that of the noise"""
    log_det: float
    """ln of the determinants that the restricted likelihood has, of unknowns and random components"""
    lower: Array
    """Cholesky factor of the shared system, (p, p)"""
    sought: Array
    """`lower^-1` of its right side, (p,)"""
    squares: float
    """What all columns leave of the squares"""
    half: Array
    """`L^-1` of each member's local columns, (members, k, k), with `L L' = I + D C'C D`"""
    shown: Array
    """`L^-1 D C'X` of the shared columns, then of the residual, (members, k, p + 1)"""

    @property
    def dof(self) -> float:
        """Degrees of freedom beside unknowns and random components."""
        return self.products.dof

    @property
    def fixed(self) -> int:
        """The first fixed column."""
        return self.products.fixed

    @property
    def _freedoms(self) -> int | float:
        """Degrees of freedom beside all columns but the random ones."""
        return self.dof - (len(self.sought) - self.fixed)

    @cached_property
    def likelihood(self) -> float:
        """The restricted log-likelihood of the sizes, beside unknowns and fixed columns."""
        of_fixed = 2 * float(np.log(np.diag(self.lower)[self.fixed :]).sum())
        return -(self._freedoms * float(np.log(self.squares)) + self.log_det + of_fixed) / 2

    @cached_property
    def sizes(self) -> Array:
        """Estimated coefficients of the shared columns, (p,)."""
        from scipy.linalg.lapack import dtrtrs

        return np.asarray(dtrtrs(self.lower.T, self.sought)[0]) if len(self.lower) else self.sought

    def keeping(self, kept: Sequence[int], count: int) -> Fit:
        """Return the state without some of its `count` fixed parts, at the same sizes of the random components."""
        first, at = self.fixed, self.products.columns(kept, count)
        if len(at) == len(self.sought):
            return self
        # fixed columns are the last: without some of them the factor of all before stays as it is
        rest = self.lower[at[first:], first:]
        lower, sought = _among(self.lower, at, first), self.sought[at]
        lower[first:, first:] = factored(rest @ rest.T)
        sought[first:] = solved(lower[first:, first:], rest @ self.sought[first:])
        gone = float(self.sought[first:] @ self.sought[first:] - sought[first:] @ sought[first:])
        return replace(
            self,
            products=self.products.keeping(kept, count),
            lower=lower,
            sought=sought,
            squares=self.squares + gone,
            shown=self.shown[:, :, np.append(at, -1)],
        )

    @cached_property
    def slopes(self) -> tuple[Array, Array, Array]:
        """What is found and what is expected of each random component, and twice its bend.

        The derivative of the likelihood by ln of a variance is half of found less expected: `nu u'u/(g S)` and the
        effective number of its coefficients. The last is twice the bend: the sum of squares of
        their shares.
        """
        from scipy.linalg.lapack import dpotri

        products, variance = self.products, np.exp(self.logs)
        observed, expected, bend = np.zeros((3, len(variance)))

        def add(j: int, sizes: Array, count: int, trace: float, squares: float) -> None:
            # coefficients are in units of their own standard deviation, so that their
            # squares add up to their effective number
            observed[j] += float(np.vdot(sizes, sizes))
            expected[j] += count - trace
            bend[j] += count - 2 * trace + squares

        if (products.of_shared >= 0).any():
            # the unknowns stand first: the end of the factor is that of the inverse for all after them. Of this one
            # it is the triangle above the diagonal; the factor has left zeros below
            first = products.unknowns
            inverse = dpotri(self.lower[first:, first:].T)[0]
            for j, (a, b) in _stretches(products.of_shared[first:]):
                own, variances = inverse[a:b, a:b] / variance[j], np.diag(inverse)[a:b] / variance[j]
                squares = 2 * float(np.vdot(own, own)) - float(variances @ variances)
                sizes = self.sizes[first + a : first + b] / np.sqrt(variance[j])
                add(j, sizes, b - a, float(variances.sum()), squares)
        if len(products.own) and products.of_local.size:
            left, shared = np.swapaxes(self.half, 1, 2), self.shown[:, :, :-1]
            sizes = (left @ (self.shown[:, :, -1] - shared @ self.sizes)[:, :, None])[:, :, 0]
            across = np.moveaxis(solved(self.lower, np.moveaxis(shared, 2, 0)), 0, 2)
            posterior = left @ (across @ np.swapaxes(across, 1, 2) + np.eye(shared.shape[1])) @ self.half
            for j, (a, b) in _stretches(products.of_local):
                unsettled, count = posterior[:, a:b, a:b], len(posterior) * (b - a)
                add(j, sizes[:, a:b], count, float(np.einsum("mkk->", unsettled)), float((unsettled**2).sum()))
        return observed * self._freedoms / self.squares, expected, bend


def fit_at(products: Products, logs: Array) -> Fit:
    """Return a state at ln of the variances of its random components."""
    from scipy.linalg.lapack import dtrtri

    gram, right, squares = products.gram, products.right, products.squares
    root = np.exp(np.asarray(logs) / 2)
    log_det, p = 0.0, len(right)
    half, shown = np.zeros((len(products.own), 0, 0)), np.zeros((len(products.own), 0, p + 1))
    if products.of_local.size and len(products.own):
        scale = root[products.of_local]
        # `I + D C'C D` and not `D^-2 + C'C`: it stays regular where a variance is nothing
        own = products.own * (scale[:, None] * scale) + np.eye(len(scale))
        lower = np.linalg.cholesky(own)
        log_det += 2 * float(np.log(np.einsum("mkk->mk", lower)).sum())
        half = np.stack([dtrtri(factor.T)[0].T for factor in lower])
        shown = (half * scale) @ products.mixed
        flat = shown.reshape(-1, p + 1)
        taken = flat.T @ flat
        gram = gram - taken[:p, :p]
        right = right - taken[:p, p]
        squares = squares - float(taken[p, p])
    kinds = products.of_shared
    at = np.flatnonzero(kinds >= 0)
    # the prior of a coefficient: one reading of 0 with the variance of its component
    priors = np.zeros(p)
    priors[at] = np.exp(-np.asarray(logs)[kinds[at]])
    log_det += float(np.asarray(logs)[kinds[at]].sum())
    lower = factored(gram, priors)
    # fixed columns are not in this determinant: `likelihood` and the evidence treat them differently
    log_det += 2 * float(np.log(np.diag(lower)[: products.unknowns + len(at)]).sum())
    sought = solved(lower, right)
    return Fit(
        products,
        np.asarray(logs, dtype=float),
        log_det,
        lower,
        sought,
        # a difference of large numbers is known to their rounding
        max(squares - float(sought @ sought), ROUNDING * products.squares, 1e-300),
        half,
        shown,
    )


def likeliest(fit: Fit, most: Array, steps: int = _STEPS) -> Fit:
    """Return the state at the sizes of the largest likelihood, from those of a fit on; ln of each is `most` at most.

    Each step is Newton's for each size alone. One after which the likelihood is smaller is shortened. A quarter of
    `(found - expected)'step` is what the likelihood gains by a step of Newton.
    """
    products = fit.products
    for _ in range(steps if len(most) else 0):
        observed, expected, bend = fit.slopes
        # a step of at most e^2 in a variance: from nothing the bend is near 0, and Newton's step would leave the range
        step = np.clip((observed - expected) / np.maximum(bend, 1e-9), -_FAR, _FAR)
        # where almost nothing is expected, the ratio of found to expected is the better guide
        ratio = np.log(np.maximum(observed, 1e-12) / np.maximum(expected, 1e-12))
        shorter = np.sign(ratio) * np.maximum(np.abs(ratio), np.abs(step) / 2)
        step = np.where(np.abs(step) > np.abs(ratio), shorter, step)
        step = np.clip(fit.logs + np.clip(step, -_FAR, _FAR), _LEAST, most) - fit.logs
        if (observed - expected) @ step < 4 * _STILL:
            break
        for _ in range(6):
            after = fit_at(products, fit.logs + step)
            if after.likelihood >= fit.likelihood - 1e-9:
                break
            step = step / 3
        else:
            # the last of six tries has 1/243 of the step: what is lower even there is rounding
            return fit
        gained, fit = after.likelihood - fit.likelihood, after
        if gained < _STILL:
            break
    return fit


def _among(matrix: Array, at: Index, first: int) -> Array:
    """Return a matrix at some rows and columns, of which the first ones are all."""
    submatrix = np.empty((len(at), len(at)))
    # stretches are copied several times faster than numbers one by one
    submatrix[:first, :first], submatrix[:first, first:] = matrix[:first, :first], matrix[:first, at[first:]]
    submatrix[first:] = matrix[np.ix_(at[first:], at)]
    return submatrix


def _stretches(kinds: Index) -> list[tuple[int, tuple[int, int]]]:
    """Return each random component with the stretch of its columns, by the component of each column, -1 for none."""
    begins = [0, *(np.flatnonzero(np.diff(kinds)) + 1).tolist(), len(kinds)]
    return [(int(kinds[a]), (a, b)) for a, b in pairwise(begins) if kinds[a] >= 0]
