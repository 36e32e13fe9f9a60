"""What `safe_actions` returns can be sent, whatever it was given."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from rooms import room

from legibility.envs.block_reach_2d import BlockReach2DVector
from legibility.envs.guard import Barriers, Planes, safe_actions
from legibility.obstacles import Ball, Box, Polygon
from legibility.scene import DEFAULT_WORKSPACE, Scene

LIMIT, LAG = 0.05, 0.3
WORKSPACE = np.array(DEFAULT_WORKSPACE[2])
LOW, HIGH = WORKSPACE
MIDDLE, REST = np.full(2, 0.5), np.zeros(2)

anything = st.floats(width=64) | st.sampled_from([np.inf, -np.inf, np.nan, 1e308, -1e308, 5e-324])


def safe(actions, positions=MIDDLE, velocities=REST, limit=LIMIT, barriers=None):
    return safe_actions(actions, positions, velocities, WORKSPACE, limit, LAG, barriers)


@given(
    st.integers(0, 2**32 - 1),
    st.lists(arrays(float, (8, 2), elements=anything), min_size=1, max_size=4),
    st.booleans(),
)
def test_a_guarded_robot_never_touches_a_wall(seed, wild, extreme):
    """Whatever its gain and lag, even those at the ends of their ranges, and whatever is asked."""
    rng = np.random.default_rng(seed)
    env = BlockReach2DVector(8)
    gain, lag = rng.uniform(0, 1, 8), rng.uniform(0, LAG, 8)
    if extreme:
        gain, lag = rng.choice([0.5, 1], 8), rng.choice([0, LAG], 8)
    env.reset(seed=seed, options={"gain": gain, "lag": lag})
    way = rng.choice([-1, 0, 1], (8, 2))
    for step in range(80):
        if step % 20 == 0:  # to a wall, then back and forth, then something wild
            way = rng.choice([-1, 1], (8, 2))
        actions = way * rng.choice([0.01, 0.05, 1.0], (8, 1)) * rng.choice([1, 1, 1, -1], (8, 2))
        if step % 7 == 0:
            actions = wild[step % len(wild)]
        sent = safe(actions, env.positions, env.velocities)
        assert np.isfinite(sent).all()
        assert (np.abs(sent) <= LIMIT).all()
        *_, info = env.step(sent)
        assert not info["wall_contact"].any()
        assert ((env.positions >= LOW) & (env.positions <= HIGH)).all()


@given(st.integers(0, 10_000))
@settings(max_examples=50, deadline=None)
def test_after_a_push_actions_are_within_the_limit(seed):
    """However far the robot was pushed in the last step, beside an obstacle at a wall too."""
    rng = np.random.default_rng(seed)
    position, push = rng.uniform(LOW, HIGH), rng.normal(0, 0.3, 2)
    solid = Ball(position + rng.uniform(-0.1, 0.1, 2), 0.02)
    scene = Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]], obstacles=[solid])
    wanted, beside = rng.normal(0, 0.1, (1, 2)), Barriers.of([scene], [0])
    for barriers in (None, beside):
        sent = safe(wanted, position[None], push[None], barriers=barriers)
        assert (np.abs(sent) <= LIMIT).all()


@pytest.mark.parametrize("lag", [0.0, 0.3])
def test_a_wall_can_be_reached(lag):
    env = BlockReach2DVector(1)
    env.reset(seed=0, options={"gain": 0.8, "lag": lag})
    for _ in range(150):
        env.step(safe([[1.0, -1.0]], env.positions, env.velocities))
    assert env.positions[0] == pytest.approx([1.1, -0.1], abs=1e-6)


@given(
    arrays(float, (3, 5, 2), elements=anything),
    arrays(float, (3, 5, 2), elements=st.floats(-0.1, 1.1)),
    arrays(float, (3, 5, 2), elements=st.floats(-0.05, 0.05)),
    st.floats(1e-6, 10),
)
def test_finite_and_within_the_limit(actions, positions, velocities, limit):
    sent = safe(actions, positions, velocities, limit)
    assert sent.shape == actions.shape
    assert np.isfinite(sent).all()
    assert (np.abs(sent) <= limit).all()


@given(
    arrays(float, (4, 2), elements=st.floats(-LIMIT, LIMIT)),
    arrays(float, (4, 2), elements=st.floats(0, 1)),
    arrays(float, (4, 2), elements=st.floats(-LIMIT, LIMIT)),
)
def test_harmless_actions_pass_unchanged(actions, positions, velocities):
    assert safe(actions, positions, velocities).tolist() == actions.tolist()


@given(st.floats(0, 2 * np.pi), st.floats(0.1, 1e300))
def test_long_actions_keep_their_direction(angle, length):
    way = np.array([np.cos(angle), np.sin(angle)])
    sent = safe(length * way)
    assert sent / np.linalg.norm(sent) == pytest.approx(way, abs=1e-9)
    assert np.abs(sent).max() == pytest.approx(LIMIT)


@pytest.mark.parametrize(
    ("action", "sent"),
    [
        ([np.nan, 0.02], [0, 0.02]),
        ([np.inf, 0.02], [LIMIT, 0]),
        ([-np.inf, np.inf], [-LIMIT, LIMIT]),
        ([1e308, -1e308], [LIMIT, -LIMIT]),
        ([1, -2], [LIMIT / 2, -LIMIT]),
    ],
)
def test_what_is_not_a_number(action, sent):
    assert safe(action) == pytest.approx(np.array(sent))


def test_along_a_wall_only_what_leads_out_is_lost():
    assert safe([0.04, 0.03], np.array([0.5, 1.1])).tolist() == [0.04, 0]
    assert safe([0.04, -0.03], np.array([0.5, 1.1])).tolist() == [0.04, -0.03]
    assert safe([0.04, 0.03], np.array([0.5, 1.08])) == pytest.approx(np.array([0.04, 0.02]))


def test_brakes_before_a_wall():
    fast = np.array([0.04, 0])
    sent = safe([0.05, 0], np.array([1.08, 0.5]), fast)
    assert sent == pytest.approx(np.array([0.02 - 0.3 / 0.7 * 0.04, 0]))
    assert safe([0, 0], np.array([1.095, 0.5]), fast)[0] < 0


def test_three_dimensions():
    workspace = np.array(DEFAULT_WORKSPACE[3])
    sent = safe_actions([0, 0, -1], np.array([0, 0, 0.03]), np.zeros(3), workspace, 0.05, 0.3)
    assert sent == pytest.approx(np.array([0, 0, -0.01]))


def free_positions(scenes, rng):
    """A position in each room where a robot touches nothing, as often as not close to something."""
    positions = []
    for scene in scenes:
        places = rng.uniform(*scene.workspace, (400, scene.dim))
        margins = scene.margin_at(places, 0)
        nearest = np.flatnonzero(margins >= 0)[np.argsort(margins[margins >= 0])]
        positions.append(places[nearest[0] if rng.random() < 0.5 else rng.choice(nearest)])
    return np.array(positions)


def rooms(rng, size, dim=2):
    return [
        room(rng, int(rng.integers(0, 5)), dim, rng.choice([0, 0.02]), rng.choice([0, 0.03]))
        for _ in range(size)
    ]


class TestObstacles:
    @settings(max_examples=25, deadline=None)
    @given(st.integers(0, 2**32 - 1), st.sampled_from([2, 3]))
    def test_a_robot_that_is_free_stays_free(self, seed, dim):
        rng = np.random.default_rng(seed)
        scenes = rooms(rng, 8, dim)
        positions = free_positions(scenes, rng)
        velocities = rng.normal(0, 0.02, (8, dim))
        wanted = rng.normal(0, rng.choice([0.01, 0.1]), (8, dim))
        workspace = scenes[0].workspace
        barriers = Barriers.of(scenes, [0] * 8)
        sent = safe_actions(wanted, positions, velocities, workspace, LIMIT, LAG, barriers)
        assert (np.abs(sent) <= LIMIT).all()
        for scene, position, action in zip(scenes, positions, sent, strict=True):
            way = position + np.linspace(0, 1, 50)[:, None] * action
            assert scene.margin_at(way, 0).min() >= -1e-9

    @settings(max_examples=15, deadline=None)
    @given(st.integers(0, 2**32 - 1), st.booleans())
    def test_a_guarded_robot_never_touches_an_obstacle(self, seed, extreme):
        """Whatever its gain and lag, even those at the ends of their ranges."""
        rng = np.random.default_rng(seed)
        gain, lag = rng.uniform(0, 1, 8), rng.uniform(0, LAG, 8)
        if extreme:
            gain, lag = rng.choice([0.5, 1], 8), rng.choice([0, LAG], 8)
        env = BlockReach2DVector(8)
        env.reset(options={"scene": rooms(rng, 8), "gain": gain, "lag": lag})
        for step in range(60):
            if step % 12 == 0:
                way = rng.normal(0, LIMIT, (8, 2))
            actions = way * rng.choice([0.2, 1, 1, -1], (8, 1))
            env.done[:] = False
            *_, info = env.step(safe(actions, env.positions, env.velocities, LIMIT, env.barriers))
            assert not info["contact"].any()
            assert not info["wall_contact"].any()

    @given(st.integers(0, 2**32 - 1))
    def test_in_free_space_nothing_changes(self, seed):
        rng = np.random.default_rng(seed)
        scenes = rooms(rng, 8)
        positions, velocities = rng.uniform(0, 1, (8, 2)), rng.normal(0, 0.02, (8, 2))
        wanted = rng.normal(0, 0.05, (8, 2))
        plain = safe(wanted, positions, velocities)
        sent = safe(wanted, positions, velocities, LIMIT, Barriers.of(scenes, [0] * 8))
        reach = 2 * LIMIT + np.linalg.norm(velocities, axis=-1)
        far = np.array([s.margin_at(x, 0) for s, x in zip(scenes, positions, strict=True)]) > reach
        np.testing.assert_array_equal(sent[far], plain[far])

    @pytest.mark.parametrize(
        "solid",
        [Ball([0.5, 0.5], 0.1), Box([0.5, 0.5], [0.3, 0.2], 0.4),
         Polygon([[0.4, 0.4], [0.6, 0.4], [0.5, 0.65]])],
    )  # fmt: skip
    def test_a_robot_inside_is_led_out(self, solid):
        scene = Scene([0, 0], [[1, 1], [1, 0]], obstacles=[solid])
        barriers = Barriers.of([scene], [0])
        position = np.array([[0.51, 0.48]])
        for _ in range(12):
            position = position + safe([[0.0, 0.0]], position, np.zeros((1, 2)), LIMIT, barriers)
        assert 0 <= scene.margin_at(position[0], 0) < 1e-5

    def test_it_slides_along_a_surface(self):
        scene = Scene([0, 0], [[1, 1], [1, 0]], obstacles=[Box([0.5, 0.5], [0.4, 0.2])])
        sent = safe(
            [[0.03, -0.03]], np.array([[0.5, 0.61]]), np.zeros((1, 2)), LIMIT,
            Barriers.of([scene], [0]),
        )  # fmt: skip
        assert sent == pytest.approx(np.array([[0.03, -0.01]]), abs=1e-5)

    def test_the_clearance_is_kept(self):
        scene = Scene([0, 0.5], [[1, 1], [1, 0]], obstacles=[Ball([0.5, 0.5], 0.1)], clearance=0.05)
        env = BlockReach2DVector(1)
        env.reset(options={"scene": scene})
        for _ in range(40):
            env.step(safe([[0.05, 0.0]], env.positions, env.velocities, LIMIT, env.barriers))
        assert env.positions[0] == pytest.approx([0.35, 0.5], abs=1e-5)

    def test_only_other_goals_are_solid(self):
        scene = Scene([0, 0.5], [[0.5, 0.5], [1, 0.5]], goal_radius=0.05)
        position, action = np.array([[0.44, 0.5]]), [[0.05, 0.0]]
        ends = [
            position + safe(action, position, np.zeros((1, 2)), LIMIT, Barriers.of([scene], [t]))
            for t in (0, 1)
        ]
        assert ends[0] == pytest.approx(np.array([[0.49, 0.5]]))
        assert ends[1] == pytest.approx(np.array([[0.45, 0.5]]), abs=1e-5)

    def test_empty_rooms_need_no_barriers(self):
        assert Barriers.of([Scene([0, 0.5], [[0.5, 0.5], [1, 0.5]])], [0]) is None

    @settings(max_examples=20, deadline=None)
    @given(st.integers(0, 2**32 - 1))
    def test_distances_are_those_of_the_scenes(self, seed):
        rng = np.random.default_rng(seed)
        scenes = rooms(rng, 6)
        barriers, points = Barriers.of(scenes, [0] * 6), rng.uniform(0, 1, (6, 2))
        if barriers is None:
            return
        rows = np.array([4, 1])
        for inflated in (False, True):
            found, slopes = barriers.nearest(points[:, None], inflated=inflated)
            for scene, point, distances in zip(scenes, points, found, strict=True):
                expected = scene.solids(0, inflated=inflated).distance(point[None])[0]
                assert min(distances.min(), 9) == pytest.approx(min(expected, 9), abs=2e-6)
            part = barriers.rows(rows).nearest(points[rows, None], inflated=inflated)
            np.testing.assert_array_equal(part[0], found[rows])
            np.testing.assert_array_equal(part[1], slopes[rows])


class TestTouched:
    SCENE = Scene(
        [0, 0.5], [[1, 1], [1, 0], [0.5, 0.9]], goal_radius=0.05,
        obstacles=[Box([0.5, 0.5], [0.01, 0.4]), Polygon([[0.8, 0.4], [0.9, 0.4], [0.8, 0.6]])],
    )  # fmt: skip

    @pytest.mark.parametrize(
        ("point", "step", "touched"),
        [
            ([0.48, 0.5], [0.01, 0.0], False),
            ([0.48, 0.5], [0.02, 0.0], True),
            ([0.48, 0.5], [0.05, 0.0], True),  # right through it
            ([0.495, 0.4], [0.0, 0.1], False),  # along its surface
            ([0.5, 0.5], [0.0, 0.0], True),
            ([0.78, 0.5], [0.04, 0.0], True),
            ([0.95, 0.0], [0.02, 0.0], True),  # another block
            ([0.95, 1.0], [0.02, 0.0], False),  # the target
        ],
    )
    def test_a_step(self, point, step, touched):
        barriers = Barriers.of([self.SCENE], [0])
        assert barriers.touched(np.array([point]), np.array([step])).tolist() == [touched]

    @settings(max_examples=25, deadline=None)
    @given(st.integers(0, 2**32 - 1))
    def test_as_many_points_find(self, seed):
        rng = np.random.default_rng(seed)
        scenes = [room(rng, 4) for _ in range(8)]
        points, steps = rng.uniform(0, 1, (8, 2)), rng.normal(0, 0.1, (8, 2))
        found = Barriers.of(scenes, [0] * 8).touched(points, steps)
        for scene, point, step, touched in zip(scenes, points, steps, found, strict=True):
            way = point + np.linspace(0, 1, 500)[:, None] * step
            least = scene.solids(0, inflated=False).distance(way).min()
            if abs(least) > 1e-3:
                assert touched == (least < 0)


def test_an_arm_keeps_its_links_off():
    """A plane 1 cm ahead of a link, seen by robot 0 alone, ends its step 3 mm before it."""
    normals, gaps = np.zeros((2, 1, 3)), np.full((2, 1), np.inf)
    normals[0, 0], gaps[0, 0] = [-1, 0, 0], 0.01
    workspace, still = np.array([[-1.0] * 3, [1.0] * 3]), np.zeros((2, 3))
    wanted = np.tile([0.02, 0.01, 0.0], (2, 1))
    sent = safe_actions(wanted, still, still, workspace, 0.02, 0.3, None, Planes(normals, gaps))
    assert sent[0] == pytest.approx([0.007, 0.01, 0], abs=1e-9)
    assert sent[1].tolist() == wanted[1].tolist()
    moving = np.tile([0.007, 0.0, 0.0], (2, 1))  # it would coast 3 mm
    sent = safe_actions(wanted, still, moving, workspace, 0.02, 0.3, None, Planes(normals, gaps))
    assert sent[0] == pytest.approx([0.004, 0.01, 0], abs=1e-9)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_an_arm_between_two_obstacles_enters_neither(seed):
    """Whatever is wanted, also nothing: within the standoff no step may lead out of both."""
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(64, 2, 3))
    normals[:, 1] = -normals[:, 0] + 0.2 * normals[:, 1]
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    gaps = rng.uniform(0, 0.004, (64, 2))
    workspace, still = np.array([[-1.0] * 3, [1.0] * 3]), np.zeros((64, 3))
    wanted = rng.normal(0, 0.02, (64, 3)) * rng.integers(0, 2, (64, 1))
    sent = safe_actions(wanted, still, still, workspace, 0.02, 0.3, None, Planes(normals, gaps))
    assert ((normals * sent[:, None]).sum(-1) + gaps >= -1e-8).all()
