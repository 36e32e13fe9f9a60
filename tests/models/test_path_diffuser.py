"""Stage 1: its latent, its conditions and its sampler."""

import dataclasses
import json

import numpy as np
import pytest
import torch

from legibility import Ball, Observer, Scene
from legibility.curves import NUM_WAYPOINTS
from legibility.errors import CheckpointError, InvalidInputError
from legibility.models.checkpoint import load_state
from legibility.models.configuration import PathDiffuserConfig
from legibility.models.diffusion import ddim, noise_schedule, sampling_timesteps
from legibility.models.inputs import DEPTH, vector_size
from legibility.models.path_diffuser import DIAL_LEVELS, PathDiffuser, dial_of

TINY = {"channels": (8, 16), "condition": 16, "encoder_width": 8, "resolution": 16}


def make(dim=2, seed=0, loud=True, **changes):
    """A tiny diffuser; a loud one has an outlet that is not zero, so that conditions show."""
    torch.manual_seed(seed)
    model = PathDiffuser(PathDiffuserConfig(**{"dim": dim, **TINY, **changes}))
    if loud:
        torch.nn.init.normal_(model.unet.outlet.weight, std=0.3)
        torch.nn.init.normal_(model.no_field)
        torch.nn.init.normal_(model.no_level)
        model.spread.uniform_(0.5, 2)
    model.signal.copy_(noise_schedule(model.config.diffusion_steps))
    return model.eval()


def scenes(dim, num=3):
    return [Scene.random(np.random.default_rng(seed), dim=dim) for seed in range(num)]


def conditions_of(model, seen, targets=None, observer=None):
    """Those of scenes for one observer; the target is goal 0 if not given."""
    size = len(seen)
    return model.conditions(seen, targets or [0] * size, [observer or Observer()] * size)


def dials(conditions):
    """Some dial for each scene, `(B, 17)`."""
    return conditions.vector.sum(1, keepdim=True) - torch.linspace(0, 3, len(DIAL_LEVELS))


def barred(scene):
    """The scene with an obstacle in the middle of the straight line to goal 0."""
    radius = 0.1 * np.linalg.norm(scene.goals[0] - scene.start)
    ball = Ball((scene.start + scene.goals[0]) / 2, radius)
    return Scene(scene.start, scene.goals, scene.workspace, [ball])


def noise(size, dim, seed=0):
    return torch.randn(size, NUM_WAYPOINTS, dim, generator=torch.Generator().manual_seed(seed))


@pytest.fixture(params=[2, 3])
def dim(request):
    return request.param


class TestConfig:
    @pytest.mark.parametrize(
        "config",
        [
            PathDiffuserConfig(),
            PathDiffuserConfig(
                dim=3,
                observer=Observer(alpha=1.0, detour=2.0, label="rank", prior=(1, 2)),
                field=False,
                guidance=0.5,
                **TINY,
            ),
        ],
        ids=str,
    )
    def test_round_trip(self, config):
        assert PathDiffuserConfig.from_dict(json.loads(json.dumps(config.to_dict()))) == config

    @pytest.mark.parametrize("name", PathDiffuserConfig().to_dict())
    def test_every_key_must_be_there(self, name):
        content = PathDiffuserConfig().to_dict()
        del content[name]
        with pytest.raises(CheckpointError, match=name):
            PathDiffuserConfig.from_dict(content)

    def test_no_other_key(self):
        with pytest.raises(CheckpointError, match="speed"):
            PathDiffuserConfig.from_dict({**PathDiffuserConfig().to_dict(), "speed": 1})

    @pytest.mark.parametrize("value", [1, None, "no"])
    @pytest.mark.parametrize("name", ["field", "distilled"])
    def test_true_or_false(self, name, value):
        with pytest.raises(InvalidInputError, match=f"{name} must be true or false"):
            PathDiffuserConfig(**{name: value})

    @pytest.mark.parametrize("observer", [None, "rank", {"sigma": 0.15}])
    def test_observer_is_one(self, observer):
        with pytest.raises(InvalidInputError, match=r"observer must be a legibility\.Observer"):
            PathDiffuserConfig(observer=observer)


