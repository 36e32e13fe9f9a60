"""Environments of the user's own: moved as ours are, as safely, and their faults named."""

import gymnasium
import numpy as np
import pytest
from gymnasium import wrappers
from hypothesis import given, settings
from hypothesis import strategies as st

import legibility as lg
from legibility.drivers import Feedback
from legibility.envs import check
from legibility.envs.fleet import Fleet, fleet_of
from legibility.envs.own import OwnFleet
from legibility.errors import InvalidInputError
from legibility.motion.path import Path, straight_waypoints
from legibility.rollout import follow

ROOM = [[0, 0], [4, 3]]
GOALS = np.array([[3.5, 1.5], [3.0, 2.5]])
START = np.array([0.5, 1.0])


def with_goals(goals, obstacles=()):
    return lg.Scene(START, goals, ROOM, obstacles, goal_radius=0.1, clearance=0.05)


class Point:
    """A robot in a room of its own; no environment of Gymnasium. `change` is called each step."""

    max_displacement, dt, target = 0.1, 0.1, 0
    scene = None

    def __init__(self, gain=0.8, drift=0.2, obstacles=(), change=None, noise=0.0):
        self.gain, self.drift, self.obstacles, self.change = gain, drift, obstacles, change
        self.noise = noise

    def reset(self, *, seed=None, options=None):
        self.rng, self.steps = np.random.default_rng(seed), 0
        self.position, self.velocity, self.success = START.copy(), np.zeros(2), False
        self.scene = with_goals(GOALS, self.obstacles)
        return None, {}

    def step(self, action):
        assert np.isfinite(action).all()
        assert (np.abs(action) <= self.max_displacement).all()
        self.velocity = (1 - self.drift) * self.gain * action + self.drift * self.velocity
        self.position += self.velocity + self.noise * self.rng.standard_normal(2)
        self.steps += 1
        if self.change is not None:
            self.change(self)
        self.success = bool(np.linalg.norm(self.position - self.scene.goals[self.target]) < 0.05)
        return None, 0.0, self.success, False, {}


class Clipped(Point):
    """Makes a tenth of its largest displacement at most."""

    def step(self, action):
        return super().step(
            np.clip(action, -0.05 * self.max_displacement, 0.05 * self.max_displacement)
        )


class HalfClipped(Point):
    """Makes three fifths of its largest displacement at most."""

    def step(self, action):
        most = 0.6 * self.max_displacement
        return super().step(np.clip(action, -most, most))


class Jumping(Point):
    """Tells where it is in another frame at a reset."""

    def reset(self, **options):
        found = super().reset(**options)
        self.position[0] -= 0.5
        return found

    def step(self, action):
        self.position[0] += 0.5 * (self.steps == 0)
        return super().step(action)


class Soon(Point):
    """Has reached its target wherever it is."""

    def step(self, action):
        found = super().step(action)
        self.success = True
        return found


class Over(Point):
    """Ends at once."""

    def step(self, action):
        return *super().step(action)[:3], True, {}


def moved(env, driver=None, replan=None, seed=0):
    """The motion along a straight line to the target."""
    fleet = fleet_of(env, seed)
    (scene,), (target,), (position,) = fleet.scenes, fleet.targets, fleet.positions
    line = straight_waypoints(position, scene.goals[target])
    path = Path.through(line, scene, int(target), np.array(0.0), lg.Observer())
    (rollout,) = follow(fleet, [path], driver or Feedback(), replan, tolerance=fleet.limit)
    return rollout


def straight(row, rest):
    line = straight_waypoints(rest.begun.states[-1], rest.now.goals[rest.path.target])
    return rest.follow(line)


def refused(env, call=check):
    with pytest.raises(InvalidInputError) as caught:
        call(env)
    return str(caught.value)


class Bare:
    """An environment of ours, of which only what `Environment` names is seen."""

    def __init__(self, env):
        for name in ("max_displacement", "dt", "lag", "reset", "step", "set_target"):
            setattr(self, name, getattr(env.unwrapped, name))
        self._env = env.unwrapped

    scene = property(lambda self: self._env.scene)
    target = property(lambda self: self._env.target)
    position = property(lambda self: self._env.position)
    success = property(lambda self: self._env.success)


