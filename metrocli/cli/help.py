"""The table of commands and the text of `metrocli --help`, without importing any command."""

from __future__ import annotations

from metrocli import __version__
from metrocli.tasks import KINDS

COMMANDS = {
    "init": "copy a sample project (list them without --sample)",
    "run": "bring every result of a project up to date",
    "status": "what is up to date, what is not, and why",
    "check": "validate a job or project without computing",
    "diagnose": "what the model of a job gets wrong, and why",
    "simulate": "the measurement that a job's model predicts",
    "plan": "what a planned measurement will determine, and a better one",
    "effects": "the effects of a kind of job, and where user-defined ones can act",
    "show": "a result on the terminal",
    "gather": "estimates and uncertainties of all results of a project, as one table",
    "lineage": "where a result comes from, back to the measurements",
    "diff": "what changed between two results, and which input or setting",
    "rerun": "the same result again, from the job and inputs that it names",
    "plot": "a figure of a result (without a name: their names)",
    "report": "a result or a project as one self-contained HTML page",
    "compare": "two results: differences, E_n, one test of all",
    "verify": "a result against independent measurements",
    "export": "a result in another format: CSV, compensation tables",
    "import": "a file of an instrument as CSV that jobs read",
    "schema": "JSON schema of a job, for editors",
    "completion": "completion of commands and options in bash, zsh or fish",
}
"""The commands that are not kinds of job"""
PACKAGES = {
    "gather": "provenance.",
    "lineage": "provenance.",
    "diff": "provenance.",
    "rerun": "provenance.",
    "plot": "look.",
    "report": "look.",
    "compare": "look.",
    "verify": "look.",
    "completion": "shell.",
    "import": "exchange.",
}
"""The packages in `metrocli.cli` that have the module of a command; the other modules are in `metrocli.cli` itself"""
MODULES = {"import": "imports"}
"""The module of `import`, which is a keyword of Python; the others have the name of their command"""

_GEAR = "gear-m3d3"
EXAMPLES = {
    "calibrate-camera": ("board-camera", "metrocli calibrate-camera jobs/calibrate.yaml"),
    "align-part": ("spindle-camera", "metrocli align-part jobs/align.yaml"),
    "multilaterate": (_GEAR, "metrocli multilaterate jobs/tip4.yaml"),
    "locate-launch-unit": ("xm60-launch-unit", "metrocli locate-launch-unit jobs/errors.yaml"),
    "selfcal-grid": ("ball-cube", "metrocli selfcal-grid jobs/views.yaml"),
    "calibrate-machine": ("otf-tracker", "metrocli calibrate-machine jobs/feed-2500.yaml"),
    "adjust-network": ("hall-trackers", "metrocli adjust-network jobs/hall.yaml"),
    "fit-part": ("raw-part", "metrocli fit-part jobs/fit.yaml"),
    "fit-points": ("best-fit", "metrocli fit-points jobs/fit.yaml"),
    "report-uncertainty": ("gauge-block", "metrocli report-uncertainty jobs/gum.yaml"),
    "init": ("", "metrocli init gear --sample gear-m3d3"),
    "run": (_GEAR, "metrocli run"),
    "status": (_GEAR, "metrocli status"),
    "check": (_GEAR, "metrocli check jobs/tip4.yaml"),
    "diagnose": (_GEAR, "metrocli diagnose jobs/tip4.yaml"),
    "simulate": (_GEAR, "metrocli simulate jobs/tip4.yaml --out simulated"),
    "plan": (_GEAR, "metrocli plan jobs/tip3.yaml --out plan"),
    "effects": ("", "metrocli effects multilaterate"),
    "gather": (_GEAR, "metrocli gather . --out parts.csv"),
    "lineage": (_GEAR, "metrocli lineage results/tip4.h5"),
    "diff": (_GEAR, "metrocli diff results/tip3.h5 results/tip4.h5"),
    "rerun": (_GEAR, "metrocli rerun results/tip4.h5"),
    "show": (_GEAR, "metrocli show results/tip4.h5 --table points"),
    "compare": (_GEAR, "metrocli compare results/tip3.h5 results/tip4.h5"),
    "verify": ("otf-tracker", 'metrocli verify results/feed-2500.h5 data/check.csv --require "inside >= 0.9"'),
    "plot": (_GEAR, "metrocli plot results/tip4.h5 residuals --save residuals.svg"),
    "report": (_GEAR, "metrocli report results/tip4.h5"),
    "export": (_GEAR, "metrocli export results/tip4.h5 --to csv --out tables"),
    "import": (_GEAR, "metrocli import data/tip5_export.txt --from columns --map data/tip5_map.yaml --out new"),
    "schema": ("", "metrocli schema multilaterate"),
    "completion": ("", 'eval "$(metrocli completion bash)"'),
}
"""By command: the sample in which its example can be typed, "" if anywhere, and the example that ends its help"""


def example_of(command: str) -> str:
    """Return the end of the help of a command: an example that works as it stands, on a line of its own."""
    sample, typed = EXAMPLES.get(command, ("", f"metrocli {command} JOB.yaml"))
    where = f", in a copy of the sample {sample} after metrocli run" if sample else ""
    return f"\b\nExample{where}:\n  {typed}"


def help_text() -> str:
    """Return what `metrocli --help` prints."""
    kinds = {name: kind.summary for name, kind in KINDS.items()}
    width = max(map(len, kinds | COMMANDS))
    return f"""Usage: metrocli COMMAND [ARGUMENTS]...    (more: metrocli COMMAND --help)

  Dimensional metrology: from readings to positions, poses and machine
  errors, with their uncertainty.

Kinds of job:
{_listed(kinds, width)}

Other commands:
{_listed(COMMANDS, width)}

Options:
  {"--version":{width}}  the version
  {"-h, --help":{width}}  this text
"""


def _listed(commands: dict[str, str], width: int) -> str:
    return "\n".join(f"  {name:{width}}  {summary}" for name, summary in commands.items())


def version_text() -> str:
    """Return what `metrocli --version` prints."""
    return f"metrocli {__version__}"
