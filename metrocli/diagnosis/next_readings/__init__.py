"""What to measure next: the readings that best tell apart what is indistinct, or show what cannot be seen.

`proposals` (readings that could be made again) -> `pool` (what each would add to the information) -> `choice` (one by
one, those that raise the power most) -> `separation` (does it suffice). Method: docs/algorithms/next-readings.md.
"""