class TestAsOurs:
    @pytest.mark.parametrize("options", [{"push": 0.15}, {"shift": 0.15, "target": 1}], ids=str)
    def test_executed_alike(self, options):
        modulator = lg.Modulator.from_pretrained("block-reach-2d")
        scene = lg.Scene(
            [0, 0.5], [[0.8, 0.6], [1, 0.3]], obstacles=[lg.Ball([0.4, 0.42], 0.1)],
            goal_radius=0.05,
        )  # fmt: skip
        found = []
        for see in (lambda env: env, Bare):
            env = see(gymnasium.make("legibility/BlockReach2D-v0").unwrapped)
            env.reset(seed=3, options={"scene": scene, **options})
            found.append(modulator.execute(env, legibility=0.8, seed=1))
        ours, own = found
        assert ours.replans
        for name in ("states", "actions", "deviation", "posterior"):
            np.testing.assert_array_equal(getattr(own, name), getattr(ours, name))
        for name in ("reason", "replans", "achieved", "contacts", "corrections", "step_seconds"):
            assert getattr(own, name) == getattr(ours, name)

    def test_ours_have_all_that_is_needed(self):
        env = gymnasium.make("legibility/BlockReach2D-v0")
        check(env, seed=4)
        assert type(fleet_of(env, 0)) is Fleet
        env.unwrapped.set_target(1)
        assert env.unwrapped.target == 1

    def test_an_arm_has_it(self):
        for extra in ("mujoco", "mink"):
            pytest.importorskip(extra, reason="the extra named panda is not installed")
        env = gymnasium.make("legibility/PandaBlockReach-v0")
        check(env)
        fleet = OwnFleet(env, 0)
        assert fleet.arms == [env.unwrapped.arm]
        assert fleet.joint_angles.shape == (1, 7)
        env.close()


