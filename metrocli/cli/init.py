"""metrocli init: copy a sample project."""

from __future__ import annotations

import shutil
from contextlib import suppress
from pathlib import Path

import click

from metrocli.cli import options
from metrocli.cli.console import echo, echo_json
from metrocli.cli.shell.choices import offering
from metrocli.errors import Fault, InputError, UsageError
from metrocli.project import PROJECT_FILE
from metrocli.words import suggestion


def samples_folder() -> Path:
    """Return the folder of the samples: in the installed package, or beside the package in a source checkout."""
    package = Path(__file__).parents[1]
    installed = package / "sample_projects"
    return installed if installed.is_dir() else package.parent / "sample_projects"


def all_samples() -> dict[str, Path]:
    """Return the folders of all samples by their names."""
    return {path.name: path for path in sorted(samples_folder().iterdir()) if (path / PROJECT_FILE).is_file()}


@click.command("init", help="Copy a sample project into DIR; without --sample, list the samples.")
@click.argument("folder", required=False, type=click.Path(path_type=Path), metavar="DIR")
@click.option("--sample", metavar="NAME", help="The sample to copy.", shell_complete=offering(all_samples))
@options.JSON
def command(folder: Path | None, sample: str | None, as_json: bool) -> int:
    """Copy a sample, or list all samples."""
    samples = all_samples()
    if sample is None and as_json:
        echo_json({"samples": {name: _title(path) for name, path in samples.items()}})
        return 0
    if sample is None:
        echo("samples (copy one with: metrocli init DIR --sample NAME):")
        for name, path in samples.items():
            echo(f"  {name}: {_title(path)}")
        return 0
    if sample not in samples:
        raise UsageError(f"no sample '{sample}'; {suggestion(sample, samples)}")
    if folder is None:
        raise UsageError(f"name the folder to copy it to: metrocli init DIR --sample {sample}")
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError([Fault("the folder is not empty", str(folder), hint="name a new folder")])
    _copy(samples[sample], folder)
    if as_json:
        echo_json({"folder": str(folder), "sample": sample})
        return 0
    echo(f"{folder}: sample {sample} copied. Next: metrocli run {folder}")
    return 0


def _copy(sample: Path, folder: Path) -> None:
    """Copy a sample into a folder that is empty or not there; if it fails, take back what was begun.

    Raises InputError with the first file that cannot be written.
    """

    def copied(source: str, target: str) -> None:
        try:
            shutil.copy2(source, target)
        except OSError as error:
            raise InputError([Fault(f"cannot be written: {error.strerror}", target)]) from error

    there = folder.exists()
    left_out = shutil.ignore_patterns("results")
    try:
        shutil.copytree(sample, folder, dirs_exist_ok=True, ignore=left_out, copy_function=copied)
    except BaseException as error:
        shutil.rmtree(folder, ignore_errors=True)
        with suppress(OSError):
            if there:
                folder.mkdir()
        if isinstance(error, OSError):
            fault = Fault(f"cannot be written: {error.strerror or error}", str(error.filename or folder))
            raise InputError([fault]) from error
        raise


def _title(path: Path) -> str:
    """Return the first line of a sample's README."""
    readme = path / "README.md"
    return readme.read_text(encoding="utf-8").splitlines()[0].lstrip("# ") if readme.is_file() else ""
