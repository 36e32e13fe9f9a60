"""An observer fixes what ℓ means: the field, the scores and the labels of a scene."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import legibility as lg
from legibility.errors import InvalidInputError
from legibility.intent.metrics import DEFAULT_ALPHA
from legibility.intent.observer import DEFAULT_OBSERVER

SCENE = lg.Scene([0, 0.5], [[0.8, 0.6], [1.0, 0.3]])
seeds = st.integers(0, 2**32 - 1)
dims = st.sampled_from([2, 3])


def random_scene(seed, dim, num_goals=None):
    return lg.Scene.random(np.random.default_rng(seed), dim=dim, num_goals=num_goals)


def random_observer(rng, scene):
    """Of any kind and prior."""
    prior = ["neutral", "uniform", rng.uniform(0.2, 1, scene.num_goals)][rng.integers(3)]
    if rng.random() < 0.4:
        return lg.Observer(prior=prior, beta=rng.choice([None, rng.uniform(5, 40) / scene.size]))
    eyes = {"viewpoint": scene.size * rng.normal(0, 3, scene.dim), "depth": rng.uniform(1, 4)}
    return lg.Observer(
        kind="gaussian",
        prior=prior,
        sigma=rng.choice([None, rng.uniform(0.06, 0.4) * scene.size]),
        **(eyes if rng.random() < 0.7 else {}),
    )


class TestDefault:
    """Dragan's observer."""

    def test_is_the_default(self):
        assert lg.Observer() == DEFAULT_OBSERVER == lg.Observer("boltzmann", "neutral")
        assert lg.Observer().scale == (DEFAULT_ALPHA, 2.5, "anchored")

    @given(seeds, dims, st.floats(1e-3, 1e3))
    def test_posterior_is_dragans_at_every_point_of_a_motion(self, seed, dim, scale):
        scene = random_scene(seed, dim)
        scene = lg.Scene(scale * scene.start, scale * scene.goals, scale * scene.workspace)
        motion = np.random.default_rng(seed).uniform(*scene.workspace, (30, dim))
        motion[0] = scene.start
        posterior = lg.Observer().field(scene).posterior(motion)
        beta = 20 / scene.size
        np.testing.assert_allclose(
            posterior, lg.metrics.dragan_posterior(motion, scene.goals, beta), rtol=1e-9, atol=1e-12
        )
        np.testing.assert_allclose(
            posterior, lg.metrics.dragan_posterior(motion, scene.goals), rtol=1e-9, atol=1e-12
        )


class TestPriors:
    @given(seeds, dims)
    def test_neutral_has_not_decided_at_the_start(self, seed, dim):
        rng = np.random.default_rng(seed)
        scene = random_scene(seed, dim)
        for observer in (
            lg.Observer(beta=rng.uniform(1, 100)),
            lg.Observer("gaussian", sigma=rng.uniform(0.03, 1)),
            lg.Observer("gaussian", viewpoint=rng.normal(0, 5, dim), depth=4),
        ):
            posterior = observer.field(scene).posterior(scene.start)
            np.testing.assert_allclose(posterior, 1 / scene.num_goals, rtol=1e-7)

    @given(seeds, dims)
    def test_weights_and_uniform_are_the_prior_of_the_field(self, seed, dim):
        rng = np.random.default_rng(seed)
        scene = random_scene(seed, dim)
        weights = rng.uniform(0.1, 5, scene.num_goals)
        for kind in lg.intent.observer.KINDS:
            field = lg.Observer(kind, prior=weights).field(scene)
            np.testing.assert_allclose(field.prior, weights / weights.sum())
            field = lg.Observer(kind, prior="uniform").field(scene)
            np.testing.assert_allclose(field.prior, 1 / scene.num_goals)

    def test_weights_count_by_their_ratio(self):
        for weights in ([3, 1], [3e300, 1e300], [3e-300, 1e-300], [1.5e308, 0.5e308]):
            field = lg.Observer(prior=weights).field(SCENE)
            np.testing.assert_allclose(field.prior, [0.75, 0.25])


