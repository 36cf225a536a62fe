"""Errors that are reported to the user, each with its exit code, and faults with their place in a file."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict
from typing import Any

from metrocli.frozen import dataclass

SHOWN = 160
"""Most characters of an offending line that are shown."""
NO_MEMORY = "the memory that this program may take is not enough"
"""In place of MemoryError, which is not a defect"""


@dataclass(frozen=True)
class Fault:
    """One fault at one place of a job file, an input or the command line."""

    message: str
    file: str = ""
    line: int | None = None
    column: int | None = None
    source: str | None = None
    """The offending line of the file, shown above the caret, which stands under a column only."""
    hint: str | None = None
    """What was expected, or the nearest known word."""

    def __str__(self) -> str:
        place = ":".join(str(part) for part in (self.file, self.line, self.column) if part not in (None, ""))
        text = f"{place}: error: {self.message}" if place else f"error: {self.message}"
        if self.source is not None and self.line is not None:
            cut, shown = self._shown(self.source)
            caret = "" if self.column is None else f"{' ' * (self._start - cut)}^ "
            below = f"{caret}{self.hint or ''}".rstrip()
            return f"{text}\n{self.line:6d} | {shown}" + (f"\n       | {below}" if below else "")
        return f"{text}\n       {self.hint}" if self.hint else text

    @property
    def _start(self) -> int:
        return max((self.column or 1) - 1, 0)

    def _shown(self, source: str) -> tuple[int, str]:
        """Return the part of the offending line around the fault, and where in the line it begins."""
        cut = max(self._start - SHOWN // 2, 0) if len(source) > SHOWN else 0
        return cut, source[cut : cut + SHOWN].replace("\t", " ")

    def as_data(self) -> dict[str, Any]:
        """Return the fault for programs: its fields, and of a long line the part that is shown."""
        return asdict(self) | ({} if self.source is None else {"source": self._shown(self.source)[1]})


class MetrocliError(Exception):
    """A failure that the command line reports as a message, without a traceback."""

    exit_code = 1


class UsageError(MetrocliError):
    """The command line is wrong, or a command was given a job of another kind."""

    exit_code = 2


class InputError(MetrocliError):
    """A job file or an input is wrong, or an output cannot be written; holds every fault found."""

    exit_code = 3

    def __init__(self, faults: Sequence[Fault] | str) -> None:
        self.faults: tuple[Fault, ...] = (Fault(faults),) if isinstance(faults, str) else tuple(faults)
        super().__init__("\n".join(str(fault) for fault in self.faults))


@contextmanager
def all_faults() -> Iterator[Callable[[], AbstractContextManager[None]]]:
    """Collect the faults of several parts, each in a context of its own; at the end they are raised as one InputError.

    `with all_faults() as each:` and in it `with each():` around each part. What one part finds, others cannot use.
    """
    faults: list[Fault] = []

    @contextmanager
    def each() -> Iterator[None]:
        try:
            yield
        except InputError as error:
            faults.extend(error.faults)

    yield each
    if faults:
        raise InputError(faults)


class NoSolutionError(MetrocliError):
    """The adjustment of a job has no solution that can be used."""

    def __init__(self, message: str, misfit: float = float("inf"), inputs: Collection[str] = ()) -> None:
        """Take the message, and the root mean square residual in declared standard deviations.

        It is inf if no values predict the readings, and 0 if there are too few readings, since those fit anything.
        `inputs` are those that fail whatever the others contain, empty if that is not known.
        """
        super().__init__(message)
        self.misfit, self.inputs = misfit, frozenset(inputs)


class UndeterminedError(NoSolutionError):
    """The data do not determine the unknowns; the message names the combination and what would determine it."""

    exit_code = 4


class NotConvergedError(NoSolutionError):
    """The adjustment did not converge."""

    exit_code = 5
