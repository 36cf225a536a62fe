"""Diagnosis by evidence: every explanation is columns with one unknown size, and all are compared by one score.

An adjusted job goes in; the state of the highest score comes out, with the gain of its parts in held-out readings:

- `measured_job`, with `functions` of covariates -> `measurement`: the job linearised about its solution, with all that
  can explain its residuals
- `parts` (effects, wrong readings, random effects, correlated errors) -> `products` of their columns -> `likelihood`
  (restricted, at the likeliest sizes) -> `scored`, less their `prices` -> `state`: also what they leave of all else
- `moves` (what may enter; random parts by `variances`, noise of variance groups by `weights`) -> `search`, which makes
  those that raise the score; scanned parameters by `refined`
- `identified` (sizes, levels and rivals of the effects of a state); `reweighted` products -> `held_out` predictions ->
  `gain` -> `folds` (cross-validation)

Method: docs/algorithms/evidence.md.
"""
