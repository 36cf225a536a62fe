"""metrocli simulate: the measurement that a job's model predicts."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from metrocli.cli import options
from metrocli.cli.console import print_files
from metrocli.errors import Fault, InputError
from metrocli.simulation import SimulationOptions
from metrocli.tasks import KINDS


@click.command("simulate", help="Write the measurement that the model of a job predicts, and the truth behind it.")
@options.JOB
@click.option("--out", required=True, type=click.Path(path_type=Path), metavar="DIR", help="Folder to write to.")
@click.option("--seed", default=0, show_default=True, type=click.IntRange(0), help="Seed of the noise.")
@click.option(
    "--effect",
    "effects",
    multiple=True,
    metavar="NAME:KEY=VALUE,...",
    help="Add an effect, such as dead-path-drift:tracer=LT2,rate=0.5um/min.",
)
@click.option("--images", is_flag=True, help="Render the images too.")
@options.SET
@options.ACCEPT
@options.WRITES
def command(job: Path, out: Path, seed: int, images: bool, quiet: bool, force: bool, **more: Any) -> int:
    """Simulate; write tables, images and truth.json; print their paths."""
    from metrocli.formats.own_files import refuse_inputs
    from metrocli.project import runner
    from metrocli.project.job import JobOptions, kind_of_job, load
    from metrocli.project.simulated import TRUTH, write

    if out.exists() and not force and (not out.is_dir() or any(out.iterdir())):
        raise InputError([Fault("the folder is not empty", str(out), hint="name a new one, or use --force")])
    kind = kind_of_job(job)
    not_needed = KINDS[kind].measured if kind else ()
    accept, effects = more["accept_doubtful"], more["effects"]
    asked = JobOptions(more["overrides"], not_needed=not_needed, effects=effects, accept_doubtful=accept)
    loaded = load(job, asked)
    simulation = runner.simulate(loaded, SimulationOptions(seed, images))
    if not (out / TRUTH).is_file():  # readings that an earlier simulation wrote are none of an instrument
        written = (out / name for name in (*simulation.files, *(name for name, _ in simulation.pictures)))
        refuse_inputs(written, (*loaded.stated_in, *loaded.files))
    return print_files(write(simulation, out), more["as_json"], quiet)