class TestMoved:
    @settings(max_examples=12)
    @given(
        gain=st.floats(0.3, 1), drift=st.floats(0, 0.3), x=st.floats(1, 3), y=st.floats(0.4, 2.6),
        command=st.sampled_from(["nan", "huge", "away", "random", "onward"]),
    )  # fmt: skip
    def test_nothing_is_touched_whatever_is_commanded(self, gain, drift, x, y, command):
        class Wild(Feedback):
            rng = np.random.default_rng(0)

            def __call__(self, robots):
                ahead = super().__call__(robots)
                return {
                    "nan": ahead * np.nan, "huge": ahead * 1e9, "away": -ahead, "onward": 5 * ahead,
                    "random": ahead + self.rng.normal(0, 0.3, ahead.shape),
                }[command]  # fmt: skip

        solid = lg.Ball([x, y], 0.25)
        rollout = moved(Point(gain, drift, [solid]), Wild())
        assert rollout.reason in ("reached", "stalled", "lost")
        assert solid.signed_distance(rollout.states).min() >= -1e-9
        assert rollout.path.scene.contains(rollout.states).all()
        assert rollout.contacts == rollout.wall_contacts == 0

    def test_the_rollout_is_a_whole_one(self):
        rollout = moved(Point())
        assert rollout.success
        assert rollout.step_seconds == 0.1
        assert len(rollout.states) == len(rollout.actions) + 1
        assert rollout.states[0] == pytest.approx(START)
        assert rollout.posterior.shape == (len(rollout.states), 2)
        assert -0.1 < rollout.achieved < 0.1
        assert rollout.counts == {}

    @pytest.mark.parametrize("what", ["goals", "obstacles"])
    def test_replanned_where_the_scene_has_changed(self, what):
        def change(env):
            if env.steps == 10:
                goals = GOALS + np.array([[0, 0.4], [0, 0]]) if what == "goals" else GOALS
                solids = [lg.Ball([3, 0.5], 0.2)] if what == "obstacles" else []
                env.scene = with_goals(goals, solids)

        rollout = moved(Point(change=change), replan=straight)
        assert rollout.replans == (10,)
        assert rollout.success

    def test_not_replanned_for_noise(self):
        def jitter(env):
            env.scene = with_goals(GOALS + env.rng.normal(0, 0.002, GOALS.shape))

        rollout = moved(Point(change=jitter), replan=straight)
        assert rollout.replans == ()
        assert rollout.success

    def test_an_obstacle_that_comes_is_kept_off(self):
        """It crosses the line before the robot, by less than the clearance in a step."""
        gaps = []

        def cross(env):
            ball = lg.Ball([2, min(0.1 + 0.035 * env.steps, 2.7)], 0.25)
            env.scene = with_goals(GOALS, [ball])
            gaps.append(float(ball.signed_distance(env.position)))

        rollout = moved(Point(change=cross))
        assert rollout.corrections > 0
        assert min(gaps) > 0

    def test_without_a_way_it_stops(self):
        def wall_in(env):
            if env.steps == 5:
                walls = [lg.Box([2, 1.5], [0.2, 3.0])]
                env.scene = with_goals(GOALS, walls)

        def no_way(row, rest):
            raise lg.errors.InvalidSceneError("no curve")

        rollout = moved(Point(change=wall_in), replan=no_way)
        assert rollout.reason == "stalled"
        assert rollout.replans == ()
        assert rollout.states[-1, 0] < 1.9

    def test_why_it_ends(self):
        class Ends(Point):
            def step(self, action):
                seen, reward, *_ = super().step(action)
                return seen, reward, *self.ends, {}

        env = Ends()
        for env.ends, reason in (((False, True), "time"), ((True, False), "ended")):
            env.reset()
            rollout = moved(env)
            assert (rollout.reason, len(rollout.actions)) == (reason, 1)
            assert not rollout.success

    def test_reset_where_it_never_was_and_not_again(self):
        env = Point()
        assert moved(env).success
        assert "an episode has ended" in refused(env, moved)
        env.reset()
        env.step(np.array([0.1, 0.0]))
        assert moved(env).states[0, 0] > START[0]

    def test_another_target(self):
        env = Point()
        fleet = OwnFleet(env, 0)
        fleet.set_targets([0])
        with pytest.raises(InvalidInputError, match="no set_target"):
            fleet.set_targets([1])
        with pytest.raises(InvalidInputError, match="target must be a goal's index"):
            fleet.set_targets([2])
        env.set_target = lambda index: None
        with pytest.raises(InvalidInputError, match=r"set_target\(1\) left env with the target 0"):
            fleet.set_targets([1])
        env.set_target = lambda index: setattr(env, "target", index)
        fleet.set_targets([1])
        assert fleet.targets.tolist() == [1]
        np.testing.assert_array_equal(fleet.goals, GOALS[[1]])

    def test_wrappers_may_surround_it(self):
        class Inner(Point, gymnasium.Env):
            observation_space = action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,))

        env = wrappers.RecordEpisodeStatistics(wrappers.TimeLimit(Inner(), 7))
        rollout = moved(env)
        assert (rollout.reason, len(rollout.actions)) == ("time", 7)
        outside = wrappers.RescaleAction(Inner(), np.float32(-0.1), np.float32(0.1))
        assert "RescaleAction changes or repeats actions" in refused(outside, moved)
        assert "RepeatAction" in refused(wrappers.RepeatAction(Inner(), 2))


def gone(name):
    class Lacking(Point):
        def __getattribute__(self, attribute):
            if attribute == name:
                raise AttributeError(attribute)
            return super().__getattribute__(attribute)

    return Lacking


def with_(name, value):
    """An environment with another value after a reset."""

    class Other(Point):
        def reset(self, **options):
            result = super().reset(**options)
            setattr(self, name, value)
            return result

    setattr(Other, name, value)
    return Other


class Swapped(Point):
    def step(self, action):
        return super().step(action[::-1])


class Turned(Point):
    def step(self, action):
        return super().step(np.array([[0.8, -0.6], [0.6, 0.8]]) @ action)


class Random(Point):
    def reset(self, *, seed=None, options=None):
        return super().reset()

    position = property(lambda self: self._position)

    @position.setter
    def position(self, value):
        self._position = value + np.random.default_rng().uniform(0, 0.1, 2)


class OldReset(Point):
    def reset(self, **options):
        return super().reset(**options)[0]


class OldStep(Point):
    def step(self, action):
        return super().step(action)[1:]


class Fails(Point):
    @property
    def success(self):
        raise KeyError("arrived")

    @success.setter
    def success(self, value): ...


