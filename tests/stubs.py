"""A modulator that has learned nothing: its paths are those of the scene's archive."""

from pictures import path_of, rollout_of

from legibility.motion.archive import scene_archive


class StubModulator:
    """Remembers the keywords of its last call."""

    def path(self, scene, target, level, observer):
        return path_of(scene_archive(scene, target, observer), level)

    def plan(self, scene, target, levels, *, seed, observer, **options):
        self.options = {"seed": seed, "observer": observer, **options}
        return self.path(scene, target, levels, observer)

    def execute_many(self, robots, *, legibility, seed, observer, **options):
        self.options = {"seed": seed, "observer": observer, **options}
        rollouts = []
        for scene, target, level in zip(robots.scenes, robots.targets, legibility, strict=True):
            path = self.path(scene, int(target), level, observer)
            rollouts.append(rollout_of(path, path.trajectory(25)))
        return rollouts
