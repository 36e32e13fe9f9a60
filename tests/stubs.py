"""A modulator that has learned nothing: its paths are those of the scene's archive."""

import numpy as np
from pictures import path_of

from legibility.motion.archive import scene_archive
from legibility.rollout import Rollout


class StubModulator:
    """Remembers the keywords of its last call."""

    def path(self, scene, target, level, observer):
        path = path_of(scene_archive(scene, target, observer), level)
        curve = path.trajectory(200)
        path.__dict__["clearance"] = scene.clearance_at(curve, target).min(-1)
        path.__dict__["feasible"] = scene.feasible(curve, target)
        return path

    def plan(self, scene, target, levels, *, seed, observer, **options):
        self.options = {"seed": seed, "observer": observer, **options}
        return self.path(scene, target, levels, observer)

    def execute_many(self, robots, *, legibility, seed, observer, **options):
        self.options = {"seed": seed, "observer": observer, **options}
        rollouts = []
        for scene, target, level in zip(robots.scenes, robots.targets, legibility, strict=True):
            path = self.path(scene, int(target), level, observer)
            states = path.trajectory(25)
            actions = np.diff(states, axis=0)
            rollouts.append(Rollout(path, states, actions, True, "reached", (),
                                    np.zeros(len(actions)), 0.05, 0))  # fmt: skip
        return rollouts
