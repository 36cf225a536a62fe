"""Laws: the simplest sums of terms that explain structure for which no effect is known.

`terms` (forms of one term) -> `library` (where each can act, as columns) -> `steps` (terms enter one by one). Then
`search` takes the same steps in each fold, which decides how many terms. `law` is what was found, and
`definition` makes an effect of it.

Method: docs/algorithms/laws.md.
"""
