"""Paths are drawn from the seed alone, and brought to their levels out of contact."""

import numpy as np
import pytest
import torch

import legibility as lg
from legibility.curves import NUM_WAYPOINTS, arc_length, path_curve, turning
from legibility.errors import CheckpointError, InvalidInputError
from legibility.frame import Frame
from legibility.models import path_sampler
from legibility.models.configuration import PathDiffuserConfig
from legibility.models.diffusion import noise_schedule
from legibility.models.path_diffuser import PathDiffuser
from legibility.models.path_sampler import PathSampler, Sampling, Tasks
from legibility.motion.archive import scene_archive
from legibility.motion.rough_archive import rough_archive

SCENE = lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]])
BARRED = lg.Scene(SCENE.start, SCENE.goals, obstacles=[lg.Ball([0.4, 0.55], 0.08)])
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
        self.sizes, self.levels, self.dials = list(sizes), [], []

    def __call__(self, conditions, level, noise, *, dial, **options):
        self.levels.append(level.tolist())
        self.dials.append(dial)
        size = self.sizes.pop(0)
        paths = np.stack([bulge(s) for s in np.broadcast_to(size, len(level))])
        return torch.tensor(paths).float()


def scripted(*sizes, **changes):
    script = Scripted(*sizes)
    return PathSampler(network(**changes), script, "script"), script


def score(paths):
    return lg.Observer().score(path_curve(paths, 200), SCENE, 0)


def tasks(levels, scene=SCENE):
    """Of the default observer."""
    return Tasks([scene], [0], [lg.Observer()], np.atleast_1d(np.asarray(levels, dtype=float)))


def through(size, scene=SCENE):
    """The path `(K + 2, D)` of a bulge."""
    inner = Frame.of(scene, 0).frame_to_world(bulge(size))
    return np.concatenate([[scene.start], inner, [scene.goals[0]]])


class TestDraw:
    def test_from_the_start_to_the_goal_of_each_scene(self):
        scenes = [lg.Scene.random(np.random.default_rng(seed)) for seed in range(3)]
        sampler, _ = scripted(0.2)
        each = Tasks(scenes, [0, 1, 1], [lg.Observer()] * 3, np.zeros(3))
        paths = sampler.draw(each, 0, PLAIN)
        assert paths.shape == (3, NUM_WAYPOINTS + 2, 2)
        for path, scene, target in zip(paths, scenes, [0, 1, 1], strict=True):
            np.testing.assert_array_equal(path[[0, -1]], [scene.start, scene.goals[target]])
            wanted = Frame.of(scene, target).frame_to_world(bulge(0.2))
            np.testing.assert_allclose(path[1:-1], wanted, atol=1e-6)

    def test_the_seed_alone_decides(self):
        sampler = PathSampler(model := network(), model.sample, "tiny")
        draws = [sampler.draw(tasks(np.zeros(2)), seed, PLAIN) for seed in (1, 1, 2)]
        np.testing.assert_array_equal(draws[0], draws[1])
        assert np.abs(draws[0] - draws[2]).max() > 1e-3

    def test_what_is_not_finite_is_the_models_fault(self):
        sampler, _ = scripted(np.nan)
        with pytest.raises(CheckpointError, match="the model script drew a path that is not"):
            sampler.draw(tasks(0.0), 0, PLAIN)

    def test_the_network_is_told_the_dial_of_each_scene(self):
        sampler, script = scripted(0.1, 0.1)
        each = Tasks([SCENE, BARRED], [0, 1], [lg.Observer(), lg.Observer(beta=3)], np.zeros(2))
        sampler.draw(each, 0, PLAIN)
        for dial, row in zip(script.dials[0], zip(*each[:3], strict=True), strict=True):
            scores = rough_archive(*row).score_of(np.linspace(-1, 1, 17))
            np.testing.assert_allclose(dial, np.log(-scores), rtol=1e-5)
        sampler.draw(tasks([0.1, 0.2, 0.3]), 0, PLAIN)
        assert script.dials[1].shape == (1, 17)  # of the one scene

    def test_a_network_without_the_field_is_not(self):
        sampler, script = scripted(0.1, field=False)
        sampler.draw(tasks(0.0), 0, PLAIN)
        assert script.dials == [None]


