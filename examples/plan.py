"""Plan the paper's scene at three levels of legibility and print what was achieved."""

import legibility as lg

scene = lg.Scene(start=[0, 0.5], goals=[[0.8, 0.6], [1, 0.3]])
modulator = lg.Modulator.from_pretrained("block-reach-2d")
path = modulator.plan(scene, target=0, legibility=[-1, 0, 1], seed=0)
for asked, achieved, points in zip(path.legibility, path.achieved, path.trajectory(), strict=True):
    print(f"asked {asked:+.2f}, achieved {achieved:+.2f}, halfway at {points[len(points) // 2]}")
