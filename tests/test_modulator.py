"""Whatever the weights: paths run from the start to the goal and touch nothing."""

import dataclasses
import functools
import json

import gymnasium
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from rooms import BESIDE, OVER, room

import legibility as lg
from legibility.curves import path_curve
from legibility.drivers import Feedback
from legibility.envs.block_reach_2d import BlockReach2DVector
from legibility.errors import CheckpointError, InvalidInputError, InvalidSceneError
from legibility.intent.metrics import SCORE_POINTS
from legibility.models.configuration import PathDiffuserConfig, PathPolicyConfig
from legibility.models.diffusion import noise_schedule
from legibility.models.path_diffuser import PathDiffuser
from legibility.models.path_policy import PathPolicy
from legibility.models.path_sampler import Sampling, Tasks
from legibility.models.pretrained import pretrained_names
from legibility.models.provenance import TrainingRecord
from legibility.modulator import Modulator
from legibility.motion import archive
from legibility.motion.path import Path, straight_waypoints
from legibility.robots.arm import PANDA, checked_points

torch.set_num_threads(1)

SCENES = {
    2: lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]]),
    3: lg.Scene([-0.2, -0.2, 0.3], [[0, 0.1, 0.02], [0.05, -0.1, 0.06], [-0.1, 0.2, 0.02]]),
}
BLOCKED = {
    2: lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]], None, [lg.Ball([0.4, 0.55], 0.1)], 0.03),
    3: lg.Scene(SCENES[3].start, SCENES[3].goals, None, [lg.Ball([-0.1, -0.05, 0.16], 0.05)]),
}
LEVELS = [-1.0, -0.3, 0.0, 0.5, 1.0]
RANK = lg.Observer(label="rank")
RECORD = TrainingRecord(
    data={"dim": 2}, digest="00ff", training={"steps": 3}, parameters=12, seconds=1.5,
    step_seconds=0.5, device="cpu", processes=1, precision="no", threads=2, torch="2.6",
)  # fmt: skip


def halved(model):
    """The network as it is stored: its parameters fit into float16."""
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.copy_(parameter.half())
    return model


def make(dim=2, seed=0, noise=0.3, **changes):
    """A tiny untrained modulator; `noise` is the size of its outlet's weights."""
    torch.manual_seed(seed)
    shape = {"channels": (8, 16), "condition": 16, "encoder_width": 8, "resolution": 16}
    model = PathDiffuser(PathDiffuserConfig(**{"dim": dim, **shape, **changes}))
    torch.nn.init.normal_(model.unet.outlet.weight, std=noise)
    torch.nn.init.normal_(model.no_level)
    model.spread.fill_(0.5)
    model.signal.copy_(noise_schedule(model.config.diffusion_steps))
    return Modulator(halved(model), name="tiny")


@pytest.fixture(scope="module", params=[2, 3])
def modulator(request):
    return make(request.param)


@pytest.fixture(scope="module")
def flat():
    return make()


@pytest.fixture
def scene(modulator):
    return SCENES[modulator.config.dim]