class TestGaussian:
    @pytest.mark.parametrize(("dim", "sigma"), [(2, 0.15), (3, 0.08)])
    def test_the_papers(self, dim, sigma):
        scene, observer = random_scene(0, dim), lg.Observer.paper(dim)
        assert observer == lg.Observer("gaussian", "uniform", sigma=sigma)
        field = lg.InformationPotentialField(scene.goals, sigma)
        points = np.random.default_rng(0).uniform(*scene.workspace, (50, dim))
        np.testing.assert_array_equal(
            observer.field(scene).posterior(points), field.posterior(points)
        )

    @pytest.mark.parametrize("dim", [1, 4, "2", None])
    def test_there_is_none_of_the_papers_in_other_dimensions(self, dim):
        with pytest.raises(InvalidInputError, match="dim must be 2 or 3"):
            lg.Observer.paper(dim)

    @given(seeds, dims)
    def test_sigma_follows_the_scenes_size(self, seed, dim):
        scene = random_scene(seed, dim)
        field = lg.Observer("gaussian", "uniform").field(scene)
        assert field.sigma == pytest.approx(0.15 * scene.size)

    @given(seeds, dims, st.floats(1, 4))
    def test_viewpoint_widens_the_covariance_along_the_line_of_sight(self, seed, dim, depth):
        scene, rng = random_scene(seed, dim), np.random.default_rng(seed)
        eyes = rng.normal(0, 5, dim)
        sight = scene.goals.mean(axis=0) - eyes
        sight /= np.linalg.norm(sight)
        covariance = 0.2**2 * (np.eye(dim) + (depth**2 - 1) * np.outer(sight, sight))
        observer = lg.Observer("gaussian", sigma=0.2, viewpoint=eyes, depth=depth)
        precision = observer.field(scene).precision
        np.testing.assert_allclose(precision @ covariance, np.eye(dim), atol=1e-9)

    @given(seeds, dims)
    def test_without_depth_the_viewpoint_does_not_matter(self, seed, dim):
        scene, rng = random_scene(seed, dim), np.random.default_rng(seed)
        x = rng.uniform(*scene.workspace, (20, dim))
        seen = lg.Observer("gaussian", viewpoint=rng.normal(0, 5, dim), depth=1).field(scene)
        plain = lg.Observer("gaussian").field(scene)
        np.testing.assert_allclose(seen.posterior(x), plain.posterior(x), atol=1e-9)

    @given(seeds, dims)
    def test_how_far_away_the_eyes_are_does_not_matter(self, seed, dim):
        scene, rng = random_scene(seed, dim), np.random.default_rng(seed)
        middle, direction = scene.goals.mean(axis=0), rng.normal(size=dim)
        near, far = (
            lg.Observer("gaussian", viewpoint=middle + r * direction).field(scene).precision
            for r in (1, 1e6)
        )
        np.testing.assert_allclose(near, far, rtol=1e-6, atol=1e-6 * np.abs(near).max())


@given(seeds, dims, st.floats(1e-3, 1e3), st.floats(-1e3, 1e3), st.booleans())
def test_moved_turned_and_scaled_scenes_are_read_alike(seed, dim, scale, offset, turned):
    """A viewpoint moves, turns and scales with the scene, σ and β scale."""
    rng, scene = np.random.default_rng(seed), random_scene(seed, dim)
    observer = random_observer(rng, scene)

    def move(points):
        points = np.array(points)
        if turned:
            points[..., :2] = np.stack([-points[..., 1], points[..., 0]], axis=-1)
        return scale * points + offset

    corners = move(scene.workspace)
    other = lg.Scene(move(scene.start), move(scene.goals), [corners.min(0), corners.max(0)])
    content = observer.to_dict()
    if observer.viewpoint:
        content["viewpoint"] = move(observer.viewpoint)
    if observer.sigma:
        content["sigma"] = scale * observer.sigma
    if observer.beta:
        content["beta"] = observer.beta / scale
    x = rng.uniform(*scene.workspace, (30, dim))
    here, there = observer.field(scene), lg.Observer(**content).field(other)
    rounding = 1e-11 * (1 + abs(offset) / scale)
    np.testing.assert_allclose(there.posterior(move(x)), here.posterior(x), atol=1e3 * rounding)


@given(seeds, dims)
def test_posterior_is_a_distribution_and_the_potential_its_logarithm(seed, dim):
    rng, scene = np.random.default_rng(seed), random_scene(seed, dim)
    field = random_observer(rng, scene).field(scene)
    x = rng.uniform(*scene.workspace, (30, dim))
    posterior = field.posterior(x)
    assert posterior.shape == (30, scene.num_goals)
    np.testing.assert_allclose(posterior.sum(-1), 1, rtol=1e-12)
    for target in range(scene.num_goals):
        np.testing.assert_allclose(
            np.exp(-field.potential(x, target)), posterior[:, target], rtol=1e-9
        )


