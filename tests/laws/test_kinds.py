"""Every kind of job keeps the contract of `metrocli.tasks.kind`."""

from __future__ import annotations

import dataclasses
import subprocess
import sys

import pytest

from metrocli import settings, tasks
from metrocli.tasks.kind import Kind

pytestmark = pytest.mark.parametrize("kind", tasks.KINDS.values(), ids=lambda kind: kind.name)


def inputs_of(kind: Kind) -> dict[str, tuple[settings.Setting, bool]]:
    """The keys under `inputs:`."""
    wanted, _ = settings.settings_of(kind.settings())["inputs"]
    return settings.settings_of(wanted.spec.section)


def test_files_have_a_field_for_each_input(kind: Kind) -> None:
    fields = {field.name for field in dataclasses.fields(kind.task().files)}
    assert fields - {"files"} == set(inputs_of(kind))


def test_what_may_be_absent_has_a_default(kind: Kind) -> None:
    for field in dataclasses.fields(kind.task().files):
        optional = field.default is not dataclasses.MISSING or field.default_factory is not dataclasses.MISSING
        later = field.name in (*kind.measured, *kind.planned)
        given_always = field.name in inputs_of(kind) and inputs_of(kind)[field.name][1]
        assert optional or (given_always and not later)


def test_inputs_of_a_measurement_are_inputs(kind: Kind) -> None:
    assert {*kind.measured, *kind.planned} <= set(inputs_of(kind))


def test_each_question_has_an_answer(kind: Kind) -> None:
    task = kind.task()
    assert set(task.answers) == {question.name for question in kind.questions}
    assert set(task.result_answers) == {question.name for question in kind.result_questions}


def test_its_package_has_its_name(kind: Kind) -> None:
    assert kind.task().run.__module__ == f"metrocli.tasks.{kind.name.replace('-', '_')}.task"


def test_it_is_declared_without_its_mathematics(kind: Kind) -> None:
    script = f"import sys, metrocli.tasks.{kind.name.replace('-', '_')}; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0