class TestPlan:
    @pytest.mark.parametrize("level", [0.5, -1, np.float32(0.25), np.array(1.0)])
    def test_shapes_of_a_number(self, modulator, scene, level):
        path = modulator.plan(scene, 0, level)
        assert isinstance(path, Path)
        assert path.waypoints.shape == (10, scene.dim)
        assert path.trajectory().shape == (SCORE_POINTS, scene.dim)
        assert path.trajectory(7).shape == (7, scene.dim)
        for value in (path.legibility, path.score, path.replaced, path.achieved):
            assert np.shape(value) == ()
        assert path.legibility == level

    @pytest.mark.parametrize("levels", [LEVELS, [0.5], np.linspace(-1, 1, 4), (0, 1)])
    @pytest.mark.parametrize("num_candidates", [1, 2])
    def test_shapes_of_a_batch(self, modulator, scene, levels, num_candidates):
        path = modulator.plan(scene, 0, levels, num_candidates=num_candidates)
        size = len(levels)
        assert path.waypoints.shape == (size, 10, scene.dim)
        assert path.trajectory(9).shape == (size, 9, scene.dim)
        for value in (path.legibility, path.score, path.replaced, path.achieved):
            assert np.shape(value) == (size,)
        np.testing.assert_array_equal(path.legibility, levels)

    @pytest.mark.parametrize("target", [0, 1])
    def test_start_and_goal_are_met_exactly(self, modulator, scene, target):
        path = modulator.plan(scene, target, LEVELS)
        ends = np.tile([scene.start, scene.goals[target]], (len(LEVELS), 1, 1))
        np.testing.assert_array_equal(path.waypoints[:, [0, -1]], ends)
        np.testing.assert_allclose(path.trajectory()[:, [0, -1]], ends, rtol=0, atol=1e-15)
        assert path.target == target

    @pytest.mark.parametrize("num_points", [2, 3, 48, 200])
    def test_everything_stays_in_the_workspace(self, modulator, scene, num_points):
        for seed in range(5):
            path = modulator.plan(scene, 0, LEVELS, seed=seed)
            assert scene.contains(path.waypoints).all()
            assert scene.contains(path.trajectory(num_points)).all()

    def test_score_and_achieved_are_those_of_the_trajectory(self, modulator, scene):
        path = modulator.plan(scene, 1, LEVELS)
        score = lg.metrics.legibility_score(path.trajectory(), lg.Observer().field(scene), 1)
        np.testing.assert_array_equal(path.score, score)
        archive = lg.build_archive(scene, 1)
        np.testing.assert_array_equal(path.achieved, archive.label_of(score))
        assert (np.abs(path.achieved) <= 1).all()

    def test_the_observer_is_the_models_or_another_of_its_scale(self):
        own = lg.Observer(kind="gaussian", sigma=0.3, alpha=1.0, label="rank")
        model = make(observer=own)
        path = model.plan(SCENES[2], 0, LEVELS)
        assert path.observer == model.archive(SCENES[2]).observer == own
        archive = lg.build_archive(SCENES[2], 0, observer=own)
        np.testing.assert_array_equal(path.achieved, archive.label_of(path.score))
        other = dataclasses.replace(own, prior=(1.0, 3.0))
        path = model.plan(SCENES[2], 0, LEVELS, observer=other)
        assert path.observer == other
        archive = lg.build_archive(SCENES[2], 0, observer=other)
        np.testing.assert_array_equal(path.achieved, archive.label_of(path.score))
        for wrong in (dataclasses.replace(own, alpha=2.0), lg.Observer.paper(2), "dragan"):
            with pytest.raises(InvalidInputError, match="observer"):
                model.plan(SCENES[2], 0, observer=wrong)

    def test_the_observer_changes_the_path(self, flat):
        drawn = [
            flat.plan(SCENES[2], 0, 0.5, observer=observer, refine=False).waypoints
            for observer in (None, lg.Observer(), lg.Observer(beta=5.0), lg.Observer.paper(2))
        ]
        np.testing.assert_array_equal(drawn[0], drawn[1])
        assert np.abs(drawn[1] - drawn[2]).max() > 1e-6
        assert np.abs(drawn[1] - drawn[3]).max() > 1e-6

    def test_what_leaves_the_workspace_is_brought_back(self, monkeypatch):
        model, scene = make(), SCENES[2]
        wild = np.tile(np.linspace(scene.start, scene.goals[0], 10), (2, 1, 1))
        wild[1, 4] = [0.4, 3.0]
        again = np.tile(wild[1], (8, 1, 1))
        monkeypatch.setattr(
            model.sampler, "draw", lambda tasks, *_: (wild if len(tasks) == 2 else again).copy()
        )
        path = model.plan(scene, 0, [0.0, 0.0])
        assert path.feasible.all()
        np.testing.assert_allclose(path.waypoints[0], wild[0], atol=1e-12)
        bare = model.plan(scene, 0, [0.0, 0.0], refine=False)
        np.testing.assert_array_equal(bare.waypoints, wild)
        assert bare.feasible.tolist() == [True, False]
        assert bare.clearance[1] < -1

    def test_scene_in_a_corner(self):
        """Start and goal on the walls, and nothing to spare."""
        low, high = np.array([[0.1, 0.1], [0.3, 0.7]])
        scene = lg.Scene(low, [high, [0.1, 0.7]], [low, high])
        path = make().plan(scene, 0, LEVELS)
        assert scene.contains(path.trajectory()).all()
        np.testing.assert_array_equal(path.waypoints[:, -1] - high, 0)


class TestReproducible:
    def test_same_seed_same_path(self, modulator, scene):
        one, other = (modulator.plan(scene, 0, LEVELS, seed=3).waypoints for _ in range(2))
        np.testing.assert_array_equal(one, other)

    def test_other_seed_other_path(self, modulator, scene):
        one, other = (
            modulator.plan(scene, 0, 0.5, seed=seed, refine=False).waypoints for seed in (0, 1)
        )
        assert np.abs(one - other).max() > 1e-3

    def test_paths_of_a_batch_differ(self, modulator, scene):
        one, other = modulator.plan(scene, 0, [0.5, 0.5], refine=False).waypoints
        assert np.abs(one - other).max() > 1e-3

    def test_state_of_torch_does_not_matter(self, modulator, scene):
        torch.manual_seed(1)
        one = modulator.plan(scene, 0, 0.5).waypoints
        state = torch.get_rng_state()
        other = modulator.plan(scene, 0, 0.5).waypoints
        np.testing.assert_array_equal(one, other)
        assert torch.equal(torch.get_rng_state(), state)

    def test_a_number_is_a_batch_of_one(self, modulator, scene):
        for num_candidates in (1, 3):
            options = {"seed": 2, "num_candidates": num_candidates}
            one = modulator.plan(scene, 0, 0.5, **options)
            batch = modulator.plan(scene, 0, [0.5], **options)
            np.testing.assert_array_equal(one.waypoints, batch.waypoints[0])
            assert one.score == batch.score[0]
            assert one.replaced == batch.replaced[0]

    def test_any_seed(self, flat):
        for seed in (0, np.int64(5), 2**31, 2**63 - 1):
            assert np.isfinite(flat.plan(SCENES[2], 0, 0.5, seed=seed).waypoints).all()

    def test_order_of_the_other_goals_does_not_matter(self):
        scene = SCENES[3]
        turned = lg.Scene(scene.start, scene.goals[[0, 2, 1]])
        model = make(3)
        np.testing.assert_allclose(
            model.plan(scene, 0, LEVELS).waypoints,
            model.plan(turned, 0, LEVELS).waypoints,
            atol=1e-5,
        )

    def test_target_is_a_place_not_an_index(self, flat):
        scene = SCENES[2]
        turned = lg.Scene(scene.start, scene.goals[::-1])
        np.testing.assert_allclose(
            flat.plan(scene, 1, LEVELS).waypoints, flat.plan(turned, 0, LEVELS).waypoints, atol=1e-6
        )

    @pytest.mark.parametrize("exact", [False, True])
    def test_moved_and_scaled_scene_has_the_moved_and_scaled_path(self, exact):
        """From metres to centimetres, and kilometres away."""
        model, scene = make(), BLOCKED[2]
        (ball,) = scene.obstacles
        large = lg.Scene(
            scene.start * 100 + 1e5, scene.goals * 100 + 1e5, scene.workspace * 100 + 1e5,
            [lg.Ball(ball.center * 100 + 1e5, ball.radius * 100)], scene.goal_radius * 100,
        )  # fmt: skip
        one, other = (
            model.plan(x, 0, LEVELS, exact=exact, observer=o).waypoints
            for x, o in (
                (scene, lg.Observer(kind="gaussian", sigma=0.1)),
                (large, lg.Observer(kind="gaussian", sigma=10.0)),
            )
        )
        np.testing.assert_allclose((other - 1e5) / 100, one, atol=2e-3)


