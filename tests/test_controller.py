"""A robot's own loop: smooth, safe, in time, and with the ℓ of the whole motion."""

import copy
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rooms import obstacle, room

import legibility as lg
from legibility.drivers import Feedback
from legibility.errors import CheckpointError, InvalidInputError, InvalidSceneError

SCENE = lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]])
WEIGHTS = {2: "block-reach-2d", 3: "panda-block-reach"}


@pytest.fixture(scope="module")
def models():
    return {dim: lg.Modulator.from_pretrained(name) for dim, name in WEIGHTS.items()}


@pytest.fixture(scope="module")
def flat(models):
    return models[2]


def moved(target, *, obstacles=()):
    return lg.Scene(SCENE.start, [target, SCENE.goals[1]], obstacles=obstacles)


def drive(controller, scene_of=lambda step: None, gain=0.8, steps=400, disturb=None):
    """Steps of a robot that realises a share of each displacement, until it ends."""
    position, actions = np.array(controller.scene.start), []
    for step in range(steps):
        actions.append(controller.step(position, scene_of(step)))
        if controller.done or controller.stalled:
            break
        position = position + gain * actions[-1]
        if disturb is not None:
            position = disturb(step, position)
    return np.array(actions)


def angle(first, second):
    cosine = first @ second / np.linalg.norm(first) / np.linalg.norm(second)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


class TestLoop:
    @pytest.mark.parametrize("dim", [2, 3])
    @pytest.mark.parametrize(("gain", "pace"), [(0.6, 1), (1.0, 1), (0.9, 0.25), (0.8, 2)])
    def test_reaches_the_goal_with_its_level(self, models, dim, gain, pace):
        dt, errors = pace * {2: 0.05, 3: 0.04}[dim], []
        for seed in range(3):
            scene = lg.Scene.random(np.random.default_rng(seed), dim=dim)
            controller = models[dim].controller(scene, 0, 0.5, dt=dt)
            actions = drive(controller, gain=gain)
            assert controller.done
            assert not controller.stalled
            assert np.linalg.norm(controller.states[-1] - scene.goals[0]) <= 0.02
            assert np.abs(actions).max() <= controller.limit
            assert not controller.replans
            whole = models[dim].archive(scene)
            score = whole.observer.score(controller.states, scene, 0)
            errors.append(abs(whole.label_of(score) - 0.5))
            assert controller.achieved == pytest.approx(0.5, abs=0.3)
        assert np.mean(errors) < 0.15

    @given(seed=st.integers(0, 10_000))
    @settings(max_examples=12, deadline=None)
    def test_any_scene_any_push_is_safe(self, seed):
        """For a robot that realises any share, in a scene that changes as it likes."""
        rng = np.random.default_rng(seed)
        scene = first = room(rng, int(rng.integers(0, 3)))
        model = lg.Modulator.from_pretrained(WEIGHTS[2])
        controller = model.controller(scene, 0, float(rng.uniform(-1, 1)), budget=0.001)
        position = np.array(scene.start)
        for _ in range(60):
            if rng.random() < 0.1:
                goals = scene.goals + rng.normal(0, 0.05, scene.goals.shape)
                solids = scene.obstacles[int(rng.integers(0, 2)) :]
                try:
                    changed = lg.Scene(
                        first.start, np.clip(goals, *scene.workspace), scene.workspace, solids,
                        scene.goal_radius, scene.clearance,
                    )  # fmt: skip
                except InvalidSceneError:
                    continue
                if np.linalg.norm(changed.goals[0] - scene.goals[0]) < 10 * controller.limit:
                    scene = changed
            action = controller.step(position, scene)
            assert np.isfinite(action).all()
            assert np.abs(action).max() <= controller.limit
            free = scene.solids(0, inflated=False)
            for share in (0.1, 0.5, 1.0):
                after = position + share * action
                assert scene.contains(after, 1e-9)
                apart, before = (free.distance(x[None])[0] for x in (after, position))
                assert apart >= min(0, before) - 1e-9
            position = position + rng.uniform(0, 1) * action
            if rng.random() < 0.05:
                push = np.clip(position + rng.normal(0, 0.05, 2), *scene.workspace)
                if free.distance(push[None])[0] > 0:
                    position = push

    def test_the_same_again(self, flat):
        """With all the time it needs, on any machine."""

        def motion():
            controller = flat.controller(SCENE, 0, 0.5, budget=None)
            scene_of = lambda step: SCENE if step < 10 else moved([0.85, 0.55])  # noqa: E731
            return drive(controller, scene_of)

        np.testing.assert_array_equal(motion(), motion())

    def test_other_drivers_and_backends(self, flat):
        assert flat.controller(SCENE, driver=Feedback()).limit == 0.05
        for options in ({"driver": Feedback()}, {"exact": True}, {"max_detour": 1.2}):
            controller = flat.controller(SCENE, 0, 1.0, **options)
            drive(controller)
            assert controller.done
        length = np.linalg.norm(np.diff(controller.states, axis=0), axis=-1).sum()
        assert length <= 1.25 * np.linalg.norm(SCENE.goals[0] - SCENE.start)

    def test_rooms_of_any_size(self, flat):
        for size in (0.01, 100):
            scene = lg.Scene(size * SCENE.start, size * SCENE.goals, size * SCENE.workspace)
            controller = flat.controller(scene, 0, 0.0, max_displacement=0.05 * size)
            drive(controller)
            assert controller.done
            assert np.linalg.norm(controller.states[-1] - scene.goals[0]) <= 0.02 * size

    def test_what_is_passed_in_may_change_later(self, flat):
        controller, position = flat.controller(SCENE), SCENE.start.copy()
        for _ in range(5):
            action = controller.step(position)
            position += action
            action[:] = np.nan
        assert len(np.unique(controller.states, axis=0)) == 5
        assert np.isfinite(controller.step(position.tolist())).all()


