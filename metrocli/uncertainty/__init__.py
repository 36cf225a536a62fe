"""Uncertainty: propagation of models, and results compared with each other and with measurements.

- models: `distributions`, `correlated` -> `inputs` -> `propagation` (GUM) and `monte_carlo` (`trials` in
  `workers`, then `samples`) -> `validation` (do both agree) -> `decision`; `volume` for each point of a volume
- results with each other: `comparison`, `repeated`, `repeated_sets`
- a result and independent measurements: `predicted` (with `calibrated_machine`) -> `verification` ->
  `length_errors`
"""
