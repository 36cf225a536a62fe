"""Frozen dataclasses that share their methods.

`dataclasses` writes and compiles six methods for each class, half a millisecond of them: for the hundreds of classes
that a command loads, a quarter of the time of a small job. Here only `__init__` is compiled for each class. All else
is as with `dataclasses`: its functions take these classes, both kinds inherit from each other, and a type checker sees
`dataclasses.dataclass`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

__all__ = ["dataclass"]

if TYPE_CHECKING:
    from dataclasses import dataclass
else:
    import dataclasses
    from functools import partial
    from operator import attrgetter
    from reprlib import recursive_repr

    def dataclass(*, frozen, kw_only=False):
        """Return a decorator as `dataclasses.dataclass` does with these arguments; ValueError unless frozen."""
        if not frozen:
            raise ValueError("classes that are not frozen are made by `dataclasses`")
        return partial(_made, kw_only)

    def _made(kw_only, cls):
        own = dict(vars(cls))
        cls.__doc__ = cls.__doc__ or cls.__name__  # else `dataclasses` parses the signature of the class to write one
        # `dataclasses` compiles nothing for a class that is not frozen, but that cannot inherit from a frozen one
        inherits = any(map(dataclasses.is_dataclass, cls.__mro__[1:]))
        dataclasses.dataclass(cls, init=False, repr=False, eq=False, frozen=inherits, kw_only=kw_only)
        cls.__dataclass_params__.frozen = True
        fields = dataclasses.fields(cls)
        cls.__dataclass_compared__ = attrgetter(*(field.name for field in fields if field.compare), "__class__")
        for name, method in {"__init__": _initialiser(cls, fields), **_SHARED}.items():
            if own.get(name) is None:  # Python sets `__hash__` to None where a class has its own `__eq__`
                setattr(cls, name, method)
        return cls

    def _initialiser(cls, fields):
        """Return the compiled `__init__`; defaults and factories are found by the number of their field."""
        places, keywords, lines, known = ["self"], ["*"], ["pass"], {"_put": object.__setattr__, "_none": object()}
        for k, field in enumerate(fields):
            made = field.default_factory is not dataclasses.MISSING
            known |= {f"_default{k}": field.default, f"_factory{k}": field.default_factory}
            default = "=_none" if made else "" if field.default is dataclasses.MISSING else f"=_default{k}"
            given = f"_factory{k}() if {field.name} is _none else {field.name}" if made else field.name
            if field.init:
                (keywords if field.kw_only else places).append(field.name + default)
            if field.init or made:
                lines.append(f"_put(self, {field.name!r}, {given if field.init else f'_factory{k}()'})")
        if hasattr(cls, "__post_init__"):
            lines.append("self.__post_init__()")
        parameters = ", ".join([*places, *(keywords if len(keywords) > 1 else [])])
        exec("def __init__(" + parameters + "):\n " + "\n ".join(lines), known)
        method = known["__init__"]
        method.__qualname__, method.__module__ = f"{cls.__qualname__}.__init__", cls.__module__
        method.__annotations__ = {field.name: field.type for field in fields if field.init}
        return method

    @recursive_repr()
    def _repr(self):
        shown = ", ".join(
            f"{field.name}={getattr(self, field.name)!r}" for field in dataclasses.fields(self) if field.repr
        )
        return f"{type(self).__qualname__}({shown})"

    def _eq(self, other):
        if other.__class__ is not self.__class__:
            return NotImplemented
        return self.__dataclass_compared__(self) == self.__dataclass_compared__(other)

    def _hash(self):
        return hash(self.__dataclass_compared__(self))

    def _setattr(self, name, value):
        raise dataclasses.FrozenInstanceError(f"cannot assign to field {name!r}")

    def _delattr(self, name):
        raise dataclasses.FrozenInstanceError(f"cannot delete field {name!r}")

    _SHARED = {
        "__repr__": _repr,
        "__eq__": _eq,
        "__hash__": _hash,
        "__setattr__": _setattr,
        "__delattr__": _delattr,
    }