class TestLatent:
    def test_is_inverted(self, dim):
        model = make(dim)
        waypoints = 2 * torch.randn(50, NUM_WAYPOINTS, dim) + 0.5
        torch.testing.assert_close(
            model.from_latent(model.to_latent(waypoints)), waypoints, atol=1e-4, rtol=1e-4
        )

    def test_straight_line_is_zero(self, dim):
        model = make(dim)
        straight = torch.zeros(1, NUM_WAYPOINTS, dim)
        straight[..., 0] = torch.linspace(0, 1, NUM_WAYPOINTS + 2)[1:-1]
        torch.testing.assert_close(model.to_latent(straight), torch.zeros_like(straight))
        torch.testing.assert_close(model.from_latent(torch.zeros_like(straight)), straight)

    def test_no_latent_is_too_large(self, dim):
        wild = torch.full((1, NUM_WAYPOINTS, dim), 1e30)
        assert torch.isfinite(make(dim).from_latent(wild)).all()

    def test_spread_is_the_unit(self):
        """A larger spread makes the same path a smaller latent."""
        model = make(loud=False)
        waypoints = torch.rand(4, NUM_WAYPOINTS, 2)
        before = model.to_latent(waypoints)
        model.spread.fill_(2)
        torch.testing.assert_close(model.to_latent(waypoints), before / 2)


class TestConditions:
    def test_shapes(self, dim):
        found = conditions_of(make(dim), scenes(dim), [0, 1, 0])
        slices = 1 if dim == 2 else DEPTH
        most = max(scene.num_goals for scene in scenes(dim)) - 1
        assert found.image.shape == (3, 3 * slices, 16, 16)
        assert found.vector.shape == (3, vector_size(dim))
        assert found.slopes.shape == found.distractors.shape == (3, most, dim)
        assert found.intercepts.shape == (3, most)
        assert found.beta.shape == (3, 1, 1)
        assert found.without_image().image.numel() == 0
        assert found.map(lambda x: x[1:]).image.equal(found.image[1:])

    @pytest.mark.parametrize("change", ["observer", "obstacle", "distractor"])
    def test_what_is_seen_reaches_context_and_reading(self, dim, change):
        """The first two scenes change; the contexts and the readings of these alone do."""
        model, seen = make(dim), scenes(dim)
        observers, others = [Observer()] * 3, list(seen)
        if change == "observer":
            observers = [Observer(beta=1.0 / s.size) for s in seen[:2]] + observers[2:]
        elif change == "obstacle":
            others[:2] = map(barred, seen[:2])
        else:
            middles = [(s.start + s.goals[0]) / 2 for s in seen]
            others[:2] = [
                Scene(s.start, [*s.goals, m], s.workspace)
                for s, m in zip(seen[:2], middles, strict=False)
            ]
        one = conditions_of(model, seen)
        two = model.conditions(others, [0, 0, 0], observers)
        context, times = torch.randn(3, 16), torch.tensor([10, 50, 90])
        with torch.no_grad():
            pairs = [
                (model.encode_scene(one, dials(one)), model.encode_scene(two, dials(two))),
                [model(noise(3, dim), times, context, c) for c in (one, two)],
            ]
        for a, b in pairs:
            gaps = (a - b).abs().flatten(1).amax(1)
            assert (gaps[:2] > 1e-5).all()
            assert gaps[2] < 1e-4

    def test_a_number_of_targets_that_is_not_that_of_the_scenes(self):
        with pytest.raises(ValueError, match="zip"):
            make().conditions(scenes(2), [0], [Observer()] * 3)

    def test_dropped_field_is_ignored(self):
        model = make()
        conditions = conditions_of(model, scenes(2))
        other = dataclasses.replace(conditions, image=conditions.image + 1)
        for keep, same in (([False] * 3, [True] * 3), ([True, False, True], [False, True, False])):
            keep = torch.tensor(keep)
            one, two = (
                model.encode_scene(conditions, dials(conditions), keep),
                model.encode_scene(other, dials(other), keep),
            )
            assert [torch.equal(a, b) for a, b in zip(one, two, strict=True)] == same

    def test_dropped_level_is_ignored(self):
        model = make()
        conditions = conditions_of(model, scenes(2))
        scene = model.encode_scene(conditions, dials(conditions))
        keep = torch.tensor([False, True, False])
        one = model.encode(scene, torch.tensor([-1.0, -1, 0]), keep)
        two = model.encode(scene, torch.tensor([1.0, 1, 0.5]), keep)
        assert [torch.equal(a, b) for a, b in zip(one, two, strict=True)] == [True, False, True]

    def test_dropped_field_is_not_read_along_the_path(self):
        model = make()
        conditions = conditions_of(model, scenes(2))
        other = dataclasses.replace(conditions, intercepts=conditions.intercepts / 2 + 1)
        context, times = torch.randn(3, 16), torch.tensor([10, 50, 90])
        keep = torch.tensor([False, True, False])
        one = model(noise(3, 2), times, context, conditions, keep)
        two = model(noise(3, 2), times, context, other, keep)
        assert [torch.equal(a, b) for a, b in zip(one, two, strict=True)] == [True, False, True]

    def test_kept_is_the_default(self):
        model = make()
        conditions = conditions_of(model, scenes(2))
        scene = model.encode_scene(conditions, dials(conditions))
        assert torch.equal(
            scene,
            model.encode_scene(conditions, dials(conditions), torch.ones(3, dtype=torch.bool)),
        )
        level = torch.tensor([-1.0, 0, 1])
        kept = model.encode(scene, level, torch.ones(3, dtype=torch.bool))
        assert torch.equal(model.encode(scene, level), kept)


