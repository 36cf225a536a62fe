"""What a long computation reports while it goes on."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Protocol

from metrocli.frozen import dataclass


class Progress(Protocol):
    """Receives what a computation does, and how much of that is done."""

    def doing(self, line: str, most: float = math.inf) -> None:
        """Take what is done from now on; the search in it ends after `most` CPU time at the latest [s]."""

    def count(self, done: int, of: int | None) -> None:
        """Take how many parts of that are done, of how many if that is known."""


class Silent:
    """Progress that nobody follows."""

    def doing(self, line: str, most: float = math.inf) -> None:
        return None

    def count(self, done: int, of: int | None) -> None:
        return None


SILENT = Silent()


@dataclass(frozen=True)
class Named:
    """Progress whose lines begin with a name, such as that of a job file."""

    name: object
    whole: Progress

    def doing(self, line: str, most: float = math.inf) -> None:
        self.whole.doing(f"{self.name}: {line}", most)

    def count(self, done: int, of: int | None) -> None:
        self.whole.count(done, of)


def counted(
    ordered: Callable[[Callable[[int], Any], Iterable[int]], Iterable[Any]], progress: Progress
) -> Callable[[Callable[[int], Any], Iterable[int]], Iterator[Any]]:
    """Return what applies a function to numbers as `ordered` does, and counts those that are done."""

    def counting(work: Callable[[int], Any], numbers: Iterable[int]) -> Iterator[Any]:
        every = [*numbers]
        progress.count(0, len(every))
        for done, value in enumerate(ordered(work, every), 1):
            progress.count(done, len(every))
            yield value

    return counting