class TestObstacles:
    @pytest.mark.parametrize("options", [{}, {"exact": True}, {"num_candidates": 3}], ids=str)
    def test_plans_touch_nothing(self, modulator, options):
        scene = BLOCKED[modulator.config.dim]
        path = modulator.plan(scene, 0, LEVELS, **options)
        assert path.feasible.all()
        assert scene.feasible(path.trajectory(400), 0).all()
        assert (path.clearance >= -1e-9).all()
        many = modulator.plan_many([scene] * 2, 0, [0.5, 1.0])
        assert all(p.feasible for p in many)

    def test_the_clearance_is_kept(self, flat):
        base = BLOCKED[2]
        scene = lg.Scene(base.start, base.goals, base.workspace, base.obstacles, clearance=0.04)
        path = flat.plan(scene, 0, LEVELS)
        ball = np.array([o.signed_distance(path.trajectory(400)) for o in scene.obstacles])
        assert ball.min() >= 0.04 - 1e-6

    def test_plans_meet_the_level(self, modulator):
        """Even if the network knows nothing, apart from the ends."""
        scene, levels = BLOCKED[modulator.config.dim], [-0.6, -0.3, 0.0, 0.3]
        for exact, most in ((False, 0.08), (True, 0.03)):
            achieved = modulator.plan(scene, 0, levels, exact=exact).achieved
            assert np.abs(achieved - levels).mean() < most

    def test_no_way_is_refused(self, flat):
        wall = lg.Box([0.5, 0.5], [0.1, 1.2])
        with pytest.raises(InvalidSceneError, match=r"no curve .* was found"):
            flat.plan(lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]], obstacles=[wall]), 0)

    def test_an_obstacle_over_the_target_is_refused(self, flat):
        scene = lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]], obstacles=[lg.Ball([1, 0.3], 0.1)])
        flat.plan(scene, 0, refine=False)
        with pytest.raises(InvalidSceneError, match=r"obstacles\[0\] lies over the target"):
            flat.plan(scene, 1)

    def test_the_bare_network_is_not_exact(self, flat):
        with pytest.raises(InvalidInputError, match="exact"):
            flat.plan(SCENES[2], 0, exact=True, refine=False)


class TestCandidates:
    def test_the_nearest_of_those_drawn_is_returned(self, modulator, scene):
        modulator = make(modulator.config.dim, observer=RANK)  # none is drawn again
        num = 6
        observer = modulator.config.observer
        tasks = Tasks([scene], [0], [observer], np.repeat(LEVELS, num))
        drawn, replaced = modulator.sampler.plan(
            tasks, 4, Sampling(), exact=False, refine=True, candidates=num
        )
        single = Path(scene, 0, tasks.levels, drawn, observer, replaced)
        best = modulator.plan(scene, 0, LEVELS, seed=4, num_candidates=num)
        errors = np.abs(single.achieved - single.legibility).reshape(len(LEVELS), num)
        np.testing.assert_allclose(np.abs(best.achieved - LEVELS), errors.min(1), atol=1e-12)
        assert (errors.min(1) < errors.mean(1)).all()
        nearest = errors.argmin(1)
        scores = single.score.reshape(errors.shape)
        ends = np.abs(LEVELS) == 1  # where labels are clipped the most extreme one is taken
        nearest[ends] = (np.sign(LEVELS)[:, None] * scores).argmax(1)[ends]
        rows = np.arange(len(LEVELS)) * num + nearest
        np.testing.assert_array_equal(best.waypoints, single.waypoints[rows])
        np.testing.assert_array_equal(best.replaced, single.replaced[rows])

    def test_at_the_ends_no_archive_is_needed(self, scene, monkeypatch):
        modulator = make(scene.dim)
        monkeypatch.setattr(modulator, "archive", lambda *_: pytest.fail("an archive was built"))
        found = modulator.plan(scene, 0, [-1, 1, 1], seed=4, num_candidates=5)
        assert found.score[0] < found.score[1:].min()

    def test_many_scenes_each_have_their_candidates(self, modulator, scene):
        scenes, levels = [scene, scene], [1.0, -1.0]
        found = modulator.plan_many(scenes, [0, 1], levels, seed=3, num_candidates=8)
        assert [p.target for p in found] == [0, 1]
        again = modulator.plan_many(scenes, [0, 1], levels, seed=3, num_candidates=8)
        one = modulator.plan_many(scenes, [0, 1], levels, seed=3)
        for best, same, single in zip(found, again, one, strict=True):
            np.testing.assert_array_equal(best.waypoints, same.waypoints)
            assert best.waypoints.shape == single.waypoints.shape == (10, scene.dim)
        with pytest.raises(InvalidInputError, match="num_candidates"):
            modulator.plan_many(scenes, [0, 1], levels, num_candidates=0)

    def test_one_candidate_is_the_plain_plan(self, modulator, scene):
        np.testing.assert_array_equal(
            modulator.plan(scene, 0, LEVELS, num_candidates=1).waypoints,
            modulator.plan(scene, 0, LEVELS).waypoints,
        )

    def test_archive_is_built_once_and_only_if_needed(self, monkeypatch):
        built = []

        make_archive = archive._built

        def build(scene, target, *args):
            built.append((scene, target))
            return make_archive(scene, target, *args)

        monkeypatch.setattr(archive, "_built", build)
        for cache in (archive.scene_archive, archive._geometry):
            cache.cache_clear()
        model = make()
        model.plan(SCENES[2], 0, LEVELS, refine=False)
        assert built == []
        options = {"num_candidates": 2, "refine": False}
        paths = [model.plan(SCENES[2], 0, LEVELS, **options) for _ in range(2)]
        assert len(built) == 1
        assert paths[0].archive is paths[1].archive is model.archive(SCENES[2], 0)
        assert np.isfinite(paths[0].achieved).all()
        model.plan(SCENES[2], 1, LEVELS, **options)
        assert [target for _, target in built] == [0, 1]


