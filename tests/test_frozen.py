"""Frozen classes behave as those of `dataclasses`."""

from __future__ import annotations

import copy
import dataclasses
import inspect
import pickle
from collections.abc import Callable
from typing import Any, ClassVar

import pytest

from metrocli import frozen


def family(dataclass: Callable[..., Any]) -> dict[str, Any]:
    """Return classes with all kinds of fields, made by one of both decorators."""

    @dataclass(frozen=True)
    class Plain:
        """Two numbers."""

        first: int
        second: float = 2.0

    @dataclass(frozen=True)
    class Empty:
        """Nothing."""

    @dataclass(frozen=True)
    class Made:
        """Fields of all kinds."""

        kind: ClassVar[str] = "made"
        none: list[int] = dataclasses.field(default_factory=list)
        hidden: int = dataclasses.field(default=3, repr=False, compare=False)
        later: list[int] = dataclasses.field(default_factory=list, init=False)
        fixed: int = dataclasses.field(default=7, init=False)

    @dataclass(frozen=True)
    class Heir(Plain):
        """One more field, and one replaced."""

        second: float = 5.0
        third: str = "c"

    @dataclass(frozen=True, kw_only=True)
    class Named:
        """Named fields."""

        optional: int = 1
        wanted: int

    @dataclass(frozen=True)
    class Checked:
        """Refuses and computes."""

        size: int

        def __post_init__(self) -> None:
            if self.size < 0:
                raise ValueError(self.size)
            object.__setattr__(self, "twice", 2 * self.size)

    @dataclass(frozen=True)
    class Own:
        """Has methods of its own."""

        size: int

        def __eq__(self, other: object) -> bool:
            return isinstance(other, Own) and self.size % 10 == other.size % 10

        def __repr__(self) -> str:
            return "own"

    return {made.__name__: made for made in (Plain, Empty, Made, Heir, Named, Checked, Own)}


OURS, THEIRS = family(frozen.dataclass), family(dataclasses.dataclass)
CALLS = [
    ("Plain", (1,), {}),
    ("Plain", (1, 3.0), {}),
    ("Plain", (), {"second": 1.0, "first": 2}),
    ("Plain", (), {}),
    ("Plain", (1, 2, 3), {}),
    ("Plain", (1,), {"other": 2}),
    ("Empty", (), {}),
    ("Made", ([4], 5), {}),
    ("Made", (), {}),
    ("Made", (), {"later": []}),
    ("Heir", (1,), {}),
    ("Heir", (1, 2.0, "d"), {}),
    ("Named", (), {"wanted": 2}),
    ("Named", (2,), {}),
    ("Checked", (4,), {}),
    ("Checked", (-4,), {}),
    ("Own", (14,), {}),
]


def seen(one: Any) -> Any:
    return vars(one), repr(one).replace("family.<locals>.", ""), dataclasses.asdict(one)


def outcome(act: Callable[[], Any]) -> Any:
    try:
        return act()
    except Exception as error:
        return type(error), str(error)


@pytest.mark.parametrize(("name", "values", "named"), CALLS)
def test_instances_are_as_those_of_dataclasses(name: str, values: Any, named: Any) -> None:
    ours, theirs = (outcome(lambda made=made: seen(made[name](*values, **named))) for made in (OURS, THEIRS))
    assert ours == theirs


@pytest.mark.parametrize("name", OURS)
def test_classes_are_as_those_of_dataclasses(name: str) -> None:
    ours, theirs = OURS[name], THEIRS[name]
    assert [str(one.name) for one in dataclasses.fields(ours)] == [one.name for one in dataclasses.fields(theirs)]
    assert list(inspect.signature(ours).parameters) == list(inspect.signature(theirs).parameters)
    assert ours.__match_args__ == theirs.__match_args__ and ours.__doc__ == theirs.__doc__


@pytest.mark.parametrize(("first", "second"), [((1,), (1, 2.0)), ((1,), (2,)), ((1, 5.0), (1, 5.0))])
def test_equal_ones_have_equal_hashes(first: Any, second: Any) -> None:
    for name in ("Plain", "Heir"):
        (a, b), (c, d) = ((made[name](*first), made[name](*second)) for made in (OURS, THEIRS))
        assert (a == b) == (c == d) and (hash(a) == hash(b)) == (hash(c) == hash(d))
    assert OURS["Plain"](1, 5.0) != OURS["Heir"](1, 5.0) and OURS["Empty"]() == OURS["Empty"]()


def test_what_is_not_compared_does_not_count() -> None:
    assert OURS["Made"]([], 1) == OURS["Made"]([], 2) != OURS["Made"]([1], 2)
    with pytest.raises(TypeError, match="unhashable"):
        hash(OURS["Made"]())


def test_methods_of_a_class_itself_stay() -> None:
    assert OURS["Own"](4) == OURS["Own"](14) != OURS["Own"](5) and repr(OURS["Own"](4)) == "own"
    assert hash(OURS["Own"](4)) == hash(OURS["Own"](4))


def test_nothing_can_be_assigned_or_deleted() -> None:
    one = OURS["Plain"](1)
    with pytest.raises(dataclasses.FrozenInstanceError, match="cannot assign to field 'first'"):
        one.first = 2
    with pytest.raises(dataclasses.FrozenInstanceError, match="cannot delete field 'first'"):
        del one.first
    assert one.first == 1


def test_each_instance_has_its_own_default() -> None:
    assert OURS["Made"]().none is not OURS["Made"]().none and OURS["Made"].kind == "made"


def test_functions_of_dataclasses_take_them() -> None:
    assert dataclasses.replace(OURS["Heir"](1), third="z") == OURS["Heir"](1, 5.0, "z")
    with pytest.raises(ValueError, match="later"):
        dataclasses.replace(OURS["Made"](), later=[1])


def test_both_kinds_inherit_from_each_other() -> None:
    @dataclasses.dataclass(frozen=True)
    class Theirs(OURS["Plain"]):
        third: int = 3

    @frozen.dataclass(frozen=True)
    class Ours(Theirs):
        """One more."""

        fourth: int = 4

    assert dataclasses.astuple(Ours(1)) == (1, 2.0, 3, 4)
    for one in (Theirs(1), Ours(1)):
        with pytest.raises(dataclasses.FrozenInstanceError):
            one.first = 2


@frozen.dataclass(frozen=True)
class Sent:
    """Two numbers that travel."""

    first: int
    second: int = 2


def test_copies_are_equal() -> None:
    one = Sent(1)
    assert pickle.loads(pickle.dumps(one)) == copy.copy(one) == copy.deepcopy(one) == one


def test_what_contains_itself_is_shown() -> None:
    one = OURS["Made"]()
    one.none.append(one)
    assert "..." in repr(one)


def test_classes_that_are_not_frozen_are_refused() -> None:
    with pytest.raises(ValueError, match="frozen"):
        frozen.dataclass(frozen=False)
