"""Diagnosis: what the model of a job gets wrong, why, and what a correction gains. It knows no instrument.

An `AdjustedJob` (model at its solution, effects, covariates, what is delivered) goes in, a `Diagnosis` comes out:

- The linear system: `adjusted_job` -> `linear` (candidates and their columns; `linear.memory` first) -> `evidence`.
  A state of effects, random parts and wrong readings is searched for there. `rounds` adjusts the job with what
  dominates, and searches again.
- What no effect explains: `laws` has formulas, `explanations` random effects and correlated errors.
- Held-out readings confirm effects (`evidence.folds`). Then `extended_fit` has their sizes, `hidden_change` and `power`
  what the measurement could not detect, as `detectability`.
- `findings` has it all, with `wrong_readings`, `noise` and `correlated_error`. `status` and `verdict` put it into words
  and plain data, `job_entries` into the next job.
- What no linear system sees: `corrections` of files and `mistakes` in settings (`other_settings`), each tried by an
  adjustment of its own (`trials`).
- `next_readings` proposes what to measure.

`diagnose` is the sequence, top down. `linear` knows no statistics of selection, `evidence` no words.
"""