class TestSample:
    def sample(self, model, level=(-1.0, 0.0, 1.0), seed=0, **options):
        dim = model.config.dim
        conditions = conditions_of(model, scenes(dim))
        return model.sample(
            conditions, torch.tensor(level), noise(3, dim, seed), dial=dials(conditions), **options
        )

    @pytest.mark.parametrize("channels", [(8,), (8, 16), (8, 16, 16)])
    def test_shape_and_finite(self, dim, channels):
        found = self.sample(make(dim, channels=channels))
        assert found.shape == (3, NUM_WAYPOINTS, dim)
        assert torch.isfinite(found).all()
        assert not found.requires_grad

    def test_is_fixed_by_the_noise(self, dim):
        model = make(dim)
        assert torch.equal(self.sample(model), self.sample(model))
        assert not torch.allclose(self.sample(model), self.sample(model, seed=1))

    def test_level_and_scene_are_seen(self, dim):
        model = make(dim)
        assert not torch.allclose(self.sample(model), self.sample(model, level=(1.0, 1.0, -1.0)))
        assert not torch.allclose(*self.sample(model, level=(0.0, 0.0, 0.0))[:2])

    def test_rows_do_not_meet(self, dim):
        model = make(dim)
        conditions = conditions_of(model, scenes(dim)).map(lambda x: x[1:2])
        alone = model.sample(
            conditions, torch.tensor([0.0]), noise(3, dim)[1:2], dial=dials(conditions)
        )
        torch.testing.assert_close(alone, self.sample(model)[1:2], atol=1e-5, rtol=1e-5)

    @pytest.mark.parametrize("guidance", [0.0, 0.5])
    def test_is_denoised_by_forward(self, dim, guidance):
        """Sampling takes the steps of DDIM with the network that is trained."""
        model, level = make(dim), torch.tensor([-1.0, 0.3, 1])
        conditions = conditions_of(model, scenes(dim))
        times, never = sampling_timesteps(100, 3), torch.zeros(3, dtype=torch.bool)
        context = model.encode(model.encode_scene(conditions, dials(conditions)), level)
        nothing = model.encode(
            model.encode_scene(conditions, dials(conditions), never), level, never
        )
        weight = guidance * level[:, None, None] ** 4

        def velocity(latent, i):
            time = torch.full((3,), times[i])
            found = model(latent, time, context, conditions)
            free = model(latent, time, nothing, conditions, never)
            return found + weight * (found - free)

        with torch.no_grad():
            expected = model.from_latent(ddim(velocity, noise(3, dim), model.signal, times))
        found = model.sample(
            conditions, level, noise(3, dim), guidance=guidance, dial=dials(conditions)
        )
        torch.testing.assert_close(found, expected, atol=1e-4, rtol=1e-4)

    def test_a_large_batch_is_that_of_each_row(self, dim):
        model, level = make(dim), torch.linspace(-1, 1, 150)
        many = [Scene.random(np.random.default_rng(i), dim=dim) for i in range(150)]
        whole = conditions_of(model, many)
        found = model.sample(whole, level, noise(150, dim), dial=dials(whole))
        for i in (0, 63, 64, 149):
            alone = whole.map(lambda x, i=i: x[i : i + 1])
            expected = model.sample(
                alone, level[i : i + 1], noise(150, dim)[i : i + 1], dial=dials(alone)
            )
            torch.testing.assert_close(found[i : i + 1], expected, atol=1e-4, rtol=1e-4)

    @pytest.mark.parametrize("guidance", [0.0, 0.5])
    def test_one_scene_for_all_levels(self, dim, guidance):
        model, level = make(dim), torch.tensor([-1.0, 0, 1])
        once = conditions_of(model, scenes(dim)[:1])
        thrice = conditions_of(model, scenes(dim)[:1] * 3)
        torch.testing.assert_close(
            model.sample(once, level, noise(3, dim), guidance=guidance, dial=dials(once)),
            model.sample(thrice, level, noise(3, dim), guidance=guidance, dial=dials(thrice)),
            atol=1e-5,
            rtol=1e-5,
        )

    def test_guidance_moves_away_from_the_unconditional_path(self):
        model = make()
        ends, centre = (1.0, -1.0, 1.0), (0.0, 0.0, 0.0)
        plain = self.sample(model, level=ends, guidance=0.0)
        # v̂ = v(c) + w (v(c) − v(∅)) at the ends: with w = −1 only the unconditional one is left.
        free = self.sample(model, level=ends, guidance=-1.0)
        other = self.sample(model, level=(-1.0, 1.0, -1.0), guidance=-1.0)
        torch.testing.assert_close(free, other, atol=1e-4, rtol=1e-4)
        assert not torch.allclose(plain, free, atol=1e-3)
        assert not torch.allclose(plain, self.sample(model, level=ends, guidance=1.0), atol=1e-3)
        between = [self.sample(model, level=centre, guidance=w) for w in (0.0, 9.0)]
        torch.testing.assert_close(*between, atol=1e-5, rtol=1e-5)

    def test_guidance_of_the_configuration_is_the_default(self):
        model, guided = make(), make(guidance=0.7)
        assert torch.equal(self.sample(guided), self.sample(model, guidance=0.7))
        assert torch.equal(self.sample(guided, guidance=0.3), self.sample(model, guidance=0.3))

    @pytest.mark.parametrize("steps", [1, 2, 3, 7, 20, 33, 100])
    def test_any_number_of_steps(self, steps):
        found = self.sample(make(), steps=steps)
        assert torch.isfinite(found).all()
        assert torch.equal(found, self.sample(make(sampling_steps=steps)))


