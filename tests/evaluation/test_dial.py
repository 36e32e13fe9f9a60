"""The evaluation of the dial tells a perfect dial from none at all."""

import dataclasses
import functools
import json
from typing import ClassVar

import numpy as np
import pytest
import torch

import legibility as lg
from legibility.curves import path_curve
from legibility.data.configuration import SceneStream
from legibility.data.dataset import paths_of
from legibility.errors import InvalidInputError
from legibility.evaluation.configuration import DialConfig
from legibility.evaluation.dial import METRICS, evaluate_dial
from legibility.intent.metrics import SCORE_POINTS
from legibility.models.configuration import PathDiffuserConfig
from legibility.models.diffusion import noise_schedule
from legibility.models.path_diffuser import PathDiffuser
from legibility.modulator import Modulator
from legibility.motion.path import Path
from legibility.rollout import Rollout

torch.set_num_threads(1)

SMALL = DialConfig(scenes=3, levels=5, samples=2, candidates=3, seed=1)

EXECUTED = {"success", "deviation"}
"""Figures of executed motions alone."""


@pytest.fixture(autouse=True, scope="module")
def quickly():
    """An archive is built once for all tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SceneStream, "archive", functools.cache(SceneStream.archive))
        yield


class Fake:
    """A modulator that picks its paths from an archive, `pick(rng, labels, asked)` says which."""

    _known: ClassVar[dict] = {}

    def __init__(self, pick, dim=2, label="anchored"):
        self.config = PathDiffuserConfig(dim=dim, observer=lg.Observer(label=label))
        self.pick = pick
        self.scenes, self.options, self.asked = [], [], []

    def plan(
        self,
        scene,
        target=0,
        legibility=1.0,
        *,
        seed=0,
        num_candidates=1,
        guidance=None,
        steps=None,
    ):
        self.scenes.append(scene)
        self.options.append((guidance, steps))
        observer = self.config.observer
        if (scene, observer) not in self._known:
            # Another archive than the evaluation's own: its seed is another.
            archive = lg.build_archive(scene, target, observer=observer, seed=99)
            paths = paths_of(archive)
            inside = scene.contains(path_curve(paths, SCORE_POINTS)).all(-1)
            paths = paths[inside]
            scores = archive.observer.score(path_curve(paths, SCORE_POINTS), scene, target)
            self._known[scene, observer] = paths, archive.label_of(scores)
        paths, labels = self._known[scene, observer]
        asked = np.atleast_1d(legibility)
        self.asked.append(asked)
        rng = np.random.default_rng([seed, 1])
        drawn = np.stack([self.pick(rng, labels, asked) for _ in range(num_candidates)])
        best = np.abs(labels[drawn] - asked).argmin(axis=0)
        chosen = paths[drawn[best, np.arange(len(asked))]]
        clipped = np.zeros(len(asked), dtype=bool)
        if np.ndim(legibility) == 0:
            chosen, clipped = chosen[0], clipped[0]
        return Path(scene, target, np.asarray(legibility), chosen, clipped, observer)


def perfect(rng, labels, asked):
    return np.abs(labels - asked[:, None]).argmin(1)


def reversed_(rng, labels, asked):
    return perfect(rng, labels, -asked)


def random(rng, labels, asked):
    return rng.integers(len(labels), size=len(asked))


def straight(rng, labels, asked):
    return perfect(rng, labels, 0 * asked)


def off_by_a_tenth(rng, labels, asked):
    return perfect(rng, labels, asked - 0.1 * np.sign(asked))


@pytest.fixture(scope="module")
def tiny():
    torch.manual_seed(0)
    shape = {"channels": (8, 16), "condition": 16, "encoder_width": 8, "resolution": 16}
    model = PathDiffuser(PathDiffuserConfig(**shape))
    torch.nn.init.normal_(model.unet.outlet.weight, std=0.3)
    model.spread.fill_(0.5)
    model.signal.copy_(noise_schedule(100))
    return Modulator(model)


@pytest.fixture(scope="module")
def found(tiny):
    return evaluate_dial(tiny, SMALL)


def overall(pick, **changes):
    config = DialConfig(scenes=4, levels=21, samples=2, candidates=4)
    found = evaluate_dial(Fake(pick), dataclasses.replace(config, **changes))["overall"]
    return {name: figures["mean"] for name, figures in found.items()}, found


class TestMeasuresWhatItSays:
    def test_a_perfect_dial(self):
        means, found = overall(perfect)
        assert found["spearman"]["min"] > 0.99
        assert means["error"] < 0.03
        assert means["error_candidates"] < 0.03
        assert means["at_1"] > 0.97
        assert means["at_-1"] < -0.97
        assert means["at_0"] == pytest.approx(0, abs=0.03)
        assert means["inside"] == 1
        assert means["wrong_order"] == 0
        assert means["spread"] == 0
        assert means["length_ratio_at_0"] == pytest.approx(1, abs=0.02)
        assert 1 < means["turning"] < 6

    def test_a_perfect_dial_in_3d(self):
        found = evaluate_dial(
            Fake(perfect, dim=3), DialConfig(scenes=2, levels=11, samples=1, candidates=0)
        )["overall"]
        assert found["spearman"]["min"] > 0.99
        assert found["error"]["mean"] < 0.03

    def test_a_perfect_dial_by_rank(self):
        found = evaluate_dial(
            Fake(perfect, label="rank"), DialConfig(scenes=2, levels=11, samples=1, candidates=0)
        )["overall"]
        assert found["spearman"]["min"] > 0.99
        assert found["error"]["mean"] < 0.03

    def test_a_random_one(self):
        means, _ = overall(random, samples=8, candidates=16)
        assert abs(means["spearman"]) < 0.15
        assert 0.4 < means["error"] < 0.8  # ∫∫ |a − b| / 4 = 2/3 for two uniform labels
        assert 0.3 < means["wrong_order"] < 0.7
        assert means["spread"] > 0.4
        assert means["error_candidates"] < 0.25 * means["error"]

    def test_a_reversed_one(self):
        means, _ = overall(reversed_)
        assert means["spearman"] < -0.99
        assert means["wrong_order"] == 1
        assert means["at_1"] < -0.97
        assert means["error"] == pytest.approx(np.abs(2 * np.linspace(-1, 1, 21)).mean(), abs=0.03)

    def test_one_that_always_goes_straight(self):
        means, _ = overall(straight)
        assert means["spearman"] == 0
        assert means["error"] == pytest.approx(np.abs(np.linspace(-1, 1, 21)).mean(), abs=0.02)
        assert means["at_1"] == pytest.approx(means["at_-1"], abs=1e-9)
        assert means["at_1"] == pytest.approx(0, abs=0.02)
        assert means["length_ratio_at_0"] == pytest.approx(1, abs=1e-3)
        assert means["beyond_archive"] == 0
        assert means["turning"] == pytest.approx(0, abs=1e-3)
        assert means["wrong_order"] == 1

    def test_one_that_is_off_by_a_tenth(self):
        means, _ = overall(off_by_a_tenth)
        assert means["error"] == pytest.approx(0.1 * 20 / 21, abs=0.02)
        assert means["at_1"] == pytest.approx(0.9, abs=0.02)
        assert means["spearman"] > 0.98

    def test_turning_is_of_both_ends_alone(self):
        fake = Fake(straight)
        plan, ends = fake.plan, {-1: 0.05, 0: 0.3, 1: 0.1}  # height of an arch, by what is asked
        found = []

        def arch(scene, target=0, legibility=1.0, **options):
            path = plan(scene, target, legibility, **options)
            if np.ndim(legibility) == 0:  # the plan that is timed
                return path
            way = scene.goals[target] - scene.start
            arch = np.sin(np.linspace(0, np.pi, 10))[:, None] * np.array([-way[1], way[0]])
            heights = [ends[int(level)] for level in path.legibility]
            bent = np.stack([scene.start + np.linspace(0, 1, 10)[:, None] * way] * len(heights))
            bent += np.array(heights)[:, None, None] * arch
            path = dataclasses.replace(path, waypoints=bent)
            headings = np.arctan2(*np.moveaxis(np.diff(path.trajectory(200), axis=1), -1, 0)[::-1])
            turned = np.abs(np.diff(np.unwrap(headings, axis=1), axis=1)).sum(1)
            found.append(turned[np.abs(path.legibility) == 1].mean())
            return path

        fake.plan = arch
        config = DialConfig(scenes=2, levels=9, samples=2, candidates=0)
        rows = evaluate_dial(fake, config)["scenes"]
        expected = found[-2:]
        assert [row["turning"] for row in rows] == pytest.approx(expected, abs=1e-6)
        assert 0.3 < expected[0] < 0.8

    def test_clipped_curves_are_not_inside(self):
        fake = Fake(perfect)
        plan = fake.plan

        def clip(scene, target=0, legibility=1.0, **options):
            path = plan(scene, target, legibility, **options)
            return dataclasses.replace(path, clipped=np.asarray(legibility) > 0.9)

        fake.plan = clip
        found = evaluate_dial(fake, dataclasses.replace(SMALL, candidates=0))
        assert found["overall"]["drawn_inside"]["mean"] == pytest.approx(1 - 1 / 5)
        assert found["overall"]["inside"]["mean"] == 1


class TestProtocol:
    def test_scenes_are_of_the_evaluation_stream(self):
        fake = Fake(perfect)
        config = DialConfig(scenes=2, levels=3, samples=1, candidates=0, seed=5, goals=(3, 4))
        evaluate_dial(fake, config)
        stream = SceneStream("evaluation", goals=(3, 4), seed=5)
        assert list(dict.fromkeys(fake.scenes)) == [stream.scene(i) for i in range(2)]

    def test_levels_and_samples_are_asked(self):
        fake = Fake(perfect)
        evaluate_dial(fake, DialConfig(scenes=1, levels=5, samples=2, candidates=3))
        levels = np.linspace(-1, 1, 5)
        np.testing.assert_allclose(fake.asked[-2], np.repeat(levels, 2), atol=1e-12)
        np.testing.assert_allclose(fake.asked[-1], levels, atol=1e-12)

    def test_guidance_and_steps_are_handed_on(self):
        fake = Fake(perfect)
        config = DialConfig(scenes=1, levels=3, samples=1, candidates=1, guidance=0.5, steps=7)
        evaluate_dial(fake, config)
        assert set(fake.options) == {(0.5, 7)}

    def test_progress(self):
        seen = []
        config = DialConfig(scenes=2, levels=3, samples=1, candidates=0)
        evaluate_dial(Fake(perfect), config, progress=lambda *count: seen.append(count))
        assert seen == [(0, 2), (1, 2), (2, 2)]


class TestReport:
    def test_structure(self, found):
        assert set(found["overall"]) == set(METRICS) - EXECUTED
        assert found["levels"] == [-1, -0.5, 0, 0.5, 1]
        assert len(found["scenes"]) == 3
        for index, row in enumerate(found["scenes"]):
            assert row["scene"] == index
            assert 2 <= row["goals"] <= 6
            assert len(row["achieved"]) == len(row["error_by_level"]) == 5
        assert json.loads(json.dumps(found, allow_nan=False)) == found

    def test_overall_is_over_the_scenes(self, found):
        for name, figures in found["overall"].items():
            values = [row[name] for row in found["scenes"]]
            assert figures["mean"] == pytest.approx(np.mean(values))
            assert (figures["min"], figures["max"]) == (min(values), max(values))
            low, high = figures["interval"]
            assert min(values) - 1e-12 <= low <= figures["mean"] + 1e-12
            assert figures["mean"] - 1e-12 <= high <= max(values) + 1e-12

    def test_rows_hang_together(self, found):
        for row in found["scenes"]:
            assert row["at_-1"] == row["achieved"][0]
            assert row["at_0"] == pytest.approx(row["achieved"][2])
            assert row["at_1"] == row["achieved"][-1]
            assert row["error"] == pytest.approx(np.mean(row["error_by_level"]))

    def test_ranges(self, found):
        for row in found["scenes"]:
            assert -1 <= row["spearman"] <= 1
            assert 0 <= row["error_candidates"] <= 2
            assert 0 <= row["error"] <= 2
            assert row["length_ratio_at_0"] >= 1 - 1e-9
            for name in ("inside", "drawn_inside", "wrong_order", "beyond_archive"):
                assert 0 <= row[name] <= 1
            assert all(-1 <= label <= 1 for label in row["achieved"])

    def test_reproducible(self, tiny, found):
        again = evaluate_dial(tiny, SMALL)
        other = evaluate_dial(tiny, dataclasses.replace(SMALL, seed=2))
        assert again["scenes"] == found["scenes"]
        assert again["overall"] == found["overall"]
        assert other["scenes"] != found["scenes"]

    def test_the_same_for_any_number_of_workers(self, tiny, found):
        seen = []
        again = evaluate_dial(tiny, SMALL, workers=2, progress=lambda *count: seen.append(count))
        assert again["scenes"] == found["scenes"]
        assert again["overall"] == found["overall"]
        assert seen == [(n, 3) for n in range(4)]

    def test_samples_of_a_scene_do_not_hang_on_the_number_of_scenes(self, tiny, found):
        fewer = evaluate_dial(tiny, dataclasses.replace(SMALL, scenes=2))
        assert fewer["scenes"] == found["scenes"][:2]

    def test_figures_equal_a_plan_by_hand(self, tiny, found, monkeypatch):
        archive = SceneStream("evaluation", seed=1).archive(0, tiny.config.observer)
        scene = archive.scene
        asked = np.repeat(np.linspace(-1, 1, 5), 2)
        seeds = []
        plan = tiny.plan
        monkeypatch.setattr(
            tiny, "plan", lambda *a, seed, **k: seeds.append(seed) or plan(*a, seed=seed, **k)
        )
        evaluate_dial(tiny, dataclasses.replace(SMALL, scenes=1))
        path = plan(scene, 0, asked, seed=seeds[-2])
        achieved = archive.label_of(path.score)
        row = found["scenes"][0]
        assert row["error"] == pytest.approx(np.abs(achieved - asked).mean())
        np.testing.assert_allclose(row["achieved"], achieved.reshape(5, 2).mean(1))

    def test_without_candidates(self, tiny):
        plain = evaluate_dial(tiny, dataclasses.replace(SMALL, candidates=0, scenes=1))
        assert set(METRICS) - set(plain["overall"]) == {"error_candidates"} | EXECUTED

    def test_threads_are_left_as_they_were(self, tiny):
        before = torch.get_num_threads()
        try:
            torch.set_num_threads(2)
            evaluate_dial(tiny, dataclasses.replace(SMALL, candidates=0, scenes=1))
            assert torch.get_num_threads() == 2
        finally:
            torch.set_num_threads(before)


@pytest.fixture(scope="module")
def shipped():
    return Modulator.from_pretrained("block-reach-2d")


class TestClosedLoop:
    """What is measured is the executed motion, whatever was planned."""

    @pytest.fixture
    def executed(self, shipped, monkeypatch):
        """Figures of motions that follow their paths exactly but for what `change` does to them."""

        def measure(change=lambda states: states, success=True):
            def execute(env, *, legibility, seed, paths):
                seen.append((env.hidden["gain"].copy(), env.scenes, env.targets))
                np.testing.assert_array_equal([p.legibility for p in paths], legibility)
                found = []
                for one in paths:
                    states = change(one.trajectory(SCORE_POINTS))
                    off = np.full(len(states) - 1, 0.01)
                    found.append(Rollout(one, states, np.diff(states, axis=0), success,
                                         "reached" if success else "lost", (), off, 0.05,
                                         0))  # fmt: skip
                return found

            monkeypatch.setattr(shipped, "execute_many", execute)
            return evaluate_dial(shipped, dataclasses.replace(SMALL, closed_loop=True))

        seen = measure.seen = []
        return measure

    def test_of_motions_that_follow_their_paths_it_is_the_dial_of_plans(self, executed, shipped):
        closed, found = executed(), evaluate_dial(shipped, SMALL)
        assert set(closed["overall"]) == set(METRICS) - {
            "error_candidates",
            "drawn_inside",
            "turning",
        }
        for name in ("spearman", "error", "at_1", "at_0", "at_-1", "length_ratio_at_0"):
            for one, other in zip(closed["scenes"], found["scenes"], strict=True):
                assert one[name] == pytest.approx(other[name], abs=0.02)
        assert closed["overall"]["success"]["min"] == 1
        assert json.loads(json.dumps(closed, allow_nan=False)) == closed

    def test_motions_that_go_straight_have_no_dial(self, executed):
        closed = executed(lambda states: np.linspace(*states[[0, -1]], 60), success=False)
        overall = closed["overall"]
        assert overall["spearman"]["mean"] == 0
        assert overall["at_1"]["mean"] == pytest.approx(0, abs=0.02)
        assert overall["length_ratio_at_0"]["mean"] == pytest.approx(1)
        assert overall["success"]["mean"] == 0

    def test_every_motion_has_a_world_of_its_own(self, executed, shipped):
        closed = executed()
        for index, (gains, scenes, targets) in enumerate(executed.seen):
            scene = SceneStream("evaluation", seed=1).scene(index)
            assert set(scenes) == {scene}
            assert not targets.any()
            assert len(np.unique(gains)) == len(gains) == 10
            lengths = shipped.plan(scene, 0, np.zeros(2)).length
            assert 0 < closed["scenes"][index]["deviation"] < 0.01 / lengths.min() * 1.2

    def test_the_real_thing(self, shipped):
        config = DialConfig(scenes=2, levels=5, samples=1, seed=1, closed_loop=True)
        closed = evaluate_dial(shipped, config)
        assert closed["overall"]["success"]["min"] == 1
        assert closed["overall"]["spearman"]["min"] > 0.85
        assert closed["overall"]["deviation"]["max"] < 0.02
        assert evaluate_dial(shipped, config)["scenes"] == closed["scenes"]


@pytest.mark.parametrize(
    "wrong",
    [
        {"scenes": 0},
        {"goals": (1, 2)},
        {"goals": (5, 4)},
        {"seed": -1},
        {"levels": 2},
        {"levels": 4.5},
        {"samples": 0},
        {"candidates": -1},
        {"guidance": np.nan},
        {"steps": 0},
    ],
    ids=str,
)
def test_bad_settings(tiny, wrong):
    with pytest.raises(InvalidInputError, match=next(iter(wrong))):
        evaluate_dial(tiny, dataclasses.replace(SMALL, **wrong))