class TestOptions:
    def test_guidance(self, modulator, scene):
        plain = modulator.plan(scene, 0, LEVELS).waypoints
        own = modulator.plan(scene, 0, LEVELS, guidance=modulator.config.guidance)
        np.testing.assert_array_equal(own.waypoints, plain)
        guided = modulator.plan(scene, 0, LEVELS, guidance=1.5)
        assert np.abs(guided.waypoints - plain).max() > 1e-3
        assert scene.contains(guided.trajectory()).all()

    @pytest.mark.parametrize("guidance", [-1, 0.3, 10, 1e3])
    def test_any_guidance_stays_inside(self, flat, guidance):
        path = flat.plan(SCENES[2], 0, LEVELS, guidance=guidance)
        assert SCENES[2].contains(path.trajectory()).all()

    @pytest.mark.parametrize("steps", [1, 2, 3, 10, 100])
    def test_steps(self, modulator, scene, steps):
        path = modulator.plan(scene, 0, LEVELS, steps=steps)
        assert np.isfinite(path.waypoints).all()
        plain = modulator.plan(scene, 0, LEVELS).waypoints
        same = steps == modulator.config.sampling_steps
        assert np.allclose(path.waypoints, plain) == same

    @pytest.mark.parametrize(
        "wrong",
        [
            {"legibility": 1.01},
            {"legibility": -2},
            {"legibility": np.nan},
            {"legibility": [0, np.inf]},
            {"legibility": []},
            {"legibility": [[0.5]]},
            {"legibility": "high"},
            {"legibility": None},
            {"target": 2},
            {"target": -1},
            {"target": 0.0},
            {"target": True},
            {"target": "red"},
            {"seed": -1},
            {"seed": 1.5},
            {"seed": 2**64},
            {"seed": 2**100},
            {"num_candidates": 0},
            {"num_candidates": -3},
            {"num_candidates": 2.0},
            {"guidance": np.nan},
            {"guidance": "strong"},
            {"guidance": [1.0]},
            {"steps": 0},
            {"steps": 101},
            {"steps": 2.5},
        ],
        ids=str,
    )
    def test_bad_input(self, flat, wrong):
        with pytest.raises(InvalidInputError, match=next(iter(wrong))):
            flat.plan(**{"scene": SCENES[2], **wrong})

    def test_arrays_and_tensors(self, flat):
        levels = torch.tensor([0.0, 0.5], requires_grad=True)
        path = flat.plan(SCENES[2], np.array(1), levels, seed=np.int64(3))
        plain = flat.plan(SCENES[2], 1, [0.0, 0.5], seed=3)
        np.testing.assert_array_equal(path.waypoints, plain.waypoints)

    def test_no_seed_is_another_path_each_time(self, flat):
        one, other = (flat.plan(SCENES[2], seed=None).waypoints for _ in range(2))
        assert np.abs(one - other).max() > 1e-6

    @pytest.mark.parametrize("wrong", [None, "scene.yaml", SCENES[2].to_dict(), 3])
    def test_something_that_is_no_scene(self, flat, wrong):
        with pytest.raises(InvalidSceneError, match=r"scene must be a legibility\.Scene"):
            flat.plan(wrong)

    def test_scene_of_another_dimension(self, modulator):
        other = SCENES[5 - modulator.config.dim]
        with pytest.raises(InvalidSceneError, match=r"the model tiny plans in .D, the scene is .D"):
            modulator.plan(other)