@given(seeds, dims, st.sampled_from([1e3, 1e9, 1e100, 1e200, 1.7e308]))
def test_finite_for_every_finite_point(seed, dim, distance):
    rng, scene = np.random.default_rng(seed), random_scene(seed, dim)
    field = random_observer(rng, scene).field(scene)
    x = distance * rng.uniform(-1, 1, (20, dim))
    x[0] = distance
    with np.errstate(all="raise", under="ignore"):
        for target in range(scene.num_goals):
            potential = field.potential(x, target)
            assert np.isfinite(potential).all()
            assert (potential >= 0).all()
        np.testing.assert_allclose(field.posterior(x).sum(-1), 1, rtol=1e-9)


class TestReads:
    @given(seeds, dims)
    def test_score(self, seed, dim):
        rng, scene = np.random.default_rng(seed), random_scene(seed, dim)
        curves = rng.uniform(*scene.workspace, (4, 20, dim))
        observer = lg.Observer(alpha=1.0)
        np.testing.assert_array_equal(
            observer.score(curves, scene, 1),
            lg.metrics.legibility_score(curves, observer.field(scene), 1, 1.0),
        )

    def test_the_field_of_a_scene_is_kept(self):
        field = lg.Observer().field(SCENE)
        assert field is lg.Observer().field(lg.Scene(SCENE.start, SCENE.goals))
        assert field is not lg.Observer(beta=3).field(SCENE)

    def test_labels(self):
        scores = np.array([-3.0, -2.0, -1.0, -0.5, -0.1])
        np.testing.assert_array_equal(
            lg.Observer(label="rank").labels(scores, -2.0), lg.labels.rank_label(scores)
        )
        np.testing.assert_array_equal(
            lg.Observer().labels(scores, -2.0), lg.labels.anchored_label(scores, -2.0)
        )


OBSERVERS = [
    lg.Observer(),
    lg.Observer(beta=1 / 3, alpha=0, detour=1, label="rank"),
    lg.Observer(prior=[0.25, 0.75]),
    lg.Observer.paper(3),
    lg.Observer("gaussian", "neutral", viewpoint=[1, 2 / 3, -3], depth=2),
]


class TestValues:
    @pytest.mark.parametrize("observer", OBSERVERS, ids=str)
    def test_round_trips(self, tmp_path, observer):
        assert lg.Observer(**json.loads(json.dumps(observer.to_dict()))) == observer
        assert lg.Observer.from_dict(observer.to_dict()) == observer
        assert eval(repr(observer), {"Observer": lg.Observer}) == observer
        for name in ("observer.yaml", "observer.json"):
            observer.save(tmp_path / name)
            assert lg.Observer.load(tmp_path / name) == observer
            assert hash(lg.Observer.load(tmp_path / name)) == hash(observer)

    def test_a_json_file_is_json(self, tmp_path):
        DEFAULT_OBSERVER.save(tmp_path / "observer.json")
        assert json.loads((tmp_path / "observer.json").read_text())["kind"] == "boltzmann"

    def test_a_file_may_leave_out_what_is_the_default(self, tmp_path):
        (tmp_path / "observer.yaml").write_text("kind: gaussian\nviewpoint: [0, 1]\n")
        expected = lg.Observer("gaussian", viewpoint=(0, 1))
        assert lg.Observer.load(tmp_path / "observer.yaml") == expected

    @pytest.mark.parametrize(
        ("observer", "expected"),
        [
            ("paper", lg.Observer.paper(2)),
            ("dragan", lg.Observer()),
            ("", lg.Observer()),
            ("eyes.yaml", lg.Observer(beta=7)),
            ("{beta: 5}", lg.Observer(beta=5)),
        ],
    )
    def test_of_a_scene_by_name_file_or_mapping(self, tmp_path, observer, expected):
        """A file lies beside the scene's."""
        lg.Observer(beta=7).save(tmp_path / "eyes.yaml")
        file = tmp_path / "scene.yaml"
        file.write_text(f"start: [0, 0]\ngoals: [[1, 0], [1, 1]]\nobserver: {observer}\n")
        assert lg.Observer.load(file) == expected

    def test_depth_needs_a_viewpoint(self):
        for kind in ("boltzmann", "gaussian"):
            with pytest.raises(InvalidInputError, match="depth 5 belongs to a viewpoint"):
                lg.Observer(kind=kind, depth=5)

    def test_repr_is_short(self):
        assert repr(lg.Observer()) == "Observer()"
        assert repr(lg.Observer(beta=3)) == "Observer(beta=3.0)"

    def test_any_number_is_a_plain_one(self):
        observer = lg.Observer(beta=np.array(0.5), alpha=np.float32(2), prior=np.array([1, 2]))
        assert observer == lg.Observer(beta=0.5, alpha=2.0, prior=(1.0, 2.0))
        assert hash(observer) == hash(lg.Observer(beta=0.5, alpha=2.0, prior=(1.0, 2.0)))

    def test_cannot_be_changed(self):
        with pytest.raises(AttributeError):
            lg.Observer().beta = 0.1  # pyright: ignore


