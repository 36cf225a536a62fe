"""Jobs and projects: from the text of a job to its result file, and what is up to date.

- a job: `yaml_text` (nodes) -> `heading`, `campaign` (keys of every job, `for:`) -> `job` with `named_files`,
  `own_effects` and `ranges`, which lists all faults at once
- a project: `steps` (order) -> `staleness` by `fingerprint` -> `pipeline` -> `running` (who computes)
- one job: `runner` reads `inputs`, runs the task, judges `requirements` (criteria, tolerances), and writes the result
- other commands: `diagnosed` (by `adjuster`), `until_clean`, `planned`, `simulated`; `provenance` looks back from a
  result
"""

PROJECT_FILE = "metrocli.yaml"
"""File that makes a folder a project"""
DIAGNOSIS = ".diagnosis.json"
"""Ending of the diagnosis of a job, beside the result of that job"""
