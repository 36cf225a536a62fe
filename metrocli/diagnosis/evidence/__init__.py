"""Diagnosis by evidence: every explanation is columns with one unknown size, and all are compared by one score.

A `Measurement` (measurement.py) is a job linearised about a solution, with all that can explain its residuals. A
`State` (state.py) holds some explanations: identified effects and wrong readings (fixed.py), random effects and
correlated errors (random.py), and the noise of variance groups. Its score is the restricted likelihood
(likelihood.py) less the prices of its parts (prices.py). `search` (search.py) makes the moves that raise the score.
"""