BAD = [
    {"kind": "laplace"},
    {"kind": None},
    {"kind": ["gaussian"]},
    {"prior": "flat"},
    {"prior": None},
    {"prior": 0.5},
    {"prior": []},
    {"prior": [1.0]},
    {"prior": [1, 0]},
    {"prior": [1, -1]},
    {"prior": [1, np.nan]},
    {"prior": {"a": 1}},
    {"kind": "gaussian", "sigma": 0},
    {"kind": "gaussian", "sigma": -0.1},
    {"kind": "gaussian", "sigma": np.nan},
    {"kind": "gaussian", "sigma": "wide"},
    {"kind": "gaussian", "sigma": [0.1]},
    {"kind": "gaussian", "beta": 1},
    {"kind": "gaussian", "viewpoint": [0]},
    {"kind": "gaussian", "viewpoint": [0, np.inf]},
    {"kind": "gaussian", "viewpoint": "left"},
    {"kind": "gaussian", "depth": 0.5},
    {"kind": "gaussian", "depth": np.inf},
    {"sigma": 0.15},
    {"viewpoint": [0, 0]},
    {"beta": 0},
    {"beta": -1},
    {"beta": np.inf},
    {"alpha": -1},
    {"alpha": np.nan},
    {"alpha": None},
    {"alpha": [3.0]},
    {"detour": 0.99},
    {"detour": np.inf},
    {"detour": None},
    {"label": "linear"},
    {"label": None},
    {"label": ["rank"]},
]


class TestBadInput:
    @pytest.mark.parametrize("wrong", BAD, ids=str)
    def test_is_named_in_one_line(self, wrong, tmp_path):
        name = list(wrong)[-1]
        with pytest.raises(InvalidInputError, match=name) as caught:
            lg.Observer(**wrong)
        assert "\n" not in str(caught.value)
        with pytest.raises(InvalidInputError, match=name):
            lg.Observer.from_dict(wrong)

    @pytest.mark.parametrize("content", [None, [], "gaussian", {"kind": "gaussian", "sigm": 1}])
    def test_contents_that_are_not_an_observer(self, content):
        with pytest.raises(InvalidInputError, match=r"an observer .* keys .*kind, prior, sigma"):
            lg.Observer.from_dict(content)

    def test_files_are_named(self, tmp_path):
        (tmp_path / "bad.yaml").write_text("sigma: -1\nkind: gaussian\n")
        with pytest.raises(InvalidInputError, match=r"bad\.yaml: sigma must be a number above 0"):
            lg.Observer.load(tmp_path / "bad.yaml")
        with pytest.raises(InvalidInputError, match="cannot read the observer file"):
            lg.Observer.load(tmp_path / "none.yaml")

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ({"prior": [1, 2, 3]}, "prior must be 2 numbers above 0"),
            ({"kind": "gaussian", "viewpoint": [0, 0, 1]}, "viewpoint must be 2 numbers in this"),
            (
                {"kind": "gaussian", "viewpoint": [0.9, 0.45]},
                "viewpoint must not lie in the middle of the goals",
            ),
            ({"kind": "gaussian", "sigma": 1e-200}, "sigma must not vanish"),
            ({"kind": "gaussian", "sigma": 1e200}, "sigma or beta must tell the goals apart"),
            ({"beta": 1e300}, "beta must be at most"),
            ({"beta": 1e8}, "beta must be at most"),
        ],
        ids=str,
    )
    def test_observers_who_do_not_fit_the_scene(self, arguments, message):
        with pytest.raises(InvalidInputError, match=message):
            lg.Observer(**arguments).field(SCENE)