class TestTasks:
    def test_margin(self):
        """0 where a path keeps clear, else how deep its worst point lies."""
        paths = np.stack([through(0.4), through(0.0)])
        margin = tasks([0, 0], BARRED).margin(paths)
        assert margin[0] == 0
        assert margin[1] == pytest.approx(-0.08, abs=4e-3)


class TestPlan:
    def test_moves_a_path_out_of_contact(self):
        sampler, _ = scripted(0.05)
        paths, replaced = sampler.plan(tasks(0.5, BARRED), 0, PLAIN, exact=False, refine=True)
        assert BARRED.feasible(path_curve(paths, 200), 0).all()
        assert not replaced.any()

    @pytest.mark.parametrize("exact", [False, True])
    def test_meets_the_score_that_the_archive_asks_for(self, exact):
        """And the curve through a bulge keeps its own where there is no field."""
        levels, sizes = [0.5, -0.5, 0.2], [0.1, -0.3, 0.3]
        archive = (scene_archive if exact else rough_archive)(SCENE, 0, lg.Observer())
        wanted, drawn = archive.score_of(levels), score(np.stack(list(map(through, sizes))))
        assert (np.abs(np.log(drawn / wanted)) > 0.1).all()
        for field, expected in ((True, wanted), (False, drawn)):
            sampler, _ = scripted(sizes, field=field)
            paths, replaced = sampler.plan(tasks(levels), 0, PLAIN, exact=exact, refine=True)
            np.testing.assert_allclose(score(paths), expected, rtol=0.01)
            assert not replaced.any()

    @pytest.mark.parametrize("exact", [False, True])
    def test_of_several_candidates_the_first_meets_the_score_and_the_others_keep_theirs(
        self, exact
    ):
        archive = (scene_archive if exact else rough_archive)(SCENE, 0, lg.Observer())
        wanted, sizes = archive.score_of([0.8, -0.5]), [0.3, 0.1, -0.3, -0.1]
        drawn = score(np.stack(list(map(through, sizes))))
        sampler, _ = scripted(sizes)
        four = tasks([0.8, 0.8, -0.5, -0.5])
        paths, _ = sampler.plan(four, 0, PLAIN, exact=exact, refine=True, candidates=2)
        expected = [wanted[0], drawn[1], wanted[1], drawn[3]]
        assert (np.abs(np.log(drawn / wanted.repeat(2))) > 0.1).all()
        np.testing.assert_allclose(score(paths), expected, rtol=0.01)

    def test_each_row_meets_the_score_of_its_own_scene(self):
        scenes, levels = [SCENE, BARRED], np.array([0.9, 0.6])
        observers = [lg.Observer(), lg.Observer(beta=5)]
        sampler, _ = scripted([0.2, 0.2])
        paths, _ = sampler.plan(
            Tasks(scenes, [0, 0], observers, levels), 0, PLAIN, exact=False, refine=True
        )
        for path, level, scene, observer in zip(paths, levels, scenes, observers, strict=True):
            wanted = rough_archive(scene, 0, observer).score_of(level)
            assert observer.score(path_curve(path, 200), scene, 0) == pytest.approx(
                wanted, rel=0.01
            )

    def test_takes_the_archives_nearest_curve_where_that_comes_nearer(self):
        """A path on one side of a wall cannot get the score of the other."""
        wall = lg.Box([0.4, 0.55], [0.5, 0.12], np.arctan2(0.1, 0.8))
        walled = lg.Scene(SCENE.start, SCENE.goals, obstacles=[wall])
        archive = scene_archive(walled, 0, lg.Observer())
        level = archive.label_of(score(np.stack([through(0.4), through(-0.4)])))
        assert level[1] < level[0] - 0.5
        levels = np.array([level[0], level[1], level[1]])
        sampler, _ = scripted([0.4, -0.4, 0.4])
        paths, replaced = sampler.plan(tasks(levels, walled), 0, PLAIN, exact=True, refine=True)
        assert walled.feasible(path_curve(paths, 200), 0).all()
        np.testing.assert_allclose(archive.label_of(score(paths)), levels, atol=0.03)
        assert replaced.tolist() == [False, False, True]

    @pytest.mark.parametrize("better", [True, False])
    def test_keeps_what_was_drawn_where_the_archives_curve_is_no_nearer(self, monkeypatch, better):
        """Where neither can be moved."""
        archive = scene_archive(BARRED, 0, lg.Observer())
        drawn, elite = through(0.4), through(0.3 if better else 0.5)
        label = archive.label_of(score(np.stack([drawn, elite])))
        level = label[1] + 0.1 * (label[1] - label[0]) if better else 2 * label[0] - label[1]
        monkeypatch.setattr(path_sampler, "project", lambda p, *_, **__: (p, np.ones(len(p), bool)))
        monkeypatch.setattr(path_sampler, "smoothed", lambda paths: paths)
        monkeypatch.setattr(
            path_sampler, "bezier_trajectories", lambda c, _: np.tile(elite, (len(c), 1, 1))
        )
        sampler, _ = scripted(0.4)
        paths, replaced = sampler.plan(tasks(level, BARRED), 0, PLAIN, exact=True, refine=True)
        assert replaced.tolist() == [better]
        np.testing.assert_allclose(paths[0], elite if better else drawn, atol=1e-6)

    @pytest.mark.parametrize("wave", [0.0, 0.02])
    def test_a_curve_of_the_archive_stands_in_for_a_wavy_path(self, monkeypatch, wave):
        drawn = through(0.4)
        drawn[1:-1, 1] += wave * (-1) ** np.arange(NUM_WAYPOINTS)
        level = scene_archive(BARRED, 0, lg.Observer()).label_of(score(drawn[None]))
        monkeypatch.setattr(path_sampler, "project", lambda p, *_, **__: (p, np.ones(len(p), bool)))
        monkeypatch.setattr(path_sampler, "smoothed", lambda _: drawn[None].copy())
        sampler, _ = scripted(0.4)
        paths, replaced = sampler.plan(tasks(level, BARRED), 0, PLAIN, exact=True, refine=True)
        assert replaced.tolist() == [wave > 0]
        turned = turning(path_curve(np.stack([drawn, paths[0]]), 200))
        assert (turned[1] < turned[0] - 0.5) == (wave > 0)

    @pytest.mark.parametrize("exact", [False, True])
    def test_a_straight_line_along_a_wall_is_taken(self, exact):
        """Projection keeps off the wall, so the straight line itself must stand in."""
        along = lg.Scene([0.2, 0], [[0.8, 0], [0.9, 0.4]], [[0, 0], [1, 1]])
        sampler, _ = scripted(0.1)
        paths, replaced = sampler.plan(tasks(0.0, along), 0, PLAIN, exact=exact, refine=True)
        np.testing.assert_allclose(paths[0], np.linspace([0.2, 0], [0.8, 0], 10), atol=1e-9)
        assert replaced.all()

    def test_no_candidate_is_longer_than_the_detour(self):
        sampler, _ = scripted([0.4, 1.6])
        two = tasks([1.0, 1.0])
        paths, _ = sampler.plan(two, 0, PLAIN, exact=False, refine=True, candidates=2)
        lengths = arc_length(path_curve(paths, 200))
        assert (lengths <= 1.01 * 2.5 * np.linalg.norm(SCENE.goals[0] - SCENE.start)).all()

    def test_unrefined_is_what_was_drawn(self):
        sampler, _ = scripted(0.05)
        paths, replaced = sampler.plan(tasks(0.5, BARRED), 0, PLAIN, exact=False, refine=False)
        np.testing.assert_allclose(paths[0], through(0.05), atol=1e-6)
        assert not replaced.any()
        with pytest.raises(InvalidInputError, match="exact plans are refined"):
            sampler.plan(tasks(0.5), 0, PLAIN, exact=True, refine=False)

    def test_the_archives_nearest_curve_stands_in(self, monkeypatch):
        monkeypatch.setattr(
            path_sampler, "project", lambda paths, *_, **__: (paths, np.zeros(len(paths), bool))
        )
        sampler, _ = scripted([0.4, 0.05])
        archive = rough_archive(BARRED, 0, lg.Observer())
        level = float(archive.label_of(score(through(0.4)[None]))[0])
        paths, replaced = sampler.plan(
            tasks([level, 0.9], BARRED), 0, PLAIN, exact=False, refine=True
        )
        assert replaced.tolist() == [False, True]
        np.testing.assert_allclose(paths[0], through(0.4), atol=5e-3)  # smoothed
        assert BARRED.feasible(path_curve(paths, 200), 0).all()


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
