"""A removal of wrong readings begins anew only where what is left can hide others, and counts only if that helps."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from metrocli.adjust.rounds import undisturbed
from metrocli.errors import UndeterminedError


def ended(sigma0: float, p_value: float) -> Any:
    return SimpleNamespace(solution=SimpleNamespace(sigma0=sigma0, p_value=p_value))


@pytest.mark.parametrize(
    ("plain", "other", "taken"),
    [
        (ended(1.02, 0.3), ended(1.0, 0.5), False),
        (ended(1.02, 1e-14), ended(1.0, 0.5), False),
        (ended(1.6, 1e-4), ended(1.0, 0.5), True),
        (ended(1.6, 1e-4), ended(1.5, 1e-3), False),
    ],
    ids=["fits", "so many readings that chance exceeds less", "hidden errors", "noise declared too small"],
)
def test_which_removal_counts(plain: Any, other: Any, taken: bool) -> None:
    assert undisturbed(lambda always: other if always else plain) is (other if taken else plain)


def test_without_a_second_solution_the_first_stands() -> None:
    plain = ended(1.6, 1e-4)

    def solved(always: bool) -> Any:
        if always:
            raise UndeterminedError("nothing is left")
        return plain

    assert undisturbed(solved) is plain