class TestReplanning:
    @pytest.mark.parametrize("dim", [2, 3])
    def test_nothing_changed_nothing_turns(self, models, dim):
        turns = []
        for seed in range(6):
            scene = lg.Scene.random(np.random.default_rng(seed), dim=dim)
            controller = models[dim].controller(scene, 0, 0.7, budget=None)
            position, before = np.array(scene.start), None
            for step in range(15):
                if step == 12:
                    controller.replan()
                action = controller.step(position)
                if step == 12:
                    turns.append(angle(before, action))
                    assert controller.replans == [12]
                before, position = action, position + 0.8 * action
            assert abs(controller.achieved - 0.7) < 0.15
        assert max(turns) < 15
        assert np.median(turns) < 5

    def test_another_level_on_the_way(self, flat):
        controller = flat.controller(SCENE, 0, 1.0, budget=None)
        position = SCENE.start
        for _ in range(4):
            position = position + 0.8 * controller.step(position)
        assert controller.achieved > 0.9
        controller.replan(legibility=0.4)
        controller.step(position)
        assert controller.achieved == pytest.approx(0.4, abs=0.1)
        assert controller.path.legibility == 0.4
        assert controller.motion().path.legibility == 0.4

    def test_a_slider_turned_in_each_step(self, flat):
        controller = flat.controller(SCENE, 0, 1.0, budget=None)

        def turn(step, position):
            if step < 6:
                controller.replan(1 - step / 10)
            return position

        drive(controller, disturb=turn)
        assert controller.done
        assert controller.achieved < 0.9

    def test_a_push(self, flat):
        errors, replans = [], []
        for seed in range(6):
            scene = lg.Scene.random(np.random.default_rng(seed))
            controller = flat.controller(scene, 0, 0.5, budget=None)
            push = 0.1 * np.array([np.cos(seed), np.sin(seed)])

            def disturb(step, position, push=push, scene=scene):
                return np.clip(position + push * (step == 8), *scene.workspace)

            drive(controller, disturb=disturb)
            assert controller.done
            replans.append(len(controller.replans))
            errors.append(abs(controller.achieved - 0.5))
        assert np.count_nonzero(replans) >= 4  # the others were pushed along
        assert np.median(errors) < 0.1

    def test_the_target_moves_circles_and_jitters(self, flat):
        rng = np.random.default_rng(0)
        ways = {
            "moves": lambda step: SCENE if step < 15 else moved([0.85, 0.7]),
            "drifts": lambda step: moved([0.8 + 0.002 * min(step, 50), 0.6]),
            "jitters": lambda step: moved(SCENE.goals[0] + rng.normal(0, 0.002, 2)),
            "trembles": lambda step: moved([0.8 + 1e-6 * (step % 2), 0.6]),
        }
        for name, scene_of in ways.items():
            controller = flat.controller(SCENE, 0, 0.5, budget=None)
            drive(controller, scene_of)
            assert controller.done, name
            assert np.linalg.norm(controller.states[-1] - controller.scene.goals[0]) <= 0.021
            assert bool(controller.replans) == (name in ("moves", "drifts"))

    def test_an_obstacle_on_the_path(self, flat):
        controller = flat.controller(SCENE, 0, 0.0, budget=None)
        solid = lg.Ball([0.5, 0.56], 0.08)
        drive(controller, lambda step: SCENE if step < 8 else moved([0.8, 0.6], obstacles=[solid]))
        assert controller.done
        assert solid.signed_distance(controller.states).min() >= -1e-9
        assert controller.problem is None

    def test_no_way_and_then_one(self, flat):
        """A hand over the target, which goes away."""
        hand = moved([0.8, 0.6], obstacles=[lg.Ball([0.8, 0.6], 0.06)])
        controller, problems = flat.controller(SCENE, 0, 0.0, budget=None), []

        def scene_of(step):
            problems.append(controller.problem)
            return hand if 5 < step < 30 else SCENE

        drive(controller, scene_of)
        assert "lies over the target" in problems[20]
        assert controller.done
        assert controller.problem is None
        held = hand.obstacles[0].signed_distance(controller.states[:30])
        assert held.min() >= -1e-9


