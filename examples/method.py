"""A method of your own: legibility evaluate table1 --method examples/method.py:plan"""

import numpy as np

import legibility as lg


def plan(scene, target, legibility):
    """An arc, the higher the more legible, that leaves the other goals on its other side."""
    start, goal = scene.start, scene.goals[target]
    share, away = np.linspace(0, 1, 50)[:, None], goal - scene.distractors(target).mean(axis=0)
    side = away - (goal - start) * (away @ (goal - start)) / ((goal - start) @ (goal - start))
    arc = start + share * (goal - start) + legibility * np.sin(np.pi * share) * side
    return np.clip(arc, *scene.workspace)


class Wave:
    """A policy: it keeps an aim that comes back to the target as the robot comes nearer."""

    def __init__(self, scene, target, legibility):
        self.goal, away = scene.goals[target], scene.goals[target] - scene.distractors(target)
        self.side = legibility * away.mean(axis=0)

    def act(self, position, limit):
        """The next displacement [m]; `limit` is the largest along each axis."""
        gap = self.goal - position
        gap = gap + self.side * min(1, np.linalg.norm(gap))
        return gap * min(1, limit / np.abs(gap).max() / 2)


if __name__ == "__main__":
    scene = lg.Scene.load("examples/paper.yaml")
    archive = lg.build_archive(scene, target=0)
    scores = [lg.Observer().score(plan(scene, 0, level), scene, 0) for level in (-1, 0, 1)]
    print(archive.label_of(np.array(scores)))
