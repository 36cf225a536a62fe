"""fit-part: the ideal part inside the raw part, with enough overstock everywhere.

`readings`, `ideal` -> `nominals` (surfaces, patches of a mesh), `levels` (chips) -> `start` -> `stock` (overstock
with derivatives) -> `fit`, or `contradiction` where none is possible -> `uncertainty`, `draws` -> `report` with
`sentences` (notes and warnings). `solve` is the sequence; `misread` finds columns that the points contradict.
"""

from metrocli.tasks.kind import Kind

KIND = Kind("fit-part", "ideal part inside the raw part, with overstock everywhere", measured=("points",))
