"""The linearised adjustment, and candidate effects that could be added to it: their signatures and score tests.

- the system: `linearised` removes the local unknowns (poses, points) member by member; `basis` spans what all unknowns
  absorb, `projection` splits a change of the readings into that and what is visible, `solver` gives the unknowns
- candidates: `scans` (values to try) -> `signatures` (whitened columns) -> `column_parts`, `columns` (stored at the
  rows that they change) -> `candidates`
- `quadratics`, `distributions`: forms and tails for many candidates at once; `memory` estimates first what all takes
"""
