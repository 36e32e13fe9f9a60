"""A robot's own loop: on the way the dial is turned, the robot is pushed, its target moves."""

import numpy as np

import legibility as lg

scene = lg.Scene(start=[0, 0.5], goals=[[0.8, 0.6], [1, 0.3]])
modulator = lg.Modulator.from_pretrained("block-reach-2d")
controller = modulator.controller(scene, target=0, legibility=1.0, dt=0.05)
position = scene.start
while not controller.done and not controller.stalled:
    position = position + 0.8 * controller.step(position, scene)  # your robot instead
    match len(controller.states):
        case 5:
            controller.replan(legibility=0.5)
        case 12:
            position = position + np.array([0.0, 0.05])
        case 20:
            scene = lg.Scene(scene.start, [[0.85, 0.55], [1, 0.3]])
    if len(controller.states) % 5 == 0:
        belief = controller.posterior[0]
        print(f"at {np.round(position, 2)}, belief {belief:.2f}, l {controller.achieved:+.2f}")
controller.motion().save("out/loop.csv")
