"""Standard deviations of the readings of a machine, as a job declares them."""

from __future__ import annotations

from collections.abc import Iterator

from metrocli.frozen import dataclass
from metrocli.settings import Either, Section, WithUnit, setting
from metrocli.tasks.shared.lengths import REPEATABILITY, REPEATABILITY_WORDS, LengthNoise
from metrocli.tasks.shared.noise import model_setting


@dataclass(frozen=True)
class LateralNoise:
    """Standard deviation perpendicular to the beam, `sqrt(c^2 + (p r)^2)` at distance r."""

    constant: float = setting(WithUnit("length", minimum=0.0), "c: the part that does not depend on the distance")
    proportional: float = setting(WithUnit("ratio", minimum=0.0), "p: the part proportional to it", default=0.0)


_LATERAL = Either(WithUnit("length", positive=True), Section(LateralNoise))


@dataclass(frozen=True)
class MachineNoise:
    """Standard deviations of the tracker (beam, lateral), the laser (displacement ...) or lengths (constant ...)."""

    beam: float | None = setting(WithUnit("length", positive=True), "tracker: along the beam", default=None)
    lateral: float | LateralNoise | None = setting(_LATERAL, "tracker: perpendicular to the beam", default=None)
    radial: float | LateralNoise | None = setting(_LATERAL, "another name of lateral", default=None)
    displacement: float | None = setting(WithUnit("length", positive=True), "six-dof: along the beam", default=None)
    straightness: float | None = setting(
        WithUnit("length", positive=True), "six-dof: perpendicular to the beam", default=None
    )
    angle: float | None = setting(
        WithUnit("angle", positive=True), "six-dof: angles; about rotary axes the deviation", default=None
    )
    constant: float | None = setting(
        WithUnit("length", positive=True), "lengths: the part that does not depend on the length", default=None
    )
    proportional: float = setting(
        WithUnit("ratio", minimum=0.0), "lengths: the part proportional to the path", default=0.0
    )
    probing: float | None = setting(
        WithUnit("length", positive=True), "probing: each coordinate of a ball's centre", default=None
    )
    repeatability: float | str | None = setting(REPEATABILITY, f"lengths: {REPEATABILITY_WORDS}", default=None)

    model: str = model_setting()

    @property
    def of_lengths(self) -> LengthNoise:
        """The noise of lengths."""
        return LengthNoise(self.constant or 0.0, self.proportional, self.repeatability)

    @property
    def square(self) -> LateralNoise:
        """The noise perpendicular to the beam, from `lateral` or its other name `radial`; zero if neither is given."""
        given = self.lateral if self.lateral is not None else self.radial
        return given if isinstance(given, LateralNoise) else LateralNoise(given or 0.0)

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield a fault if both lateral and radial are given, or if the lateral noise is zero."""
        if self.lateral is not None and self.radial is not None:
            yield "radial", "lateral and radial are two names of one setting: keep one of them"
        given = self.lateral if self.lateral is not None else self.radial
        if isinstance(given, LateralNoise) and given.constant == given.proportional == 0.0:
            yield "lateral", "the noise is zero, so readings would have infinite weight: give constant or proportional"
