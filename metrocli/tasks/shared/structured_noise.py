"""`noise: structured`: the uncertainties of a job whose readings share errors, by image or the like.

Method: docs/algorithms/cluster-robust-covariance.md.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from metrocli.adjust.cluster_robust import ClusterRobust, cluster_robust
from metrocli.adjust.model.observations import Index
from metrocli.adjust.solution import Solution
from metrocli.result import Scalar

NOISE_HELP = (
    "standard deviation of an image coordinate, or 'estimated' from the residuals, "
    "or 'structured': estimated, and readings of one image may share errors"
)


@dataclass(frozen=True)
class Structured:
    """How the readings of a job share errors, and what that changes."""

    robust: ClusterRobust
    delivered: tuple[str, ...]
    """Blocks of the estimates"""
    over: str
    """What is left out in turn, in words: images"""

    @classmethod
    def of(cls, solution: Solution, clusters: Mapping[str, Index], delivered: Sequence[str], over: str) -> Structured:
        """Return the covariance that lets readings of one cluster share errors; raises as `cluster_robust` does."""
        return cls(cluster_robust(solution, clusters, over), tuple(delivered), over)

    @property
    def inflation(self) -> float:
        """Root mean square growth of the standard uncertainties of the estimates against independent errors."""
        return self.robust.inflation(self.delivered)

    @property
    def statistics(self) -> dict[str, Scalar]:
        """What /statistics has besides those of estimated noise."""
        return {
            "noise_model": f"cluster-robust over {self.over}",
            "clusters": self.robust.clusters,
            "inflation": self.inflation,
        }

    def details(self, names: Sequence[str]) -> dict[str, dict[str, float]]:
        """Return the degrees of freedom of the estimates: for all the least, because their errors are joint."""
        found = self.robust.dof(self.delivered)
        return {name: {"dof": float(found.min())} for name in names} if len(found) else {}

    @property
    def note(self) -> str:
        """The line of the report."""
        found = self.robust.dof(self.delivered)
        dof = f", with {found.min():.1f} degrees of freedom" if len(found) else ""
        return (
            f"noise: structured: readings of one image may share errors. The covariance is cluster-robust over "
            f"{self.robust.clusters} {self.over}; standard uncertainties are {self.inflation:.2f} times "
            f"those for white noise{dof}"
        )