class TestMaxDetour:
    """No motion is longer than that times the shortest."""

    @pytest.mark.parametrize("scenes", [SCENES, BLOCKED], ids=["free", "blocked"])
    @pytest.mark.parametrize("options", [{}, {"exact": True}, {"num_candidates": 3}], ids=str)
    def test_is_kept(self, modulator, scenes, options):
        scene = scenes[modulator.config.dim]
        shortest = archive.shortest_curve(scene, 0)[1]
        assert modulator.plan(scene, 0, LEVELS, **options).length.max() > 1.5 * shortest
        for detour in (1.05, 1.3):
            path = modulator.plan(scene, 0, LEVELS, max_detour=detour, **options)
            assert (path.length <= detour * shortest * (1 + 1e-6)).all()
            assert path.feasible.all()

    @given(
        st.integers(0, 999), st.sampled_from([2, 3]), st.floats(1.05, 3), st.floats(-1, 1),
        st.integers(0, 2),
    )  # fmt: skip
    @settings(max_examples=15, deadline=None)
    def test_is_kept_in_any_room(self, seed, dim, detour, level, obstacles):
        scene = room(np.random.default_rng(seed), obstacles, dim, size={2: 0.12, 3: 0.06}[dim])
        try:
            shortest = archive.shortest_curve(scene, 0)[1]
        except InvalidSceneError:
            return
        (path,) = make(dim).plan_many([scene], 0, level, seed=seed, max_detour=detour)
        assert path.length <= detour * shortest * (1 + 1e-6)
        assert path.feasible

    def test_of_1_is_the_straight_line(self, modulator, scene):
        path = modulator.plan(scene, 0, LEVELS, max_detour=1)
        line = straight_waypoints(scene.start, scene.goals[0])
        np.testing.assert_allclose(path.waypoints, np.stack([line] * len(LEVELS)), atol=1e-3)

    def test_of_1_is_the_shortest_motion_past_an_obstacle(self, modulator):
        """As a path, which keeps a little more clear than the shortest curve does."""
        scene = BLOCKED[modulator.config.dim]
        path = modulator.plan(scene, 0, LEVELS, max_detour=1)
        assert path.feasible.all()
        assert (path.length <= archive.shortest_curve(scene, 0)[1] * 1.03).all()

    def test_levels_are_met_as_nearly_as_it_allows(self, modulator, scene):
        levels = np.array([-0.8, -0.4, 0.4, 0.8])
        errors = [
            np.abs(modulator.plan(scene, 0, levels, max_detour=detour).achieved - levels)
            for detour in (1.05, 1.3, None)
        ]
        assert errors[0].mean() > errors[1].mean() > errors[2].mean()
        assert (errors[0] < np.abs(levels)).all()  # nearer than the straight line

    def test_as_long_as_any_changes_nothing(self, modulator, scene):
        plain = modulator.plan(scene, 0, LEVELS)
        path = modulator.plan(scene, 0, LEVELS, max_detour=5)
        np.testing.assert_array_equal(path.waypoints, plain.waypoints)

    @pytest.mark.parametrize("wrong", [0.99, 0, -1, np.nan, np.inf, "short", [1.2]], ids=str)
    def test_refuses(self, flat, wrong):
        for plan in (
            functools.partial(flat.plan, SCENES[2]), functools.partial(flat.plan_many, [SCENES[2]])
        ):  # fmt: skip
            with pytest.raises(InvalidInputError, match="max_detour must be"):
                plan(max_detour=wrong)

    def test_paths_are_refined(self, flat):
        with pytest.raises(InvalidInputError, match="leave refine as it is"):
            flat.plan(SCENES[2], max_detour=1.2, refine=False)


class TestArm:
    """The whole arm keeps off."""

    @pytest.fixture
    def solid(self):
        for extra in ("mujoco", "mink"):
            pytest.importorskip(extra, reason="plans of an arm are NOT TESTED")
        return make(3)

    @staticmethod
    def gaps(path):
        """Least gap [m] between the Panda and the obstacles on the path of each level."""
        obstacles = path.scene.obstacles
        return np.array([
            PANDA.obstacle_gaps(obstacles, PANDA.postures(checked_points(curve))).min()
            for curve in path.trajectory()
        ])  # fmt: skip

    def test_of_every_level(self, solid):
        levels = [-0.8, 0.0, 0.5]
        path = solid.plan(BESIDE, 0, levels, arm="panda")
        assert (self.gaps(path) > 0).all()
        np.testing.assert_array_equal(path.legibility, levels)
        assert path.feasible.all()
        assert path.waypoints.shape == (3, 10, 3)
        assert (self.gaps(solid.plan(BESIDE, 0, levels)) < 0).any()

    def test_a_number_is_a_level(self, solid):
        path = solid.plan(BESIDE, 0, 0.0, arm=PANDA)
        assert path.waypoints.shape == (10, 3)
        assert path.legibility == 0
        assert path.replaced.shape == ()
        batch = solid.plan(BESIDE, 0, [0.0], arm="panda")
        np.testing.assert_array_equal(batch.waypoints[0], path.waypoints)

    def test_without_obstacles_it_changes_nothing(self, solid):
        plain = solid.plan(SCENES[3], 0, LEVELS)
        path = solid.plan(SCENES[3], 0, LEVELS, arm="panda")
        np.testing.assert_array_equal(path.waypoints, plain.waypoints)

    def test_max_detour_is_kept(self, solid):
        path = solid.plan(BESIDE, 0, [-0.8, 0.0, 0.5], arm="panda", max_detour=1.3)
        assert (self.gaps(path) > 0).all()
        assert (path.length <= 1.3 * archive.shortest_curve(BESIDE, 0)[1] * (1 + 1e-6)).all()

    def test_what_it_touches_at_the_target_is_named(self, solid):
        with pytest.raises(InvalidSceneError, match=r"at the target .* touches obstacles\[0\]"):
            solid.plan(OVER, 0, 0.0, arm="panda")

    @pytest.mark.parametrize(
        ("arm", "match"),
        [
            ("ur5e", "arm must be one of panda, .* got 'ur5e'"),
            (7, r"arm must be a legibility\.Arm or a name, got 7"),
            (PANDA, "an arm moves in 3-D, the scene is 2-D"),
        ],
        ids=str,
    )
    def test_refuses(self, flat, arm, match):
        with pytest.raises(InvalidInputError, match=match):
            flat.plan(SCENES[2], arm=arm)