class TestEnds:
    def test_a_held_robot_stalls_whatever_the_scene_does(self, flat):
        """In two seconds, or in ten and less if the scene always moves, so that plans are made."""
        trembling = lambda step: moved([0.8 + 0.01 * (step % 2), 0.6])  # noqa: E731
        for scene_of, most in ((lambda step: None, 45), (trembling, 205)):
            controller = flat.controller(SCENE, budget=0)
            drive(controller, scene_of, gain=0)
            assert controller.stalled
            assert 38 <= len(controller.states) <= most

    def test_a_robot_waits_for_its_plan(self, flat):
        """However long that takes in its parts, an obstacle in the way is passed."""
        solid = lg.Box([0.5, 0.56], [0.05, 0.5])
        controller = flat.controller(SCENE, 0, 0.0, dt=0.02, budget=1e-9)
        scene = moved([0.8, 0.6], obstacles=[solid])
        drive(controller, lambda step: SCENE if step < 8 else scene, steps=2000)
        assert controller.done
        assert max(np.diff(controller.replans, prepend=8)) > 105

    def test_at_the_goal_it_stands_and_goes_back_if_pushed_away(self, flat):
        controller = flat.controller(SCENE, 0, 0.0)
        drive(controller)
        position, number = controller.states[-1], len(controller.states)
        for _ in range(5):
            assert not controller.step(position).any()
        assert len(controller.states) == number
        position = position - 0.2
        assert controller.step(position).any()
        assert not controller.done

    def test_slow_loops_do_not_stall_at_once(self, flat):
        controller = flat.controller(SCENE, dt=5.0, max_displacement=0.05)
        assert not controller.stalled
        controller.step(SCENE.start)
        assert not controller.stalled


class Wild:
    """A driver that commands anything."""

    with_path = True

    def __init__(self, rng):
        self.rng, self.follow = rng, Feedback()

    def __call__(self, robots):
        shape = len(robots.rows), 2, robots.positions.shape[1]
        return [
            np.full(shape, np.nan), np.full(shape, np.inf), np.full(shape, -1e300),
            self.rng.normal(0, 1, shape), self.follow(robots),
        ][self.rng.integers(5)]  # fmt: skip


