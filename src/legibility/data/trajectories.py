"""A dataset as a Dataset of PyTorch."""

from __future__ import annotations

import torch
from torch import Tensor

from .dataset import Dataset
from .export import scene_arrays


class TorchTrajectories(torch.utils.data.Dataset[dict[str, Tensor]]):
    """The trajectories of a dataset as samples, which a DataLoader stacks into batches.

    With G the most goals of a scene, a sample holds

    * `start (D,)`, `waypoints (K, D)` and `goals (G, D)` [m], the target first, 0 where the scene
      has no more; `goal_mask (G,)`, whether there is a goal;
    * `label` and `score` `()`;
    * `row ()` int64, the place of its scene and observer in `Dataset.scenes` and `.observers`.

    All numbers but `row` are float32.
    """

    def __init__(self, data: Dataset) -> None:
        rows = {name: torch.from_numpy(array) for name, array in scene_arrays(data.scenes).items()}
        self._of_row = {
            "start": rows["starts"], "goals": rows["goals"], "goal_mask": rows["goal_mask"]
        }  # fmt: skip
        self._of_each = {
            name: torch.tensor(array)
            for name, array in (
                ("waypoints", data.waypoints), ("label", data.labels), ("score", data.scores)
            )
        }  # fmt: skip
        self._number = data.labels.shape[1]

    def __len__(self) -> int:
        return len(self._of_row["start"]) * self._number

    def __getitem__(self, index: int) -> dict[str, Tensor]:
        if not -len(self) <= index < len(self):
            raise IndexError(f"index must be below {len(self)}, got {index}")
        row, each = divmod(index % len(self), self._number)
        return {
            **{name: values[row] for name, values in self._of_row.items()},
            **{name: values[row, each] for name, values in self._of_each.items()},
            "row": torch.tensor(row),
        }