class TestPretrained:
    @pytest.fixture
    def folder(self, flat, tmp_path):
        flat.save_pretrained(tmp_path / "weights")
        return tmp_path / "weights"

    def test_round_trip_plans_the_same(self, modulator, scene, tmp_path):
        modulator.save_pretrained(tmp_path / "a" / "mine")
        again = Modulator.from_pretrained(tmp_path / "a" / "mine")
        assert again.config == modulator.config
        assert again.name == "mine"
        for options in ({}, {"guidance": 1.0, "steps": 3}):
            np.testing.assert_array_equal(
                again.plan(scene, 1, LEVELS, **options).waypoints,
                modulator.plan(scene, 1, LEVELS, **options).waypoints,
            )

    def test_text_is_a_folder_too(self, folder, monkeypatch):
        monkeypatch.chdir(folder.parent)
        assert Modulator.from_pretrained("weights").name == "weights"
        monkeypatch.chdir(folder)
        assert Modulator.from_pretrained(".").name == "weights"
        monkeypatch.setenv("HOME", str(folder.parent))
        monkeypatch.setenv("USERPROFILE", str(folder.parent))
        Modulator.from_pretrained("~/weights").save_pretrained("~/others")
        assert (folder.parent / "others" / "config.json").exists()

    @pytest.mark.parametrize("name", pretrained_names())
    def test_a_student_draws_as_it_learned_to(self, name):
        model = Modulator.from_pretrained(name)
        assert model.config.distilled
        scene = lg.Scene.random(np.random.default_rng(0), dim=model.config.dim)
        path = model.plan(scene, 0, [-1, 1], guidance=0.0, steps=1)
        np.testing.assert_array_equal(path.waypoints, model.plan(scene, 0, [-1, 1]).waypoints)
        with pytest.raises(InvalidInputError, match="a distilled model samples with guidance 0 in"):
            model.plan(scene, 0, steps=3)
        with pytest.raises(InvalidInputError, match=r"got guidance 0\.3 and steps None"):
            model.plan_many([scene], [0], 1.0, guidance=0.3)

    @pytest.mark.parametrize("name", ["no-such-model", "", "..", "../weights", "a\0b"])
    def test_no_such_weights(self, tmp_path, monkeypatch, name):
        monkeypatch.chdir(tmp_path)
        with pytest.raises(CheckpointError):
            Modulator.from_pretrained(name)

    def test_names(self):
        for name in pretrained_names():
            assert Modulator.from_pretrained(name).name == name


@given(
    seed=st.integers(0, 2**32 - 1),
    scale=st.sampled_from([0.0, 1.0, 30.0, 1e4, 1e12, 1e30]),
    dim=st.sampled_from([2, 3]),
    level=st.floats(-1, 1),
)
@settings(max_examples=30)
def test_whatever_the_weights_paths_are_finite_and_inside(seed, scale, dim, level):
    model = make(dim)
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        for name, parameter in model.path_diffuser.named_parameters():
            parameter.add_(scale * torch.randn(parameter.shape, generator=generator))
            assert torch.isfinite(parameter).all(), name
    scene = lg.Scene.random(np.random.default_rng(seed), dim=dim)
    try:
        path = model.plan(scene, 0, level, seed=seed)
    except CheckpointError:
        assert scale > 1  # its numbers overflow
        return
    assert np.isfinite(path.waypoints).all()
    assert scene.contains(path.trajectory(100)).all()
    np.testing.assert_array_equal(path.waypoints[[0, -1]], [scene.start, scene.goals[0]])
    assert np.isfinite(path.score)
    assert path_curve(path.waypoints, 10).shape == (10, dim)


def both(dim=2, **changes):
    """A tiny untrained modulator with both stages."""
    torch.manual_seed(1)
    policy = PathPolicy(
        PathPolicyConfig(**{"dim": dim, "channels": (8, 16), "condition": 16} | changes)
    )
    policy.signal.copy_(noise_schedule(100))
    return Modulator(make(dim).path_diffuser, halved(policy), name="tiny")


