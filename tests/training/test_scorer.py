"""Scores, labels, contacts and jerk in the start–target frame are those of the world."""

import numpy as np
import pytest
import torch
from trainings import tiny_diffuser

from legibility.curves import path_curve
from legibility.data.configuration import DatasetConfig
from legibility.data.dataset import LABEL_KNOTS, generate
from legibility.frame import Frame
from legibility.intent.observer import Observer
from legibility.training import scorer as module
from legibility.training.scorer import FrameScorer


def conditions_of(data):
    return tiny_diffuser(data).conditions(data.scenes, [0] * len(data.scenes), data.observers)


class TestFrameScorer:
    @pytest.fixture(
        scope="class",
        params=[(2, "anchored", "all"), (2, "rank", "observers"), (3, "anchored", "all")],
        ids=str,
    )
    @staticmethod
    def scored(request, tmp_path_factory):
        dim, label, regime = request.param
        config = DatasetConfig(
            dim=dim, scenes=2, views=2, cells=20 if dim == 2 else 9, per_scene=33, seed=2,
            regime=regime, candidates=8192, observer=Observer(label=label),
        )  # fmt: skip
        data = generate(config, tmp_path_factory.mktemp("scored"))
        frames = [Frame.of(scene, 0) for scene in data.scenes]
        conditions = conditions_of(data)
        waypoints = [f.world_to_frame(w) for f, w in zip(frames, data.waypoints, strict=True)]
        each = torch.arange(len(frames)).repeat_interleave(config.per_scene)
        return (
            data,
            FrameScorer(data, conditions),
            conditions.map(lambda x: x[each]),
            each,
            torch.from_numpy(np.concatenate(waypoints).astype(np.float32)),
        )

    def test_score_is_the_legibility_score(self, scored):
        data, scorer, conditions, _, waypoints = scored
        found = scorer.score(conditions, scorer.curve(waypoints)).numpy()
        exact = data.scores.ravel()
        np.testing.assert_allclose(found, exact, rtol=0.02, atol=0.01)
        assert np.abs(found - exact).mean() < 0.005 * np.abs(exact).mean()

    def test_label_is_the_archives(self, scored):
        data, scorer, conditions, each, waypoints = scored
        found = scorer.label(conditions, each, scorer.curve(waypoints)).numpy()
        gaps = np.abs(found - data.labels.ravel())[self.trusted(scorer, each)]
        assert gaps.mean() < 0.02
        assert gaps.max() < 0.25

    @staticmethod
    def trusted(scorer, each):
        """The rows of scenes whose sides of the dial are wide enough to mean something."""
        return (scorer.trust[each].amin(1) == 1).numpy()

    def test_label_of_the_knots(self, scored, monkeypatch):
        _, scorer, conditions, each, waypoints = scored
        for index in range(0, len(LABEL_KNOTS), 8):
            wanted = -torch.exp(-scorer.knots[each, index])
            monkeypatch.setattr(scorer, "score", lambda *_, wanted=wanted: wanted)
            found = scorer.label(conditions, each, scorer.curve(waypoints))
            np.testing.assert_allclose(found, LABEL_KNOTS[index], atol=2e-3)

    def test_label_goes_on_beyond_the_ends(self, scored, monkeypatch):
        _, scorer, conditions, each, waypoints = scored
        for end, sign in ((0, -1), (-1, 1)):
            beyond = -torch.exp(-scorer.knots[each, end] - sign * 0.1)
            monkeypatch.setattr(scorer, "score", lambda *_, beyond=beyond: beyond)
            found = scorer.label(conditions, each, scorer.curve(waypoints))
            assert (sign * found > 1).all()

    def test_gradient_is_finite_and_that_of_the_score(self, scored):
        _, scorer, conditions, each, waypoints = scored
        waypoints = waypoints.clone().requires_grad_()
        for value in (
            scorer.score(conditions, scorer.curve(waypoints)),
            scorer.label(conditions, each, scorer.curve(waypoints)),
        ):
            (gradient,) = torch.autograd.grad(value.sum(), waypoints)
            assert torch.isfinite(gradient).all()
            assert (gradient.abs().sum((1, 2)) > 0).float().mean() > 0.9
        step = 1e-2 * torch.nn.functional.normalize(gradient.flatten(1)).view_as(gradient)
        with torch.no_grad():
            up = scorer.label(conditions, each, scorer.curve(waypoints + step))
            down = scorer.label(conditions, each, scorer.curve(waypoints - step))
        assert ((up - down) > 0).float().mean() > 0.95

    @pytest.mark.parametrize("place", [0.0, 1.0, 1e3])
    def test_gradient_is_finite_where_waypoints_coincide(self, scored, place):
        _, scorer, conditions, each, waypoints = scored
        waypoints = torch.full_like(waypoints, place).requires_grad_()
        value = scorer.label(conditions, each, scorer.curve(waypoints))
        (gradient,) = torch.autograd.grad(value.sum(), waypoints)
        assert torch.isfinite(value).all()
        assert torch.isfinite(gradient).all()

    def test_of_any_smooth_curve(self, scored):
        """Not only of what the archive holds: score and label are the observer's."""
        data, scorer, conditions, each, _ = scored
        rng, row = np.random.default_rng(0), 1
        scene, observer, frame = (
            data.scenes[row],
            data.observers[row],
            Frame.of(data.scenes[row], 0),
        )
        straight = np.linspace(scene.start, scene.goals[0], 10)
        bend = np.sin(np.linspace(0, np.pi, 10))[:, None] * rng.normal(size=(20, 1, scene.dim))
        paths = straight + 0.3 * frame.scale * bend
        exact = observer.score(path_curve(paths, 200), scene, 0)
        waypoints = torch.from_numpy(frame.world_to_frame(paths[:, 1:-1]).astype(np.float32))
        chosen = torch.full((20,), row * data.config.per_scene)  # any trajectory of the row
        assert (each[chosen] == row).all()
        conditions, points = conditions.map(lambda x: x[chosen]), scorer.curve(waypoints)
        np.testing.assert_allclose(scorer.score(conditions, points), exact, rtol=0.02, atol=0.01)
        if self.trusted(scorer, each)[chosen].all():
            label = np.interp(exact, data.score_at_label[row], LABEL_KNOTS)
            found = scorer.label(conditions, each[chosen], points).clamp(-1, 1)
            assert np.abs(found.numpy() - label).max() < 0.1

    def test_contact_is_zero_exactly_for_curves_that_keep_the_pad(self, scored, monkeypatch):
        monkeypatch.setattr(module, "_PAD", 0.005)  # that of the data's tight rooms, too
        data, scorer, conditions, each, waypoints = scored
        generator = torch.Generator().manual_seed(0)
        moved = torch.arange(len(each))[:, None, None] % 2 * 0.1  # every second one
        waypoints = waypoints + moved * torch.randn(waypoints.shape, generator=generator)
        points = scorer.curve(waypoints)
        contact = scorer.contact(conditions, points).numpy()
        margin = []
        for row, scene in enumerate(data.scenes):
            frame, curves = Frame.of(scene, 0), points[each == row].double().numpy()
            margin.append(scene.margin_at(frame.frame_to_world(curves), 0).min(-1) / frame.scale)
        short = module._PAD - np.concatenate(margin)
        assert (contact[short < -1e-3] == 0).all()
        assert (contact[short > 1e-3] > short[short > 1e-3] / 4.1 - 1e-3).all()
        assert (contact <= 1.25 * np.maximum(short, 0) + 1e-3).all()
        assert (short < -1e-3).any()
        assert (short > 1e-3).any()

    def test_jerk_costs_beyond_that_of_the_other_path(self, scored):
        _, scorer, _, _, waypoints = scored
        assert (scorer.jerk(waypoints, waypoints) == 0).all()
        waves = waypoints + 0.2 * torch.tensor([1.0, -1] * 4)[:, None]
        assert (scorer.jerk(waves, waypoints) > 0.5).all()
        assert (scorer.jerk(waypoints, waves) == 0).all()

    def test_error_is_of_the_label_and_trusts_narrow_sides_less(self, scored, monkeypatch):
        _, scorer, conditions, each, waypoints = scored
        points = scorer.curve(waypoints)
        level = torch.where(torch.arange(len(each)) % 2 == 0, 1.0, -1.0)
        monkeypatch.setattr(scorer, "trust", torch.ones_like(scorer.trust))
        for achieved, loss in ((1.5 * level, 0.0), (0.5 * level, 0.45), (-1.0 * level, 1.95)):
            monkeypatch.setattr(scorer, "label", lambda *_, achieved=achieved: achieved)
            found = scorer.error(conditions, each, points, level)
            torch.testing.assert_close(found, torch.full_like(found, loss))
        scorer.trust[:, 1] = 0.1  # the legible side
        found = scorer.error(conditions, each, points, level)
        torch.testing.assert_close(found, torch.where(level > 0, 0.195, 1.95))


