"""Effects: physical causes that a model can leave out, and a job can add by name.

- `effect`: an entry of a table, with one of `links`; `page` explains it
- `requested` (what a job names) -> `extension`, which splices links into a `model` -> `estimates` for the result;
  `modelled` is the base of what each kind adjusts
- `correlated` errors (over `covariates`) and `variance_groups`: what a job states beside effects
- `acting`: where user-defined effects can act; `own` reads their definitions
"""