class TestPlanMany:
    def test_is_one_path_in_each_scene(self, modulator):
        dim = modulator.config.dim
        scenes = [lg.Scene.random(np.random.default_rng(seed), dim=dim) for seed in range(5)]
        targets, levels = [0, 1, 0, 1, 1], np.linspace(-1, 1, 5)
        paths = modulator.plan_many(scenes, targets, levels, seed=3)
        again = modulator.plan_many(scenes, targets, levels, seed=3)
        for path, same, scene, target, level in zip(
            paths, again, scenes, targets, levels, strict=True
        ):
            assert path.scene is scene
            assert path.target == target
            assert path.legibility == level
            ends = [scene.start, scene.goals[target]]
            np.testing.assert_array_equal(path.waypoints[[0, -1]], ends)
            assert scene.contains(path.trajectory()).all()
            np.testing.assert_array_equal(path.waypoints, same.waypoints)

    @pytest.mark.parametrize(
        "targets", [1, np.array(1), torch.tensor(1), [1, 1], np.ones(2, int), torch.tensor([1, 1])]
    )
    def test_one_target_for_all(self, flat, targets):
        paths = flat.plan_many([SCENES[2]] * 2, targets, 0.3)
        assert [path.target for path in paths] == [1, 1]

    def test_of_one_scene_is_its_plan(self, modulator, scene):
        (many,) = modulator.plan_many([scene], [0], 0.3, seed=2)
        np.testing.assert_allclose(
            many.waypoints, modulator.plan(scene, 0, 0.3, seed=2).waypoints, atol=1e-5
        )

    @pytest.mark.parametrize(
        ("wrong", "match"),
        [
            ({"scenes": []}, "scenes must be a list of at least one"),
            ({"scenes": None}, "scenes must be a list of at least one, got None"),
            ({"observer": "paper"}, "observer must be a legibility.Observer, got 'paper'"),
            ({"targets": [0]}, "targets must be one for all or 2, got 1"),
            ({"targets": None}, "target must be an integer"),
            ({"targets": True}, "target must be an integer"),
            ({"targets": [0, 9]}, "target must be a goal"),
            ({"legibility": [0, 0, 0]}, "one number or 2"),
            ({"legibility": 2}, "must lie in"),
            ({"scenes": [SCENES[2], SCENES[3]]}, "plans in 2D"),
        ],
        ids=str,
    )
    def test_refuses(self, flat, wrong, match):
        with pytest.raises(InvalidInputError, match=match):
            flat.plan_many(
                **{"scenes": [SCENES[2]] * 2, "targets": [0, 0], "legibility": 0.0, **wrong}
            )