NEEDED = ("max_displacement", "dt", "reset", "step", "scene", "target", "position", "success")
FAULTS = [
    *((gone(name), f"{name} is missing: ") for name in NEEDED),
    (with_("max_displacement", -0.1), "max_displacement must be a number above 0, got -0.1"),
    (with_("dt", "fast"), "dt must be an array of numbers, got 'fast'"),
    (with_("lag", 0.7), "lag must be a number from 0 to 0.5, got 0.7"),
    (with_("arm", "panda"), "arm must be a legibility.Arm, got 'panda'"),
    (with_("scene", {"goals": GOALS}), "scene must be a legibility.Scene, got dict"),
    (with_("target", 2), "target must be a goal's index from 0 to 1, got 2"),
    (with_("position", [1.0, 2.0, 3.0]), "position must have 2 numbers a point, got shape (3,)"),
    (with_("position", [np.nan, 1.0]), "position must be finite, got nan"),
    (with_("position", [50.0, 100.0]), "position must lie in the scene's workspace"),
    (with_("success", 0.0), "success must be True or False, got 0.0"),
    (with_("success", True), "success must be False after a reset, got True"),
    (Fails, "success raises KeyError('arrived')"),
    (Random, "reset(seed=0) must give one scene and position"),
    (OldReset, "reset must return observation and info, got None"),
    (OldStep, "step must return observation, reward, terminated, truncated and info"),
    (lambda: Point(gain=20), "an action is a displacement in metres, no velocity"),
    (lambda: Point(gain=0.05), "position by 0.00248 m, it must realise a share from 0.1"),
    (Clipped, "max_displacement is the largest that the robot makes"),
    (HalfClipped, "max_displacement: of an action of 0.1 m along axis 0 the robot makes"),
    (Jumping, "position: it jumps by 0.5"),
    (Soon, "success: it is True where the robot is 3"),
    (Over, "the episode ends after the first step"),
    (Swapped, "along axis 0 moves position by 0 m"),
    (Turned, "moves position sideways by 0.023"),
    (lambda: Point(drift=0.45), "set lag to 0.4"),
    (lambda: Point(drift=0.8), "a lag above 0.5 is too much"),
]


class TestCheck:
    @pytest.mark.parametrize(
        ("make", "line"), FAULTS, ids=lambda value: getattr(value, "strip", str)()
    )
    def test_faults_are_named(self, make, line):
        lines = refused(make()).splitlines()
        assert lines[0].endswith("cannot be moved yet:")
        assert any(line in text for text in lines[1:])

    def test_one_line_for_each(self):
        env = Point()
        env.reset()
        env.max_displacement, env.dt, env.lag, env.target = 0, -1, 2, "R"
        lines = refused(env).splitlines()
        for name in ("max_displacement", "dt", "lag", "target"):
            assert sum(text.startswith(name) for text in lines) == 1

    @pytest.mark.parametrize("env", [Point(), Point(drift=0), Point(1.0, 0.3), Point(noise=1e-3)])
    def test_right_ones_pass_and_are_left_as_after_a_reset(self, env):
        check(env, seed=7)
        np.testing.assert_array_equal(env.position, START)
        assert env.steps == 0

    def test_something_in_the_way_is_no_fault(self):
        check(Point(obstacles=[lg.Ball([0.8, 1.0], 0.25), lg.Ball([0.5, 1.3], 0.25)]))

    @pytest.mark.parametrize("env", [None, "2d", 5, object()])
    def test_anything_else(self, env):
        assert refused(env).count(" is missing: ") == 8
        assert "must be an environment of legibility or have" in refused(env, moved)


class TestOnTheWay:
    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (
                lambda env: setattr(env, "position", env.position * np.nan),
                "position must be finite",
            ),
            (lambda env: setattr(env, "target", 1), "target must stay 0 during an episode, got 1"),
            (
                lambda env: setattr(env, "scene", lg.Scene(START, [*GOALS, [2, 2.5]], ROOM)),
                "scene must keep its 2 goals",
            ),
            (
                lambda env: setattr(env, "scene", lg.Scene(START, GOALS, [[0, 0], [9, 9]])),
                "scene must keep its workspace",
            ),
            (lambda env: env.rng.shuffle(None), "env fails in step: TypeError"),
        ],
    )
    def test_what_must_not_change(self, change, message):
        env = Point(change=lambda env: change(env) if env.steps == 3 else None)
        problem = refused(env, moved)
        assert message in problem
        assert "after 3 steps" in problem or "fails in step" in problem

    def test_beyond_a_wall_after_a_push(self):
        def push(env):
            if env.steps == 3:
                env.position = np.array([1.0, -0.05])

        rollout = moved(Point(change=push), replan=straight)
        assert rollout.wall_contacts > 0
        assert rollout.replans == (3,)
        assert rollout.success
