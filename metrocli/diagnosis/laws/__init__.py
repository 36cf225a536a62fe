"""Laws: the simplest sums of terms that explain structure for which no effect is known.

`terms` (forms of one term) -> `library` (where each can act, as columns) -> `steps` (terms enter one by one). Then
`search` takes the same steps in each fold, which decides how many terms. `definition` makes an effect of a law.

Method: docs/algorithms/laws.md.
"""
