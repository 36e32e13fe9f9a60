"""Train on recorded motions in a style of their own, then plan and execute in that style.

The motions here are synthetic: reaches that swing from side to side, recorded at 100 Hz with rests
and noise. No cubic Bézier swings so. Put your own recordings in their place.
"""

import csv
import subprocess
import sys
from pathlib import Path

import gymnasium
import numpy as np
import yaml

import legibility as lg
from legibility.curves import resample

MOTIONS = 20  # in each scene


def swinging_reach(scene, rng):
    """Positions (T, 2) [m] of a reach with three swings, as a sensor records it."""
    share = np.linspace(0, 1, 200)
    share = share**3 * (10 - 15 * share + 6 * share**2)  # from rest to rest by least jerk
    along = scene.goals[0] - scene.start
    bend, swing = rng.normal(0, 0.25), 0.06
    across = bend * np.sin(np.pi * share) + swing * np.sin(3 * np.pi * share)
    points = scene.start + share[:, None] * along + across[:, None] * [-along[1], along[0]]
    return np.pad(points, ((100, 100), (0, 0)), "edge") + rng.normal(0, 5e-4, (400, 2))


def swing(trajectories):
    """Amplitude of the third wave across the straight line, over its length, `(N,)`."""
    points = np.stack([resample(np.asarray(trajectory), 50) for trajectory in trajectories])
    along = points[:, -1] - points[:, 0]
    offset = points - points[:, :1]
    across = along[:, None, 0] * offset[..., 1] - along[:, None, 1] * offset[..., 0]
    wave = np.sin(3 * np.pi * (offset @ along[..., None])[..., 0] / (along**2).sum(-1)[:, None])
    return 2 * (across * wave).mean(-1) / (along**2).sum(-1)


def main(folder="out/your-data", steps=2000, number=20):
    rng, folder, scenes = np.random.default_rng(0), Path(folder), {}
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / "recordings.csv", "w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["trajectory", "scene", "target", "t", "x", "y"])
        while len(scenes) < int(number):
            scene = lg.Scene.random(rng, num_goals=3)
            motions = [swinging_reach(scene, rng) for _ in range(MOTIONS)]
            if not all(scene.contains(points, 0.03).all() for points in motions):
                continue
            name = f"scene {len(scenes)}"
            scenes[name] = scene
            for i, points in enumerate(motions):
                rows = enumerate(points.round(5).tolist())
                table.writerows([f"{name}, {i}", name, 0, t / 100, *point] for t, point in rows)
    content = {"scenes": {name: scene.to_dict() for name, scene in scenes.items()}}
    (folder / "scenes.yaml").write_text(yaml.safe_dump(content))

    for line in (
        "data --from recordings.csv --scenes scenes.yaml --mix 0.3 --regime dragan --views 1 "
        "--out data",
        f"train path --data data --steps {steps} --scenes 64 --out run --weights weights "
        "--policy block-reach-2d --json train.json",
    ):
        command = [sys.executable, "-m", "legibility", *line.split()]
        subprocess.run(command, cwd=folder, check=True)

    modulator = lg.Modulator.from_pretrained(folder / "weights")
    recordings = lg.read_recordings(folder / "recordings.csv", dim=2)
    for name, scene in list(scenes.items())[:3]:
        shown = [recording for recording in recordings if recording.scene == name]
        labels = [score.achieved for score in lg.score(shown, scene)]
        levels = np.quantile(labels, np.linspace(0.1, 0.9, 9))  # where there are recordings
        path = modulator.plan(scene, legibility=levels, seed=0)
        print(name)
        print("  asked   ", levels.round(2))
        print("  achieved", path.achieved.round(2))
        archive = lg.build_archive(scene).trajectories
        swings = [np.median(swing(x)) for x in ([r.motion for r in shown], path.trajectory())]
        print("  swing of the recordings, the plans, the archive:", end=" ")
        print(np.round([*swings, np.median(swing(archive))], 3))
    env = gymnasium.make("legibility/BlockReach2D-v0")
    env.reset(seed=0, options={"scene": scene, "target": 0})
    rollout = modulator.execute(env, legibility=1.0, seed=0)
    print("executed", round(float(rollout.achieved), 2), "at the goal:", rollout.success)


if __name__ == "__main__":
    main(*sys.argv[1:])