class TestExecute:
    def vector(self, size=3, **options):
        env = BlockReach2DVector(size)
        env.reset(seed=0, options={"scene": SCENES[2], **options})
        return env

    def test_one_and_many(self):
        model = both()
        env = gymnasium.make("legibility/BlockReach2D-v0")
        env.reset(seed=0, options={"scene": SCENES[2], "target": 1})
        rollout = model.execute(env, legibility=0.4, seed=1)
        assert isinstance(rollout, lg.Rollout)
        assert rollout.path.target == 1
        assert rollout.legibility == 0.4
        rollouts = model.execute_many(self.vector(), legibility=[-1, 0, 1], seed=1)
        assert [r.legibility for r in rollouts] == [-1, 0, 1]
        again = model.execute_many(self.vector(), legibility=[-1, 0, 1], seed=1)
        for one, other in zip(rollouts, again, strict=True):
            np.testing.assert_array_equal(one.states, other.states)

    def test_targets(self):
        model = both()
        rollouts = model.execute_many(self.vector(), [0, 1, 1], driver=Feedback())
        assert [r.path.target for r in rollouts] == [0, 1, 1]
        assert all(r.success for r in rollouts)
        rollouts = model.execute_many(self.vector(), 1, driver=Feedback())
        assert [r.path.target for r in rollouts] == [1, 1, 1]

    def test_given_paths_are_followed(self):
        model = both()
        path = model.plan(SCENES[2], 0, [0.1, 0.2, 0.3])
        rollouts = model.execute_many(
            self.vector(), paths=[path[i] for i in range(3)], driver=Feedback(), replan=False
        )
        for i, rollout in enumerate(rollouts):
            np.testing.assert_array_equal(rollout.path.waypoints, path.waypoints[i])

    def test_replans_with_the_same_level(self, monkeypatch):
        model, asked = both(), []
        many = model.plan_many

        def plan_many(scenes, targets, levels, **options):
            asked.append(levels)
            return many(scenes, targets, levels, **options)

        monkeypatch.setattr(model, "plan_many", plan_many)
        rollouts = model.execute_many(
            self.vector(push=0.2), legibility=[0.1, 0.2, 0.3], driver=Feedback()
        )
        assert sum(len(r.replans) for r in rollouts) >= 1
        assert {float(x) for levels in asked[1:] for x in levels} <= {0.1, 0.2, 0.3}

    @pytest.mark.parametrize(
        ("wrong", "match"),
        [
            ({"legibility": [0, 1]}, "one number or 3"),
            ({"legibility": 1.5}, "must lie in"),
            ({"targets": [0, 1]}, "one for all or 3"),
            ({"targets": 7}, "target must be a goal"),
            ({"tolerance": 0}, "tolerance"),
            ({"seed": -1}, "seed"),
            ({"targets": 0.7}, "target must be an integer"),
            ({"targets": True}, "target must be an integer"),
            ({"targets": "a"}, "target must be an integer"),
            ({"targets": [0, None, 1]}, "target must be an integer"),
            ({"targets": [1, 1, 7]}, "target must be a goal"),
            ({"paths": []}, "for each of 3"),
            ({"paths": 1}, "for each of 3"),
            ({"paths": [1, 2, 3]}, "for each of 3"),
            ({"paths": [1, 2, 3], "targets": 1}, "for each of 3"),
        ],
        ids=str,
    )
    def test_refuses(self, wrong, match):
        env = self.vector()
        with pytest.raises(InvalidInputError, match=match):
            both().execute_many(env, **wrong)
        assert not env.targets.any()

    def test_one_robot(self):
        """The wrong type of argument for one robot is named as one."""
        env = gymnasium.make("legibility/BlockReach2D-v0")
        env.reset(seed=0, options={"scene": SCENES[2]})
        model = both()
        for wrong in ({"target": [0]}, {"legibility": [0.1, 0.2]}, {"path": 3}, {"seed": -1}):
            with pytest.raises(InvalidInputError, match=next(iter(wrong))):
                model.execute(env, **wrong)
        with pytest.raises(InvalidInputError, match="use execute_many"):
            model.execute(self.vector())
        path = model.plan(SCENES[2], 1, 0.3)
        with pytest.raises(InvalidInputError, match="a path must end at the intended goal"):
            model.execute(env, 0, path=path, driver=Feedback())
        rollout = model.execute(env, path=path, driver=Feedback())
        assert rollout.path is path
        assert env.unwrapped.batch.targets.tolist() == [1]

    def test_a_wrapper_that_rescales_actions_is_named(self):
        """Instead of a robot that crawls."""
        env = gymnasium.make("legibility/BlockReach2D-v0")
        env = gymnasium.wrappers.RescaleAction(env, -1.0, 1.0)
        with pytest.raises(InvalidInputError, match="RescaleAction"):
            both().execute(env, 0)

    def test_execute_many_moves_one_as_well(self):
        env = gymnasium.make("legibility/BlockReach2D-v0")
        rollouts = []
        for execute in (both().execute, lambda *a, **k: both().execute_many(*a, **k)[0]):
            env.reset(seed=0, options={"scene": SCENES[2]})
            rollouts.append(execute(env, 1, 0.4, seed=3))
        np.testing.assert_array_equal(rollouts[0].states, rollouts[1].states)

    @pytest.mark.parametrize("env", [None, 5])
    def test_other_environments(self, env):
        with pytest.raises(InvalidInputError, match="environment of legibility"):
            both().execute(env)
        with pytest.raises(InvalidInputError, match="environment of legibility"):
            both().execute_many(env)

    @pytest.mark.parametrize("change", [lambda w: w[:5], lambda w: w * np.nan,
                                        lambda w: np.pad(w, ((0, 0), (0, 1)))])  # fmt: skip
    def test_broken_paths(self, change):
        env, path = self.vector(1), make().plan(SCENES[2], 0, 0.0)
        broken = dataclasses.replace(path, waypoints=change(path.waypoints))
        with pytest.raises(InvalidInputError, match="path must"):
            both().execute_many(env, paths=[broken])

    @pytest.mark.parametrize("push", [0.5, 10.0])
    def test_pushed_far_it_arrives_on_a_new_path(self, push):
        corners = [[-0.1, -0.1], [1.1, 1.1], [-0.1, 1.1], [1.1, -0.1]]
        scene = lg.Scene([0.5, 0.4], corners)
        env = BlockReach2DVector(32)
        env.reset(seed=0, options={"scene": scene, "push": push})
        model = Modulator.from_pretrained("block-reach-2d")
        rollouts = model.execute_many(env, legibility=0.5, driver=Feedback())
        assert {r.reason for r in rollouts} == {"reached"}
        assert sum(len(r.replans) for r in rollouts) >= 20

    def test_a_robot_that_wanders_is_stopped_however_often_it_replans(self):
        class Drunk(Feedback):
            rng = np.random.default_rng(0)

            def __call__(self, robots):
                return self.rng.normal(0, 0.05, (len(robots.rows), 1, 2))

        rollouts = both().execute_many(self.vector(8), driver=Drunk())
        assert {r.reason for r in rollouts} <= {"stalled", "reached"}
        assert sum(len(r.replans) for r in rollouts) > 8

    def test_what_does_not_fit(self):
        with pytest.raises(CheckpointError, match="no stage 2"):
            make().execute_many(self.vector())
        with pytest.raises(InvalidInputError, match="moves in 3D"):
            both(3).execute_many(self.vector())
        with pytest.raises(InvalidInputError, match=r"limit is 0\.05 m"):
            both(limit=0.02).execute_many(self.vector())
        with pytest.raises(InvalidInputError, match="one dimension"):
            Modulator(make(3).path_diffuser, both(2).path_policy)
        path = make().plan(lg.Scene([0.3, 0.3], SCENES[2].goals), 0, [0.0] * 3)
        with pytest.raises(InvalidInputError, match="must start at the robot"):
            both().execute_many(self.vector(), paths=[path[i] for i in range(3)])


class TestBothStages:
    @pytest.fixture
    def folder(self, tmp_path):
        model = both()
        model.training = {"path": RECORD, "policy": dataclasses.replace(RECORD, seconds=3.0)}
        model.save_pretrained(tmp_path / "both")
        return tmp_path / "both"

    def test_round_trip(self, folder):
        again = Modulator.from_pretrained(folder)
        assert again.training == {
            "path": RECORD, "policy": dataclasses.replace(RECORD, seconds=3.0)
        }  # fmt: skip
        assert again.path_policy is not None
        for a, b in zip(
            again.path_policy.state_dict().values(), both().path_policy.state_dict().values(),
            strict=True,
        ):  # fmt: skip
            assert torch.equal(a, b)

    def test_stage_1_alone_is_enough_and_stage_2_is_not(self, folder):
        content = json.loads((folder / "config.json").read_text())
        policy = {k: v for k, v in content.items() if k != "path"}
        (folder / "config.json").write_text(json.dumps(policy))
        with pytest.raises(CheckpointError, match="no stage 1"):
            Modulator.from_pretrained(folder)
        del content["policy"]
        (folder / "config.json").write_text(json.dumps(content))
        assert Modulator.from_pretrained(folder).path_policy is None
