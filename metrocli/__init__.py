"""Dimensional metrology on the command line.

A job goes from its text to a result; who may import whom is in tests/laws/test_layers.py.

- `cli` (commands) -> `project` (jobs, results, what is up to date) -> `tasks` (one package a kind of job)
- `diagnosis` (what a model gets wrong), `uncertainty` (propagation, and what results say together)
- `effects`, `instruments`, `targets` in images: of these a kind builds its model -> `adjust` solves it, on `geometry`
- what jobs hand on: `result`, `record`, `plan`, `simulation`; `doubt` decides whether a result may be used
- files: `formats` (own), `imports`, `exports` (of other programs), `plots` and `report` (for people)
- `settings` are made of the `nodes` of a text; `table`, `units`, `expressions`, `errors` and `words` serve all
"""

__version__ = "0.1.0"
