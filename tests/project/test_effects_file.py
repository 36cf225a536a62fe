"""A file with user-defined effects is an input of the jobs that it serves: staleness, memo, depfile and cluster."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest

from metrocli.nodes import Node
from metrocli.project import own_effects, yaml_text
from metrocli.project.job import load
from metrocli.project.running import executor
from metrocli.project.running.cluster import carry_out, pack
from metrocli.project.running.memo import remember, unmoved_jobs
from metrocli.project.steps import load_project
from metrocli.uncertainty.workers.dask_cluster import Versions

Metrocli = Callable[..., Any]
EFFECT = "effects: [{name: cable-wrap, tracer: LT5}]\n"


@pytest.fixture
def shop(tmp_path: Path, metrocli: Metrocli, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A project that estimates an effect of the laboratory's own file, run once."""
    metrocli("init", tmp_path / "shop", "--sample", "laboratory-effects")
    monkeypatch.chdir(tmp_path / "shop")
    job = Path("jobs/hall.yaml")
    job.write_text(job.read_text() + EFFECT)
    assert metrocli("run").code == 0
    return tmp_path / "shop"


def _will_run(metrocli: Metrocli) -> bool:
    (job,) = json.loads(metrocli("status", "--json").out)["jobs"]
    return not job["up_to_date"]


def _keys_backwards(node: Node) -> Node:
    entries = tuple((key, _keys_backwards(value)) for key, value in reversed(node.entries))
    return replace(node, items=tuple(map(_keys_backwards, node.items)), entries=entries)


def test_values_of_the_file_count_and_comments_do_not(shop: Path, metrocli: Metrocli) -> None:
    lab = shop / "lab-effects.yaml"
    assert not _will_run(metrocli)
    lab.write_text("# another comment\n" + lab.read_text())
    assert not _will_run(metrocli)
    lab.write_text(yaml_text.emit(_keys_backwards(yaml_text.parse(lab.read_text(), str(lab), shop))))
    assert not _will_run(metrocli)
    lab.write_text(lab.read_text().replace("adds: pull*azimuth", "adds: 2*pull*azimuth"))
    assert _will_run(metrocli)
    assert metrocli("run").code == 0 and not _will_run(metrocli)


def test_what_is_edited_while_a_job_waits_is_not_recorded_as_used(
    shop: Path, metrocli: Metrocli, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab, computed = shop / "lab-effects.yaml", executor.compute

    def edited_first(*arguments: Any) -> Any:
        lab.write_text(lab.read_text().replace("adds: pull*azimuth", "adds: 2*pull*azimuth"))
        return computed(*arguments)

    with monkeypatch.context() as patch:
        patch.setattr(executor, "compute", edited_first)
        assert metrocli("run", "--force").code == 0
    assert _will_run(metrocli), "the job ran with the effect as it was before"


def test_a_run_with_nothing_to_do_looks_at_the_file(shop: Path, metrocli: Metrocli) -> None:
    lab, result = shop / "lab-effects.yaml", shop / "results" / "hall.h5"
    begun = time.time_ns() + 10**10
    remember(shop / "metrocli.yaml", load_project(shop), begun)
    assert unmoved_jobs(str(shop / "metrocli.yaml")) is not None
    before = result.read_bytes()
    lab.write_text(lab.read_text().replace("adds: pull*azimuth", "adds: 3*pull*azimuth"))
    assert unmoved_jobs(str(shop / "metrocli.yaml")) is None
    assert metrocli("run").code == 0 and result.read_bytes() != before


def test_another_state_of_a_package_whose_effect_is_used_runs_the_job(
    job: Path, metrocli: Metrocli, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = Path("lab_package.py")
    module.write_text(
        "from metrocli.effects.effect import Effect, Parameter\n"
        "def offer(kind):\n    return [Effect('bow', 'the line is bent', (Parameter('size', 'length'),))]\n"
    )
    monkeypatch.syspath_prepend(str(module.parent.absolute()))
    point = EntryPoint("lab", "lab_package:offer", own_effects.ENTRY_POINTS)
    monkeypatch.setattr(own_effects, "_offered", lambda: (("lab", point),))
    job.write_text(job.read_text() + "effects: [{name: bow, size: 5 um}]\n")
    Path("other.yaml").write_text("metrocli: 1\njob: straight-line\ninputs: {readings: readings.csv}\nnoise: 1 mm\n")
    Path("metrocli.yaml").write_text("jobs: [line.yaml, other.yaml]\n")
    assert metrocli("run").code == 0
    remember(Path("metrocli.yaml").absolute(), load_project(Path()), time.time_ns() + 10**10)
    assert unmoved_jobs("metrocli.yaml") is not None
    module.write_text(module.read_text() + "# a better formula\n")
    own_effects._package.cache_clear()
    assert unmoved_jobs("metrocli.yaml") is None, "a run with nothing to do looks at the package"
    found = json.loads(metrocli("status", "--json").out)["jobs"]
    assert [one["up_to_date"] for one in found] == [False, True], "a job that uses no effect of it stays"
    assert "lab_package" in found[0]["reason"]
    assert metrocli("run").out.count(": ran") == 1
    assert metrocli("run").out.count(": ran") == 0


def test_make_knows_the_file(shop: Path, metrocli: Metrocli) -> None:
    assert metrocli("run", "--depfile", "deps.mk").code == 0
    assert "lab-effects.yaml" in (shop / "deps.mk").read_text()


def test_the_file_travels_with_its_job(shop: Path) -> None:
    packed = pack("hall", load(shop / "jobs" / "hall.yaml"), False)
    assert {"lab-effects.yaml", "metrocli.yaml"} <= {os.path.basename(name) for name in packed.files}
    ((name, outcome),) = carry_out([packed], Versions.here(None))
    assert (name, outcome.exit_code, outcome.error) == ("hall", 0, "")
