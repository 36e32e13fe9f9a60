"""Trained baselines by the name of their method."""

from ..errors import CheckpointError, InvalidInputError
from ..models.goal_policy import GoalPolicy
from ..models.pretrained import load_stages, pretrained_folder


def baseline_names(dim: int) -> dict[str, str]:
    """The shipped weights of each baseline in 2-D or 3-D."""
    robot = {2: "2d", 3: "panda"}[dim]
    methods = ("diffusion policy", "legibility diffuser")
    return {method: f"{method.replace(' ', '-')}-{robot}" for method in methods}


def load_baselines(names: dict[str, str]) -> dict[str, GoalPolicy]:
    """The policies of weights by the name of their method.

    Args:
        names: names or folders of weights, by `diffusion policy` and `legibility diffuser`.

    Raises:
        CheckpointError: weights are missing, corrupted or without a goal-conditioned policy.
        InvalidInputError: weights are of the other method.
    """
    policies = {}
    for method, weights in names.items():
        stages, _ = load_stages(pretrained_folder(weights))
        if "goal" not in stages:
            raise CheckpointError(f"{weights} has no goal-conditioned policy")
        policies[method] = stages["goal"].eval().requires_grad_(False)
        guided = policies[method].config.guidance > 0
        if guided != (method == "legibility diffuser"):
            raise InvalidInputError(
                f"{weights} is {'' if guided else 'not '}guided, so it is no {method}"
            )
    return policies
