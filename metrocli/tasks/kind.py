"""The description of a kind of job, which loads fast.

These classes are written out: `dataclasses` takes as long to load as all the rest of `metrocli --help`.
"""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from metrocli.tasks.job import Task


class Question:
    """An option that prints an answer instead of the usual summary: `--compare`, `--distance A B`."""

    def __init__(self, name: str, help: str, arguments: tuple[str, ...] = ()) -> None:
        """`arguments` are the names of its values, as the help shows them; empty for a flag."""
        self.name, self.help, self.arguments = name, help, arguments


class Kind:
    """Description of a kind of job, available without loading its mathematics."""

    def __init__(
        self,
        name: str,
        summary: str,
        measured: tuple[str, ...] = (),
        planned: tuple[str, ...] = (),
        questions: tuple[Question, ...] = (),
        result_questions: tuple[Question, ...] = (),
        chunked: bool = False,
        package: str = "",
        described: tuple[Question, ...] = (),
    ) -> None:
        self.name = name
        """Its name in job files and on the command line, such as `align-part`"""
        self.summary = summary
        """One phrase for the help"""
        self.measured = measured
        """Inputs that the measurement produces; `simulate` writes them, so they need not exist before"""
        self.planned = planned
        """Inputs that `plan` does not need"""
        self.questions = questions
        """Options of the kind's own command; `Task.answers` holds their functions"""
        self.result_questions = result_questions
        """Options of `metrocli show`; `Task.result_answers` holds their functions"""
        self.chunked = chunked
        """Whether it computes in independent chunks; its command then has the options --workers and --scheduler"""
        self.package = package
        """Package of its modules; if empty, the package of its name in `metrocli.tasks`"""
        self.described = described
        """Options of its own command that together describe a job, without a file of it; all are needed"""

    def settings(self) -> type:
        """Import and return the dataclass of the settings in a job file."""
        settings: type = self._module("settings").Settings
        return settings

    def task(self) -> Task[Any, Any]:
        """Import and return its functions."""
        task: Task[Any, Any] = self._module("task").TASK
        return task

    def figures(self, settings: Any) -> dict[str, str]:
        """Return the figures that results of a job with these settings can have, as `metrocli.tasks.shared.figures`."""
        figures: dict[str, str] = self._module("settings").figures(settings)
        return figures

    def job_of(self, *values: str | int) -> str:
        """Return the text of the job of the values of the options `described`, of its output, and of so many files."""
        text: str = self._module("settings").job_of(*values)
        return text

    def _module(self, name: str) -> Any:
        package = self.package or f"metrocli.tasks.{self.name.replace('-', '_')}"
        return import_module(f"{package}.{name}")
