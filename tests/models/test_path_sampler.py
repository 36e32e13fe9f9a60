"""Paths are drawn from the seed alone, and again where they fall on the wrong side."""

import numpy as np
import pytest
import torch

import legibility as lg
from legibility.curves import NUM_WAYPOINTS
from legibility.errors import CheckpointError, InvalidInputError
from legibility.models.configuration import PathDiffuserConfig
from legibility.models.diffusion import noise_schedule
from legibility.models.frame import Frame
from legibility.models.path_diffuser import PathDiffuser
from legibility.models.path_sampler import PathSampler, Sampling
from legibility.motion.path import Path

SCENE = lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]])
TINY = {"channels": (8, 16), "condition": 16, "encoder_width": 8, "resolution": 16}
PLAIN = Sampling()


def network(**changes):
    torch.manual_seed(0)
    model = PathDiffuser(PathDiffuserConfig(**TINY, **changes))
    torch.nn.init.normal_(model.unet.outlet.weight, std=0.3)
    model.signal.copy_(noise_schedule(model.config.diffusion_steps))
    return model.eval().requires_grad_(False)


def bulge(size):
    """Waypoints `(K, 2)` in the frame of an arc whose height is `size` of its length."""
    along = np.linspace(0, 1, NUM_WAYPOINTS + 2)[1:-1]
    return np.stack([along, size * np.sin(np.pi * along)], axis=-1)


class Scripted:
    """In place of `PathDiffuser.sample`: the next of some bulges for each batch of levels."""

    def __init__(self, *sizes):
        self.sizes, self.levels = list(sizes), []

    def __call__(self, conditions, level, noise, **options):
        self.levels.append(level.tolist())
        size = self.sizes.pop(0)
        return torch.tensor(np.stack([bulge(s) for s in np.broadcast_to(size, len(level))])).float()


def scripted(*sizes, **changes):
    script = Scripted(*sizes)
    return PathSampler(network(**changes), script, "script"), script


def score(waypoints):
    return Path.through(waypoints, SCENE, 0, np.asarray(0.0), lg.Observer()).score


class TestDraw:
    def test_from_the_start_to_the_goal_of_each_scene(self):
        scenes = [lg.Scene.random(np.random.default_rng(seed)) for seed in range(3)]
        sampler, _ = scripted(0.2)
        paths = sampler.draw(scenes, [0, 1, 1], np.zeros(3), 0, PLAIN)
        assert paths.shape == (3, NUM_WAYPOINTS + 2, 2)
        for path, scene, target in zip(paths, scenes, [0, 1, 1], strict=True):
            np.testing.assert_array_equal(path[[0, -1]], [scene.start, scene.goals[target]])
            wanted = Frame.of(scene, target).frame_to_world(bulge(0.2))
            np.testing.assert_allclose(path[1:-1], wanted, atol=1e-6)

    def test_the_seed_alone_decides(self):
        sampler = PathSampler(model := network(), model.sample, "tiny")
        draws = [sampler.draw([SCENE], [0], np.zeros(2), seed, PLAIN) for seed in (1, 1, 2)]
        np.testing.assert_array_equal(draws[0], draws[1])
        assert np.abs(draws[0] - draws[2]).max() > 1e-3

    def test_what_is_not_finite_is_the_models_fault(self):
        sampler, _ = scripted(np.nan)
        with pytest.raises(CheckpointError, match="the model script drew a path that is not"):
            sampler.draw([SCENE], [0], np.zeros(1), 0, PLAIN)


class TestRetries:
    @pytest.fixture(autouse=True)
    def sides(self):
        """In this scene a bulge to the left is legible, one to the right ambiguous."""
        straight, left, right = (
            score(np.concatenate([[SCENE.start], Frame.of(SCENE, 0).frame_to_world(bulge(size)),
                                  [SCENE.goals[0]]]))
            for size in (0.0, 0.4, -0.4)
        )  # fmt: skip
        assert right < straight < left

    def test_the_right_side_is_kept(self):
        sampler, script = scripted(0.4)
        sampler.draw_with_retries([SCENE], [0], np.array([0.7]), 0, PLAIN)
        assert script.levels == [pytest.approx([0.7])]

    def test_the_wrong_side_is_drawn_again_for_a_little_less(self):
        sampler, script = scripted(-0.4, -0.4, 0.4)
        paths = sampler.draw_with_retries([SCENE], [0], np.array([1.0]), 0, PLAIN)
        assert np.diff(np.concatenate(script.levels)).max() < 0
        assert min(script.levels)[0] > 0.9
        assert score(paths[0]) > score(np.linspace(SCENE.start, SCENE.goals[0], 10))

    def test_only_those_on_the_wrong_side(self):
        sampler, script = scripted([0.4, 0.4, -0.4], [-0.4])
        levels = np.array([1.0, -0.5, -1.0])
        paths = sampler.draw_with_retries([SCENE], [0], levels, 0, PLAIN)
        assert [len(level) for level in script.levels] == [3, 1]
        assert script.levels[1][0] == pytest.approx(-0.5 * 0.97)
        straight = score(np.linspace(SCENE.start, SCENE.goals[0], 10))
        assert ((score(paths) - straight) * levels > 0).all()

    def test_it_gives_up(self):
        sampler, script = scripted(*[-0.4] * 4)
        sampler.draw_with_retries([SCENE], [0], np.array([1.0]), 0, PLAIN)
        assert len(script.levels) == 4

    @pytest.mark.parametrize(
        "changes", [{"observer": lg.Observer(label="rank")}, {"field": False}], ids=str
    )
    def test_none_without_a_straight_line_to_compare_with(self, changes):
        sampler, script = scripted(-0.4, **changes)
        sampler.draw_with_retries([SCENE], [0], np.array([1.0]), 0, PLAIN)
        assert len(script.levels) == 1


class TestSampling:
    @pytest.mark.parametrize(
        ("wrong", "match"),
        [
            ({"guidance": np.nan}, "guidance"),
            ({"guidance": [1.0]}, "guidance"),
            ({"steps": 0}, "steps"),
            ({"steps": 101}, "steps must be at most 100, got 101"),
            ({"steps": True}, "steps"),
        ],
        ids=str,
    )
    def test_refuses(self, wrong, match):
        with pytest.raises(InvalidInputError, match=match):
            Sampling(**wrong).checked(PathDiffuserConfig())

    def test_any_other_is_itself(self):
        for sampling in (PLAIN, Sampling(0.5, 7), Sampling(guidance=-1.0), Sampling(steps=100)):
            assert sampling.checked(PathDiffuserConfig()) == sampling

    def test_a_student_has_one_way_only(self):
        config = PathDiffuserConfig(distilled=True, guidance=0.0, sampling_steps=1)
        for sampling in (PLAIN, Sampling(0.0, 1), Sampling(guidance=0), Sampling(steps=1)):
            sampling.checked(config)
        with pytest.raises(InvalidInputError, match="guidance 0 in 1 steps only"):
            Sampling(steps=3).checked(config)
        with pytest.raises(InvalidInputError, match=r"got guidance 0\.3 and steps None"):
            Sampling(guidance=0.3).checked(config)
