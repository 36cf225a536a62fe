"""metrocli rerun: the same result again, from the job text and the inputs that it names."""

from __future__ import annotations

from pathlib import Path

import click

from metrocli.cli import options
from metrocli.cli.console import Console, echo_json
from metrocli.record import NOT_MET


@click.command("rerun", help="Make a result again from the job and inputs that it names, and compare bit for bit.")
@click.argument("result", type=click.Path(path_type=Path), metavar="RESULT.h5")
@options.OUTPUT
@options.WORKERS
@options.ACCEPT
@options.WRITES
@options.VERBOSE
def command(
    result: Path,
    output: Path | None,
    workers: int,
    accept_doubtful: bool,
    force: bool,
    as_json: bool,
    quiet: bool,
    verbose: bool,
) -> int:
    """Print whether the result is the same; exit code 6 if it is another one. Written only with --output."""
    from metrocli.formats import hdf5
    from metrocli.project.provenance.comparison import rerun
    from metrocli.uncertainty.workers import Workers

    console = Console(quiet or as_json, verbose)
    made, record, same = rerun(result, accept_doubtful, console, Workers(workers))
    before = hdf5.read(result)[1].metrocli_version  # the output may be the result itself
    if output is not None:
        if not force:
            hdf5.refuse_foreign(output, made.kind)
        hdf5.write(output, made, record)
    if as_json:
        made_by = {"made_by": before, "made_again_by": record.metrocli_version}
        echo_json({"result": str(result), "same": same, **made_by})
    if same:
        console.print(f"{result}: the same again, bit for bit")
        return 0
    versions = f"made by metrocli {before}, made again by {record.metrocli_version}"
    console.print(f"{result}: the result made again is another one ({versions})")
    return NOT_MET
