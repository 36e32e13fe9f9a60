"""The dial at a glance: the score that each ℓ asks for in a scene, without its archive.

A few hundred curves, the same in every start–target frame, stand in for the archive. Those that
keep clear are ranked by their scores, as its elites are. A small network corrects what so few
curves miss.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor, nn

from ..checks import Array
from ..curves import arc_length
from ..errors import InvalidInputError
from ..intent.metrics import SCORE_POINTS, score_weights
from ..intent.observer import Observer
from ..motion.archive import build_archive
from ..motion.bezier import bezier_trajectories
from ..scene import Scene
from .conditions import Conditions
from .configuration import PathDiffuserConfig
from .inputs import vector_size

KNOTS = 17
"""Levels of ℓ, from −1 to 1, at which the score is predicted; linear between them."""

_POINTS = 12  # of a curve
_CELLS = {2: 14, 3: 7}
_LEAST_COST = 1e-12
_NOT_CLEAR = 1e4  # the log cost of a curve that touches something, beyond all others
_FAR = 1e3  # added to a length, likewise


class Dial(nn.Module):
    """Predicts log(−L_p) at `KNOTS` levels of ℓ.

    Args:
        config: of stage 1.
    """

    def __init__(self, config: PathDiffuserConfig) -> None:
        super().__init__()
        number, dim, alpha = config.curves, config.dim, config.observer.alpha
        self.anchored = config.observer.label == "anchored"
        self.points: Tensor  # of the curves, `(M, P, D)`, set by training
        self.register_buffer("points", torch.zeros(number, _POINTS, dim))
        self.lengths: Tensor  # `(M,)`
        self.register_buffer("lengths", torch.ones(number))
        straight = torch.zeros(SCORE_POINTS, dim, dtype=torch.float32)
        straight[:, 0] = torch.linspace(0, 1, SCORE_POINTS, dtype=torch.float32)
        constants = {
            "straight": straight,
            "levels": torch.linspace(-1, 1, KNOTS, dtype=torch.float32),
            "weights": torch.tensor(score_weights(_POINTS, alpha), dtype=torch.float32),
            "straight_weights": torch.tensor(
                score_weights(SCORE_POINTS, alpha), dtype=torch.float32
            ),
        }
        self.straight: Tensor
        self.levels: Tensor
        self.weights: Tensor
        self.straight_weights: Tensor
        for name, value in constants.items():
            self.register_buffer(name, value, persistent=False)
        inputs, size = KNOTS + 2 * number + 1 + vector_size(dim), 2 * config.condition
        layers = [nn.Linear(a, b) for a, b in pairwise((inputs, size, size, size, KNOTS))]
        outlet = layers[-1]
        nn.init.normal_(outlet.weight, std=1e-3)
        nn.init.zeros_(outlet.bias)
        self.head = nn.Sequential(
            layers[0], nn.SiLU(), layers[1], nn.SiLU(), layers[2], nn.SiLU(), outlet
        )

    def set_curves(self, observer: Observer) -> None:
        """Take the standard curves of an observer's detour."""
        number, _, dim = self.points.shape
        controls = standard_curves(dim, observer, number)
        points = bezier_trajectories(controls, _POINTS)
        self.points.copy_(torch.from_numpy(points.astype(np.float32)))
        lengths = arc_length(bezier_trajectories(controls, 4 * SCORE_POINTS))
        self.lengths.copy_(torch.from_numpy(lengths.astype(np.float32)))

    @torch.no_grad()
    def readings(self, conditions: Conditions) -> Tensor:
        """What the network reads of `B` scenes, `(B, R)`; it depends on no parameter.

        The log cost at each knot by the standard curves alone and of each curve, both over that of
        ℓ = 0; the least margin of each; and the scene's vector.
        """
        with torch.autocast(conditions.vector.device.type, enabled=False):
            size, (number, _, dim) = conditions.vector.shape[0], self.points.shape
            if (conditions.polygon_radii < 0).all():  # of places that are empty
                none = {"vertices": conditions.vertices[:, :0]}
                conditions = replace(
                    conditions, polygon_radii=conditions.polygon_radii[:, :0], **none
                )
            points = torch.cat([self.points.flatten(0, 1), self.straight]).expand(size, -1, dim)
            potential, margin = conditions.potential(points), conditions.margin(points)
            inner = number * _POINTS
            cost = potential[:, :inner].unflatten(1, (number, _POINTS)) @ self.weights
            cost = cost.clamp_min(_LEAST_COST).log()
            line = (potential[:, inner:] @ self.straight_weights).clamp_min(_LEAST_COST).log()
            # The two ends are free in any scene, but may lie on a wall.
            room = margin[:, :inner].unflatten(1, (number, _POINTS))[..., 1:-1].amin(-1)
            free = margin[:, inner:][:, 1:-1].amin(-1) >= 0
            coarse = self._ranked(cost, room, line, free)
            anchor = coarse[:, KNOTS // 2, None]
            return torch.cat(
                [
                    coarse - anchor,
                    (cost - anchor).clamp(-20, 20),
                    (4 * room).tanh(),
                    anchor,
                    torch.asinh(conditions.vector),
                ],
                dim=-1,
            )

    def _ranked(self, cost: Tensor, room: Tensor, line: Tensor, free: Tensor) -> Tensor:
        """Log cost `(B, KNOTS)` at each knot, by the ranks of the curves that keep clear.

        Args:
            cost: log cost of each curve, `(B, M)`.
            room: least margin of each.
            line: log cost of the straight line, `(B,)`.
            free: whether it is free, `(B,)` bool.
        """
        clear = room > 0
        length = self.lengths + _FAR * (torch.relu(-room) + (~clear).to(room.dtype))
        shortest = cost.gather(1, length.argmin(dim=1, keepdim=True))
        anchor = torch.where(free[:, None], line[:, None], shortest)
        above, below = (
            (clear & side).sum(dim=1, keepdim=True).to(cost.dtype)
            for side in (cost < anchor, cost > anchor)
        )
        others = torch.where(clear & (cost != anchor), cost, torch.full_like(cost, _NOT_CLEAR))
        ranked = torch.cat([others, anchor], dim=1).sort(dim=1)[0]
        if self.anchored:
            legible, ambiguous = self.levels.clamp_min(0), (-self.levels).clamp_min(0)
            place = torch.where(self.levels >= 0, above * (1 - legible), above + below * ambiguous)
        else:
            place = (above + below) * (1 - self.levels) / 2
        first = place.floor()
        last = ranked.shape[1] - 1
        low = ranked.gather(1, first.long())
        high = ranked.gather(1, (first.long() + 1).clamp_max(last))
        return low + (place - first) * (high - low).clamp(0, 20)

    def forward(self, readings: Tensor) -> Tensor:
        """Log cost `(B, KNOTS)` at each knot, of `readings (B, R)`."""
        anchor = readings[:, -1 - self._vector_size, None]
        return anchor + readings[:, :KNOTS] + self.head(readings)

    @property
    def _vector_size(self) -> int:
        return vector_size(self.points.shape[-1])

    @staticmethod
    def at(knots: Tensor, level: Tensor) -> Tensor:
        """Log cost `(B,)` at ℓ `(B,)`, given `knots (B, KNOTS)`."""
        place = (level[:, None] + 1) / 2 * (KNOTS - 1)
        index = torch.arange(KNOTS, device=level.device, dtype=level.dtype)
        return (knots * (1 - (place - index).abs()).clamp_min(0)).sum(-1)


def standard_curves(dim: int, observer: Observer, number: int) -> Array:
    """Controls `(number, 4, D)` of curves that cover an empty room evenly, in the frame.

    Elites of its archive, of which the next is always that whose most deviating point is farthest
    from the straight line's and from all before.

    Raises:
        InvalidInputError: there are fewer curves within the detour.
    """
    start, goal = np.zeros(dim), np.eye(dim)[0]
    distractor, wall = 5 * np.eye(dim)[1], np.full(dim, 100.0)
    room = Scene(start, [goal, distractor], [-wall, wall])
    watching = Observer(detour=observer.detour)
    cells = _CELLS[dim]
    archive = build_archive(room, observer=watching, cells=cells)
    while len(archive) < number and cells < 8 * _CELLS[dim]:
        cells *= 2
        archive = build_archive(room, observer=watching, cells=cells)
    if len(archive) < number:
        raise InvalidInputError(
            f"curves must be at most {len(archive)} for detour {observer.detour:g}, got {number}"
        )
    points = archive.descriptors
    gaps = np.linalg.norm(points - (start + goal) / 2, axis=-1)
    chosen = np.empty(number, dtype=np.intp)
    for i in range(number):
        chosen[i] = np.argmax(gaps)
        gaps = np.minimum(gaps, np.linalg.norm(points - points[chosen[i]], axis=-1))
    return archive.controls[chosen]