class TestWithoutField:
    def sample(self, model, seen, level=1.0, **options):
        conditions = conditions_of(model, seen, observer=Observer(beta=20.0))
        return model.sample(
            conditions,
            torch.full((3,), level),
            noise(3, model.config.dim),
            dial=dials(conditions),
            **options,
        )

    @pytest.mark.parametrize("guidance", [0.0, 0.5])
    def test_distractors_are_not_seen(self, dim, guidance):
        one = scenes(dim)
        other = [
            Scene(scene.start, [scene.goals[0], scene.workspace[i % 2]], scene.workspace)
            for i, scene in enumerate(one)
        ]
        model = make(dim, field=False)
        assert torch.equal(
            self.sample(model, one, guidance=guidance), self.sample(model, other, guidance=guidance)
        )
        assert not torch.allclose(
            *(self.sample(make(dim), s, guidance=guidance) for s in (one, other))
        )

    def test_obstacles_are_read_at_the_waypoints(self, dim):
        model, other = make(dim, field=False), [barred(scene) for scene in scenes(dim)]
        assert not torch.allclose(self.sample(model, scenes(dim)), self.sample(model, other))

    def test_target_and_level_are_seen(self, dim):
        model = make(dim, field=False)
        assert not torch.allclose(*(self.sample(model, scenes(dim), ell) for ell in (-1.0, 1.0)))
        found = self.sample(model, scenes(dim))
        turned = [Scene(s.goals[0], [s.start, *s.goals[1:]], s.workspace) for s in scenes(dim)]
        assert not torch.allclose(found, self.sample(model, turned))

    def test_the_unconditional_path_is_without_level(self):
        """With w = −1 only it is left, see above."""
        model = make(field=False)
        ends = [self.sample(model, scenes(2), ell, guidance=-1.0) for ell in (-1.0, 1.0)]
        torch.testing.assert_close(*ends, atol=1e-4, rtol=1e-4)

    def test_every_parameter_is_trained(self):
        model = make(field=False)
        conditions = conditions_of(model, scenes(2))
        keep = torch.tensor([True, False, True])
        context = model.encode(
            model.encode_scene(conditions, dials(conditions), keep), torch.ones(3), keep
        )
        model(noise(3, 2), torch.full((3,), 50), context, conditions, keep).sum().backward()
        assert all(parameter.grad is not None for parameter in model.parameters())

    def test_weights_are_not_those_of_a_model_with_it(self):
        with pytest.raises(CheckpointError, match="unknown"):
            load_state(make(field=False), make().state_dict(), "path.safetensors")
        with pytest.raises(CheckpointError, match="missing"):
            load_state(make(), make(field=False).state_dict(), "path.safetensors")


