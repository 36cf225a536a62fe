"""Weighted least squares: groups of readings and blocks of unknowns go in, a Solution with covariance comes out.

- `model`: quantities, chains of links, observations and groups, which an instrument fills
- `adjustment`: one adjustment. `descent` takes the steps by `schur`, with the motions of `datum` held; `rank`
  finds what is undetermined, `outcome` how it ended, `solution` has values, covariance and tests
- `coupled_fields`: the same for fields that stay coupled, by `sparse`
- around an adjustment: `robust` starts it and rejects readings, `rounds` repeats it with other weights or noise,
  `clusters` has the covariance of readings that share errors, `stream_condensation` makes few readings of many

Nothing here knows an instrument, a file or a unit.
"""
