"""Steps that several adjustments may take together: another reading of a file is tried with few of them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from metrocli.errors import NotConvergedError

# a context variable and not an argument: adjustments that count are deep below the try that allows them
_LEFT: ContextVar[int | None] = ContextVar("steps left", default=None)


@contextmanager
def allowance(steps: int) -> Iterator[None]:
    """Let the adjustments inside take so many steps together; the next one raises NotConvergedError."""
    token = _LEFT.set(steps)
    try:
        yield
    finally:
        _LEFT.reset(token)


def take(steps: int = 1) -> None:
    """Count a step of an adjustment, or work that takes as long; raises NotConvergedError if too few are left."""
    left = _LEFT.get()
    if left is None:
        return
    if left < steps:
        raise NotConvergedError("the adjustment did not converge within its steps")
    _LEFT.set(left - steps)


def is_short(reserve: int) -> bool:
    """Return whether fewer steps than a reserve are left: a try ends its start, so that its adjustment can begin."""
    left = _LEFT.get()
    return left is not None and left < reserve
