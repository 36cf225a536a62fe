"""fit-part: the ideal part inside the raw part, with enough overstock everywhere."""

from metrocli.tasks.kind import Kind

KIND = Kind("fit-part", "ideal part inside the raw part, with overstock everywhere", measured=("points",))