class Toward:
    """A driver that commands the way to a point."""

    with_path = True

    def __init__(self, point):
        self.point = np.array(point)

    def __call__(self, robots):
        return (self.point - robots.positions)[:, None]


def gap(scene, points):
    """Least distance [m] of `points (T, D)` from all that must not be touched."""
    return scene.solids(0, inflated=False).distance(np.atleast_2d(points)).min()


AROUND = (0.1, 0), (-0.1, 0), (0, 0.1), (0, -0.1)


class TestSafety:
    @given(seed=st.integers(0, 10_000), dim=st.sampled_from([2, 3]))
    @settings(max_examples=14, deadline=None)
    def test_any_driver_scene_push_and_level(self, models, seed, dim):
        rng = np.random.default_rng(seed)
        size = {2: 0.12, 3: 0.06}[dim]
        scene = room(rng, int(rng.integers(3)), dim, size=size)
        controller = models[dim].controller(
            scene, 0, float(rng.uniform(-1, 1)), budget=0, driver=Wild(rng)
        )
        position, gain = np.array(scene.start), rng.uniform(0.6, 1)
        for _ in range(40):
            event = rng.integers(8)
            if event == 0:
                controller.replan(None if rng.random() < 0.5 else float(rng.uniform(-1, 1)))
            elif event == 1:
                push = rng.normal(0, 3 * controller.limit, dim)
                pushed = np.clip(position + push, *scene.workspace)
                if gap(scene, pushed) > 0 and np.linalg.norm(push) < 9 * controller.limit:
                    position = pushed
            elif event == 2:
                goals = scene.goals + rng.normal(0, controller.limit, scene.goals.shape)
                solids = (*scene.obstacles, obstacle(rng, dim, size))[-3:]
                try:
                    changed = lg.Scene(
                        position, np.clip(goals, *scene.workspace), None, solids, scene.goal_radius
                    )
                except InvalidSceneError:
                    continue
                scene = changed if gap(changed, position) > 0 else scene
            action = controller.step(position, scene)
            assert np.isfinite(action).all()
            assert np.abs(action).max() <= controller.limit
            position = position + gain * action
            assert scene.contains(position)
            assert gap(scene, position) >= -1e-9
        assert controller.posterior.sum() == pytest.approx(1)

    @pytest.mark.parametrize(
        ("start", "solids"),
        [
            ([-0.1, -0.1], [lg.Box([-0.1, -0.1], [0.3, 0.3])]),
            ([0.2, 0.5], [lg.Ball([0.2 + x, 0.5 + y], 0.16) for x, y in AROUND]),
        ],
        ids=["in a corner", "in the open"],
    )
    def test_what_comes_to_where_the_motion_began_is_kept_off(self, flat, start, solids):
        """The robot has left, and is sent back."""
        scene = lg.Scene(start, SCENE.goals)
        controller = flat.controller(scene, driver=Toward([0.8, 0.5]), budget=None)
        position = np.array(scene.start)
        for _ in range(10):
            position = position + controller.step(position)
        changed = lg.Scene([0.9, 0.9], SCENE.goals, obstacles=solids)
        assert gap(changed, position) > 0.05
        controller._pilot.driver.point = scene.start
        for _ in range(20):
            position = position + controller.step(position, changed)
            assert gap(changed, position) >= -1e-9

    def test_a_block_that_comes_to_where_the_motion_began_is_kept_off(self, flat):
        scene = lg.Scene(SCENE.start, SCENE.goals, goal_radius=0.05)
        controller = flat.controller(scene, driver=Toward([0.8, 0.6]), budget=None)
        position = np.array(scene.start)
        for _ in range(6):
            position = position + controller.step(position)
        changed = lg.Scene([0.9, 0.9], [SCENE.goals[0], [0.03, 0.5]], goal_radius=0.05)
        assert gap(changed, position) > 0.05
        controller._pilot.driver.point = scene.start
        for _ in range(20):
            position = position + controller.step(position, changed)
            assert gap(changed, position) >= -1e-9

    def test_behind_a_wall_it_waits_until_there_is_a_way(self, flat):
        wall = lg.Box([0.5, 0.5], [0.04, 1.2])
        walled = lg.Scene(SCENE.start, SCENE.goals, obstacles=[wall])
        controller, problems = flat.controller(SCENE, 0, 0.5, budget=None), []

        def scene_of(step):
            problems.append(controller.problem)
            return walled if 3 <= step < 25 else SCENE

        drive(controller, scene_of)
        assert "was found from the start" in problems[24]
        assert gap(walled, controller.states[3:25]) >= -1e-9
        assert controller.done
        assert controller.problem is None


