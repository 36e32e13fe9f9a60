"""Label, contact and jerk of paths as losses in PyTorch."""

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional as F

from ..curves import NUM_WAYPOINTS, spline_matrix
from ..data.dataset import LABEL_KNOTS, Dataset
from ..intent.metrics import SCORE_POINTS
from ..models.conditions import Conditions
from ..models.path_diffuser import LEAST_COST, dial_of
from ..motion.archive import SMALLEST_RANGE

_SMOOTH = 0.01  # added to a jerk, so that differences far below it do not count
_PAD = 0.01  # distance to keep from solids and walls, in lengths of the straight line


class FrameScorer:
    """Label, contact and jerk of paths in PyTorch, differentiable, in the start–target frame."""

    def __init__(self, data: Dataset, conditions: Conditions) -> None:
        def tensor(array: np.ndarray) -> Tensor:
            return torch.tensor(array, dtype=torch.float32, device=conditions.vector.device)

        # Labels are read in log(−L_p): the legible side of a clear scene may lie within a millionth
        # of the range of its scores.
        self.knots = tensor(np.maximum.accumulate(-dial_of(data.score_at_label), axis=1))
        self.values = tensor(LABEL_KNOTS)
        # Labels rank little where a side of the dial spans little.
        ends = np.abs(data.score_at_label[:, [0, -1]] - data.summary["anchor_score"][:, None])
        self.trust = tensor(np.minimum(ends / SMALLEST_RANGE, 1))
        self.alpha = data.config.observer.alpha
        self.spline = tensor(spline_matrix(NUM_WAYPOINTS + 2, SCORE_POINTS))
        self.ends = tensor(np.eye(2, data.config.dim, k=-1))

    def path(self, waypoints: Tensor) -> Tensor:
        """`(B, K + 2, D)`: waypoints `(B, K, D)` in the start–target frame with start and goal."""
        ends = self.ends.expand(len(waypoints), -1, -1)
        return torch.cat([ends[:, :1], waypoints, ends[:, 1:]], dim=1)

    def curve(self, waypoints: Tensor) -> Tensor:
        """The curve `(B, T, D)` through waypoints `(B, K, D)` in the start–target frame."""
        return self.spline @ self.path(waypoints)

    def score(self, conditions: Conditions, points: Tensor) -> Tensor:
        """`L_p` (paper, eq. 4), `(B,)`, of curves `(B, T, D)` in start–target frames.

        As `legibility_score`: t is progress by arc length, and the weights exp(−α t) sum to 1.
        """
        potential = conditions.potential(points)
        steps = (points.diff(dim=1).square().sum(-1) + 1e-12).sqrt()
        progress = F.pad(steps.cumsum(1), (1, 0)) / steps.sum(1, keepdim=True)
        decay = torch.exp(-self.alpha * progress)
        width = progress.diff(dim=1) / 2
        weighted = decay * potential
        total = ((weighted[:, 1:] + weighted[:, :-1]) * width).sum(1)
        return -total / ((decay[:, 1:] + decay[:, :-1]) * width).sum(1)

    def label(self, conditions: Conditions, scenes: Tensor, points: Tensor) -> Tensor:
        """The achieved label `(B,)` of curves `(B, T, D)` in the `scenes (B,)` of the data.

        It is extrapolated beyond ±1 so that its gradient never vanishes.
        """
        score = -torch.log((-self.score(conditions, points)).clamp_min(LEAST_COST))
        knots = self.knots[scenes]
        right = torch.searchsorted(knots, score.detach()[:, None]).clamp(1, len(self.values) - 1)
        low, high = knots.gather(1, right - 1)[:, 0], knots.gather(1, right)[:, 0]
        span = (high - low).clamp_min(1e-5 * (knots[:, -1] - knots[:, 0]))
        step = self.values[1] - self.values[0]
        return self.values[right[:, 0] - 1] + (score - low) / span * step

    def error(
        self, conditions: Conditions, scenes: Tensor, points: Tensor, level: Tensor
    ) -> Tensor:
        """`(B,)`: loss on the label of curves `(B, T, D)` against `level (B,)`."""
        achieved = self.label(conditions, scenes, points)
        # Labels end at ±1, scores go beyond: at the ends only a path that falls short is wrong.
        beyond = (level.abs() == 1) & (achieved * level > 1)
        achieved = torch.where(beyond, level, achieved)
        trust = self.trust[scenes, (level > 0).long()]
        return trust * F.smooth_l1_loss(achieved, level, beta=0.1, reduction="none")

    @staticmethod
    def contact(conditions: Conditions, points: Tensor) -> Tensor:
        """`(B,)`: by how much curves `(B, T, D)` come too near to solids and walls.

        The mean along the curve, and a share of the worst point.
        """
        shortfall = F.relu(_PAD - conditions.margin(points))
        return shortfall.mean(dim=1) + shortfall.amax(dim=1) / 4

    def jerk(self, waypoints: Tensor, like: Tensor) -> Tensor:
        """`(B,)`: log jerk of paths `(B, K, D)` beyond that of the paths `like`."""
        found, allowed = (
            self.path(x).diff(n=3, dim=1).square().sum((1, 2)) + _SMOOTH for x in (waypoints, like)
        )
        return F.relu((found / allowed).log())
