"""fit-points: points of one list laid onto those of another (best fit), and features through points.

`listed` (points and how well they are known) -> `start` -> `problem` (`links`) -> `tested` (noise, points that do not
fit) -> `report`, with `features` before or after the fit. Of several stations: `stations` (places by the stations
joined before) -> `problem` -> `tested` -> `joined`.
"""

from metrocli.tasks.kind import Kind

KIND = Kind("fit-points", "points laid onto points (best fit), and features through points", measured=("points",))