def test_a_step_is_soon_over(flat):
    """With a budget of nothing there is one part of a plan in a step."""
    controller = flat.controller(SCENE, 0, 0.5, budget=0)
    times, position = [], SCENE.start
    for step in range(110):
        started = time.perf_counter()
        action = controller.step(position, SCENE if step < 10 else moved([0.85, 0.7]))
        times.append(time.perf_counter() - started)
        position = position + 0.3 * action  # slow, so that the plan gets ready
    assert len(controller.replans) >= 2
    assert np.median(times[10:]) < 0.05  # a new plan takes longer


def test_belief_and_record(flat, tmp_path):
    controller = flat.controller(SCENE, 0, 1.0, dt=0.1)
    with pytest.raises(InvalidInputError, match="no motion before the second step"):
        controller.motion()
    np.testing.assert_allclose(controller.posterior, 0.5)  # undecided, as Dragan's observer is
    drive(controller)
    assert controller.posterior.sum() == pytest.approx(1)
    assert controller.posterior[0] > 0.8
    motion = controller.motion()
    np.testing.assert_array_equal(motion.positions, controller.states)
    assert motion.times[1] == pytest.approx(0.1)
    motion.save(tmp_path / "loop.csv")
    assert (tmp_path / "loop.csv").stat().st_size > 1000


def state_of(controller):
    kept = ("scene", "states", "problem", "planning", "done", "achieved")
    values = [copy.copy(getattr(controller, name)) for name in kept]
    return [*values, controller.path.waypoints.copy(), list(controller.replans)]