class TestDial:
    def test_is_the_log_of_the_cost(self):
        scores = np.array([[-1.0, -np.exp(-2), -1e-40, 0.0]])
        np.testing.assert_allclose(dial_of(scores), [[0, -2, np.log(1e-30), np.log(1e-30)]])

    def test_is_seen(self, dim):
        model = make(dim)
        conditions = conditions_of(model, scenes(dim))
        one, two = (model.encode_scene(conditions, x * dials(conditions)) for x in (1, 2))
        assert ((one - two).abs().amax(1) > 1e-4).all()

    def test_must_be_given(self):
        model = make()
        with pytest.raises(InvalidInputError, match="dial must be that of each scene, got None"):
            model.encode_scene(conditions_of(model, scenes(2)), None)


class TestSampler:
    def test_is_that_of_diffusers(self):
        """With all steps, where its scheduler can be given the same ones."""
        schedulers = pytest.importorskip("diffusers.schedulers.scheduling_ddim")
        scheduler = schedulers.DDIMScheduler(
            num_train_timesteps=20,
            beta_schedule="squaredcos_cap_v2",
            rescale_betas_zero_snr=True,
            prediction_type="v_prediction",
            timestep_spacing="trailing",
            clip_sample=False,
        )
        model = make(dim=2, diffusion_steps=20, sampling_steps=20)
        conditions, level = conditions_of(model, scenes(2)[:1]), torch.tensor([0.5])
        context = model.encode(model.encode_scene(conditions, dials(conditions)), level)
        scheduler.set_timesteps(20)
        assert scheduler.timesteps.tolist() == sampling_timesteps(20, 20)
        latent = noise(1, 2)
        with torch.no_grad():
            for time in scheduler.timesteps:
                velocity = model(latent, time.expand(1), context, conditions)
                latent = scheduler.step(velocity, int(time), latent).prev_sample
            expected = model.from_latent(latent)
        found = model.sample(conditions, level, noise(1, 2), guidance=0.0, dial=dials(conditions))
        torch.testing.assert_close(found, expected, atol=1e-4, rtol=1e-4)


def test_level_is_learned_within_a_few_steps():
    model = make(loud=False)
    model.train()
    optimizer = torch.optim.Adam(model.parameters(), lr=1e-2)
    conditions = conditions_of(model, scenes(2))
    level = torch.tensor([-1.0, 0, 1])
    wanted = level[:, None, None].expand(3, NUM_WAYPOINTS, 2)
    losses = []
    for _ in range(30):
        context = model.encode(model.encode_scene(conditions, dials(conditions)), level)
        velocity = model(noise(3, 2), torch.full((3,), 99), context, conditions)
        loss = (velocity - wanted).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 0.1 * losses[0]
    model.eval()
    low, high = (
        model.sample(conditions, torch.full((3,), value), noise(3, 2), dial=dials(conditions))
        for value in (-1.0, 1.0)
    )
    assert (low - high).abs().mean() > 0.01
