"""What `require:` can name is known before anything is computed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from places import SAMPLES

from metrocli import tasks
from metrocli.project import runner
from metrocli.project.inputs import read_inputs
from metrocli.project.job import JobOptions, load
from metrocli.project.requirements import units_among, values_of
from metrocli.project.steps import load_project

ONE_OF_EACH = {
    "calibrate-camera": ("spindle-camera", "jobs/calibrate.yaml", "cx", "px"),
    "align-part": ("spindle-camera", "jobs/align.yaml", "gamma_s", "rad"),
    "multilaterate": ("gear-m3d3", "jobs/tip3.yaml", "LT1.dead_path", "mm"),
    "selfcal-grid": ("ball-cube", "jobs/views.yaml", "1.alpha", "rad"),
    "locate-launch-unit": ("xm60-launch-unit", "jobs/errors.yaml", "gamma", "rad"),
    "calibrate-machine": ("machine-lengths", "jobs/lengths.yaml", "C0Y", "rad"),
    "adjust-network": ("hall-trackers", "jobs/hall.yaml", "S1.alpha", "rad"),
    "fit-part": ("raw-part", "jobs/fit.yaml", "x", "mm"),
    "fit-points": ("best-fit", "jobs/fit.yaml", "x", "mm"),
    "report-uncertainty": ("gauge-block", "jobs/gum.yaml", "l", "nm"),
}
"""Sample, job, and one of its estimates with its unit"""


@pytest.fixture
def started(tmp_path: Path, metrocli: Callable[..., Any], monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Make a new project from a sample; it is the working folder."""

    def start(sample: str) -> None:
        metrocli("init", tmp_path / "new", "--sample", sample)
        monkeypatch.chdir(tmp_path / "new")

    return start


def _requires(file: Path, text: str) -> int:
    """Write `require:` into a job; return its line."""
    lines = [line for line in file.read_text().splitlines() if not line.startswith("require:")]
    file.write_text("\n".join([*lines, f"require: {text}"]) + "\n")
    return len(lines) + 1


@pytest.mark.parametrize("kind", tasks.KINDS)
def test_a_typo_is_found_with_file_line_and_what_is_allowed(
    kind: str, started: Callable[[str], None], metrocli: Callable[..., Any]
) -> None:
    sample, file, estimate, unit = ONE_OF_EACH[kind]
    started(sample)
    other = "K" if unit != "K" else "mm"
    line = _requires(Path(file), f"{{rejectd: '< 1', {estimate}.std: '< 1 {unit}', {estimate}: '< 1 {other}'}}")
    for command in ("check", "run", "status"):
        found = metrocli(command, ".")
        assert found.code == 3
        assert f"{file}:{line}:" in found.err
        assert "the result has no value 'rejectd'" in found.err
        assert "did you mean" in found.err or "allowed: " in found.err
        assert f"require.{estimate}: " in found.err
        assert f"require.{estimate}.std: " not in found.err
    assert not Path("results").exists()


def test_a_requirement_that_cannot_be_read_hides_no_other(
    started: Callable[[str], None], metrocli: Callable[..., Any]
) -> None:
    started("gauge-block")
    _requires(Path("jobs/gum.yaml"), "{l: 'about 5', l.stdd: '< 1 nm', l.std: '< 1 kg'}")
    found = metrocli("check", "jobs/gum.yaml").err
    assert "'about 5' is not a comparison" in found and "no value 'l.stdd'" in found and "require.l.std: " in found


def test_what_only_files_name_is_checked_for_its_form(
    started: Callable[[str], None], metrocli: Callable[..., Any]
) -> None:
    started("gear-m3d3")
    _requires(Path("jobs/tip3.yaml"), "{LT1.y.stdd: '< 1 mm', LT1.y.std: '< 1 mm', LT1.scale.std: '< 1 mm'}")
    found = metrocli("check", ".").err
    assert "no value 'LT1.y.stdd'" in found and "{tracer}.y" in found
    assert "require.LT1.scale.std" in found
    assert "require.LT1.y.std:" not in found


def test_names_of_the_files_are_checked_before_anything_is_computed(
    started: Callable[[str], None], metrocli: Callable[..., Any]
) -> None:
    started("gear-m3d3")
    line = _requires(Path("jobs/tip3.yaml"), "{LT9.x.std: '< 1 mm', LT4.y.std: '< 1 mm'}")
    for command in ("check", "run"):
        found = metrocli(command, ".")
        assert found.code == 3
        assert f"jobs/tip3.yaml:{line}:22: error: require: the result has no value 'LT9.x.std'" in found.err
        assert "did you mean" not in found.err


def test_estimates_of_effects_are_known(started: Callable[[str], None], metrocli: Callable[..., Any]) -> None:
    started("gear-m3d3")
    effect = "effects: [{name: dead-path-drift, tracer: LT2}]\n"
    job = Path("jobs/tip3.yaml")
    job.write_text(job.read_text() + effect)
    _requires(job, "{dead-path-drift.LT2.rate.std: '< 1 mm'}")
    wrong = metrocli("check", job)
    _requires(job, "{dead-path-drift.LT2.rte: '< 1 mm'}")
    typo = metrocli("check", job)
    assert wrong.code == typo.code == 3
    assert "require.dead-path-drift.LT2.rate.std" in wrong.err
    assert "no value 'dead-path-drift.LT2.rte'" in typo.err


@pytest.mark.parametrize(
    ("sample", "change"),
    [
        ("ball-cube", ()),
        ("gauge-block", ()),
        ("gear-m3d3", ()),
        pytest.param("laboratory-effects", (), marks=pytest.mark.slow),
        ("machine-lengths", ()),
        ("xm60-launch-unit", ()),
        ("gear-m3d3", ("noise.model=structured",)),
    ],
)
def test_every_value_of_a_result_can_be_required(sample: str, change: tuple[str, ...]) -> None:
    """A figure that a kind does not list would be refused though the result has it."""
    for step in load_project(SAMPLES / sample):
        if all(path.exists() for path in step.job.files):  # others need a result of another job
            job = load(step.job.file, JobOptions(change))
            known = runner.known_figures(job, read_inputs(job))
            values = values_of(runner.compute(job)[0])
            assert values
            assert not {name: unit for name, (_, unit) in values.items() if unit not in units_among(name, known)}