class TestRefuses:
    @pytest.mark.parametrize(
        ("wrong", "match"),
        [
            (([np.nan, 0.5],), "position must be finite"),
            (([0.1, 0.5, 0.2],), "position must have 2 numbers"),
            (("here",), "position"),
            (([1.3, 0.5],), r"position must lie in the workspace .* got \[1.3, 0.5\]"),
            (([0.9, 0.5],), r"position \[0.9, 0.5\] is 0.\d+ m from the last one, at most 0.5"),
            (([0.05, 0.5], "scene"), "scene must be a legibility.Scene, got str"),
            (([0.05, 0.5], np.ones(2)), "scene must be a legibility.Scene, got ndarray"),
            (
                ([0.05, 0.5], lg.Scene([0, 0, 0.1], [[0, 0.1, 0.1], [0.1, 0, 0.2]])),
                "2 goals in 2-D",
            ),
            (([0.05, 0.5], lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.3], [1, 0]])), "keep its 2 goals"),
            (
                ([0.05, 0.5], lg.Scene([0, 0.5], SCENE.goals, [[-1, -1], [2, 2]])),
                "keep its workspace",
            ),
            (([0.05, 0.5], moved([0.1, 0.9])), r"goals\[0\] is 0.\d+ m from where it was"),
        ],
        ids=str,
    )
    def test_a_step(self, flat, wrong, match):
        controller = flat.controller(SCENE)
        controller.step([0.04, 0.5])
        before = state_of(controller)
        with pytest.raises((InvalidInputError, InvalidSceneError), match=match):
            controller.step(*wrong)
        for one, other in zip(before, state_of(controller), strict=True):
            assert np.array_equal(one, other)
        with pytest.raises(InvalidInputError, match="joint_angles are of an arm"):
            controller.step([0.05, 0.5], joint_angles=[0.0] * 7)
        with pytest.raises(InvalidInputError, match="legibility must"):
            controller.replan(1.5)
        with pytest.raises(InvalidInputError, match="legibility must be one number"):
            controller.replan([0, 1])

    @pytest.mark.parametrize(
        ("wrong", "match"),
        [
            ({"dt": 0}, "dt must be"),
            ({"budget": -1}, "budget must be"),
            ({"tolerance": 0}, "tolerance must be"),
            ({"max_displacement": np.inf}, "max_displacement must be"),
            ({"legibility": [0, 1]}, "legibility must be one number"),
            ({"legibility": 2}, "must lie in"),
            ({"target": 5}, "target must be a goal"),
            ({"max_detour": 0.9}, "max_detour must be"),
            ({"driver": "feedback"}, "driver must be a legibility.drivers.Driver, got 'fee"),
            ({"frame": "base"}, "frame must be one of world without an arm, got 'base'"),
            ({"arm": "panda"}, "an arm moves in 3-D, the scene is 2-D"),
            ({"arm": 7}, "arm must be a legibility.Arm"),
        ],
        ids=str,
    )
    def test_a_controller(self, flat, wrong, match):
        with pytest.raises(InvalidInputError, match=match):
            flat.controller(SCENE, **wrong)

    def test_without_stage_2(self, flat):
        alone = lg.Modulator(flat.path_diffuser, name="alone")
        with pytest.raises(CheckpointError, match="alone has no stage 2"):
            alone.controller(SCENE)
        drive(controller := alone.controller(SCENE, driver=Feedback()))
        assert controller.done

    def test_a_driver_without_an_action(self, flat):
        controller = flat.controller(SCENE, driver=lambda robots: [np.empty((0, 2))])
        controller._pilot.driver.with_path = True
        with pytest.raises(InvalidInputError, match="gave no displacement"):
            controller.step(SCENE.start)


class TestArm:
    BESIDE = lg.Ball([-0.1, -0.02, 0.24], 0.04)  # in the hand's way
    FREE = lg.Scene([-0.2, -0.2, 0.25], [[0.0, 0.15, 0.06], [0.0, -0.1, 0.06]])
    SOLID = lg.Scene(FREE.start, FREE.goals, obstacles=[BESIDE])

    @pytest.fixture(autouse=True)
    def arms(self):
        for extra in ("mujoco", "mink"):
            pytest.importorskip(extra, reason="a controller of an arm is NOT TESTED")

    def test_all_links_keep_off(self, models):
        from legibility.robots.arm import PANDA

        for scene_of in (lambda step: self.SOLID, lambda step: (self.FREE, self.SOLID)[step > 4]):
            controller = models[3].controller(scene_of(0), 0, 0.0, arm="panda", budget=None)
            drive(controller, scene_of)
            poses = PANDA.postures(controller.states)
            assert PANDA.obstacle_gaps((self.BESIDE,), poses).min() > 0
            assert controller.done or controller.stalled
            motion = controller.motion()
            assert motion.joint_positions.shape == (len(controller.states), 7)
            np.testing.assert_allclose(motion.joint_positions, poses, atol=1e-3)

    def test_from_the_base(self, models):
        from legibility.robots.arm import PANDA

        world = models[3].controller(self.FREE, 0, 0.5, arm=PANDA, budget=None)
        base = models[3].controller(self.FREE, 0, 0.5, arm=PANDA, budget=None, frame="base")
        position = np.array(self.FREE.start)
        for _ in range(5):
            action = world.step(position)
            other = base.step(PANDA.in_base(position), joint_angles=PANDA.home)
            np.testing.assert_allclose(other @ PANDA.base_to_world.T, action, atol=1e-12)
            position = position + action
        np.testing.assert_array_equal(base.motion().joint_positions[2], PANDA.home)
        with pytest.raises(InvalidInputError, match="joint_angles must have 7 numbers"):
            base.step(PANDA.in_base(position), joint_angles=[0.0] * 6)
