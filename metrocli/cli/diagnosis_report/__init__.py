"""The report of a diagnosis, in text.

A `Diagnosis` goes in, lines come out: `headline` (the verdict) -> `findings` (the report, top down) with `laws` and
`candidates` (what each could hide) -> `next_readings`. `loop` has the steps of `--until-clean`.
"""