class TestSidesThatAreThin:
    """Scenes whose whole legible side lies within a millionth of the range of their scores."""

    def test_label_is_exact_and_has_a_gradient(self, tmp_path):
        config = DatasetConfig(
            scenes=12, views=1, per_scene=33, cells=16, candidates=4096, regime="paper",
            stream="validation",
        )  # fmt: skip
        data = generate(config, tmp_path)
        knots = data.score_at_label
        share = (knots[:, -1] - knots[:, 32]) / (knots[:, -1] - knots[:, 0])
        thin = int(np.argmin(share))
        assert share[thin] < 1e-6
        frame = Frame.of(data.scenes[thin], 0)
        each = torch.full((config.per_scene,), thin)
        conditions = conditions_of(data).map(lambda x: x[each])
        waypoints = torch.from_numpy(
            frame.world_to_frame(data.waypoints[thin]).astype(np.float32)
        ).requires_grad_()
        scorer = FrameScorer(data, conditions_of(data))
        label = scorer.label(conditions, each, scorer.curve(waypoints))
        assert np.abs(label.detach().numpy() - data.labels[thin]).max() < 0.1
        (gradient,) = torch.autograd.grad(label.sum(), waypoints)
        assert torch.isfinite(gradient).all()
        assert (gradient[17:].abs().sum((1, 2)) > 1e-3).all()
