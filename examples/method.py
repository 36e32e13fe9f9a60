"""A method of your own: legibility evaluate table1 --method examples/method.py:plan"""

import numpy as np

import legibility as lg


def plan(scene, target, legibility, seed, observer):
    """Of 200 random arcs, the one whose score has the rank that ℓ asks for."""
    share = np.linspace(0, 1, 50)[:, None]
    line = scene.start + share * (scene.goals[target] - scene.start)
    bows = np.random.default_rng(seed).normal(0, 0.3 * scene.size, (200, 1, scene.dim))
    arcs = np.clip(line + np.sin(np.pi * share) * bows, *scene.workspace)
    order = observer.score(arcs, scene, target).argsort()
    return arcs[order[round(199 * (1 + legibility) / 2)]]


class Wave:
    """A policy: it aims beside the target, and at it as the robot comes nearer."""

    def __init__(self, scene, target, legibility):
        self.goal, away = scene.goals[target], scene.goals[target] - scene.distractors(target)
        self.side = legibility * away.mean(axis=0)

    def act(self, position, limit):
        """The next displacement [m]; `limit` is the largest along each axis."""
        gap = self.goal - position
        gap = gap + self.side * min(1, np.linalg.norm(gap))
        return gap * min(1, limit / np.abs(gap).max() / 2)


if __name__ == "__main__":
    scene, observer = lg.Scene.load("examples/paper.yaml"), lg.Observer()
    archive = lg.build_archive(scene, target=0, observer=observer)
    for level in (-1, 0, 1):
        motion = plan(scene, 0, level, seed=0, observer=observer)
        print(level, archive.label_of(observer.score(motion, scene, 0)))
