"""The evaluation of the dial tells a perfect dial from none at all."""

import dataclasses
import functools
import json
from typing import ClassVar

import numpy as np
import pytest
import torch

import legibility as lg
from legibility.curves import path_curve, resample
from legibility.data.configuration import SceneStream
from legibility.data.dataset import paths_of
from legibility.errors import InvalidInputError
from legibility.evaluation import dial
from legibility.evaluation.common import DRAGAN_LEVELS, dragan_rises
from legibility.evaluation.configuration import EVALUATED, MODES, DialConfig
from legibility.evaluation.dial import LIMITS, METRICS, evaluate_dial
from legibility.intent.metrics import SCORE_POINTS
from legibility.models.configuration import PathDiffuserConfig
from legibility.motion import archive as archives
from legibility.motion.path import Path, straight_waypoints
from legibility.report.dials import dial_section
from legibility.report.table import Table
from legibility.rollout import Rollout

torch.set_num_threads(1)

SMALL = DialConfig(scenes=3, levels=5, samples=2, candidates=3, seed=1)
EXECUTED = {"success", "deviation"}
"""Metrics of executed motions alone."""

WANTED = np.unique([*np.linspace(-1, 1, 5), *DRAGAN_LEVELS])
"""The levels that `SMALL` plans."""


@pytest.fixture(autouse=True, scope="module")
def quickly(coarsely):
    """The evaluation's archive of a scene is built once for all tests."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SceneStream, "archive", functools.cache(SceneStream.archive))
        yield


class Fake:
    """A modulator that picks its paths from an archive, `pick(rng, labels, asked)` says which."""

    _known: ClassVar[dict] = {}

    def __init__(self, pick, dim=2, label="anchored"):
        self.config = PathDiffuserConfig(dim=dim, observer=lg.Observer(label=label))
        self.pick = pick
        self.scenes, self.options, self.asked, self.observers = [], [], [], []

    def plan(
        self, scene, target=0, legibility=1.0, *, seed=0, observer=None, num_candidates=1, **options
    ):
        self.scenes.append(scene)
        self.options.append(options)
        self.observers.append(observer)
        if (scene, observer) not in self._known:
            # Another archive than the evaluation's own: its seed is another.
            archive = archives.build_archive(scene, target, observer=observer, seed=99)
            paths = paths_of(archive)
            paths = paths[scene.feasible(path_curve(paths, 400), target)]
            scores = archive.observer.score(path_curve(paths, SCORE_POINTS), scene, target)
            self._known[scene, observer] = paths, archive.label_of(scores)
        paths, labels = self._known[scene, observer]
        asked = np.atleast_1d(legibility)
        self.asked.append(asked)
        rng = np.random.default_rng([seed, 1])
        drawn = np.stack([self.pick(rng, labels, asked) for _ in range(num_candidates)])
        best = np.abs(labels[drawn] - asked).argmin(axis=0)
        chosen = paths[drawn[best, np.arange(len(asked))]]
        return Path.through(chosen, scene, target, np.asarray(legibility), observer)


class Bent(Fake):
    """A modulator of paths `bend(path)` that need not be of an archive."""

    def __init__(self, bend):
        super().__init__(straight)
        self.bend = bend

    def plan(self, *args, **options):
        path = super().plan(*args, **options)
        return dataclasses.replace(path, waypoints=self.bend(path))


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


def sideways(path, offsets):
    """The straight line with `offsets (B, K + 2)` to the side, in its lengths."""
    scene = path.scene
    way = scene.goals[0] - scene.start
    line = straight_waypoints(scene.start, scene.goals[0])
    return line + np.asarray(offsets)[..., None] * np.array([-way[1], way[0]])


@pytest.fixture(scope="module")
def found(tiny):
    return evaluate_dial(tiny, SMALL)


def overall(pick, **changes):
    config = DialConfig(scenes=4, levels=21, samples=2, modes=("quick",), candidates=4)
    found = evaluate_dial(Fake(pick), dataclasses.replace(config, **changes))["overall"]["quick"]
    return {name: values["mean"] for name, values in found.items()}, found


class TestMeasuresWhatItSays:
    def test_a_perfect_dial(self):
        means, found = overall(perfect)
        assert found["spearman"]["min"] > 0.99
        assert means["error"] < 0.03
        assert means["error_candidates"] < 0.03
        assert means["at_1"] > 0.97
        assert means["at_-1"] < -0.97
        assert means["at_0"] == pytest.approx(0, abs=0.03)
        assert means["feasible"] == 1
        assert means["replaced"] == 0
        assert means["wrong_order"] == 0
        assert means["adjacent_order"] > 0.95
        assert means["spread"] < 1e-12
        assert means["length_ratio_at_0"] == pytest.approx(1, abs=0.02)
        assert 1 < means["length_ratio_at_1"] < 2.6
        assert 1 < means["length_ratio_at_-1"] < 2.6
        assert 1 < means["turning"] < 6
        assert means["waves"] <= 0.5  # single curves differ from the mean of their neighbours
        assert 0.8 < means["optimum"] < 1.3
        assert means["dragan_rises"] >= 0.75
        assert means["dragan_rises_at_3"] >= 0.75

    @pytest.mark.parametrize("other", [{"dim": 3}, {"label": "rank"}])
    def test_a_perfect_dial_of_another_kind(self, other):
        config = DialConfig(scenes=2, levels=11, samples=1, modes=("quick",), candidates=0)
        found = evaluate_dial(Fake(perfect, **other), config)["overall"]["quick"]
        assert found["spearman"]["min"] > 0.99
        assert found["error"]["mean"] < 0.03

    def test_a_random_one(self):
        means, _ = overall(random, samples=8, candidates=16)
        assert abs(means["spearman"]) < 0.15
        assert 0.4 < means["error"] < 0.8  # ∫∫ |a − b| / 4 = 2/3 for two uniform labels
        assert 0.3 < means["wrong_order"] < 0.7
        assert 0.45 < means["adjacent_order"] < 0.55
        assert means["spread"] > 0.4
        assert means["error_candidates"] < 0.25 * means["error"]

    def test_a_reversed_one(self):
        means, _ = overall(reversed_)
        assert means["spearman"] < -0.99
        assert means["wrong_order"] == 1
        assert means["adjacent_order"] == 0
        assert means["at_1"] < -0.97
        assert means["error"] == pytest.approx(np.abs(2 * np.linspace(-1, 1, 21)).mean(), abs=0.03)
        assert means["dragan_rises"] == means["dragan_rises_at_3"] == 0

    def test_one_that_always_goes_straight(self):
        line = Bent(lambda path: sideways(path, np.zeros((len(path), 10))))
        config = DialConfig(scenes=4, levels=21, samples=2, modes=("quick",), candidates=0)
        found = evaluate_dial(line, config)["overall"]["quick"]
        means = {name: values["mean"] for name, values in found.items()}
        assert means["spearman"] == 0
        assert means["error"] == pytest.approx(np.abs(np.linspace(-1, 1, 21)).mean(), abs=0.02)
        assert means["at_1"] == pytest.approx(means["at_-1"], abs=1e-9)
        assert means["at_1"] == pytest.approx(0, abs=0.02)
        for level in ("1", "0", "-1"):
            assert means[f"length_ratio_at_{level}"] == pytest.approx(1, abs=1e-3)
        assert means["beyond_archive"] == 0
        assert means["turning"] == pytest.approx(0, abs=1e-3)
        assert means["wrong_order"] == 1
        assert means["adjacent_order"] == 0
        assert means.get("optimum", 0) == pytest.approx(0, abs=1e-6)

    def test_one_that_is_off_by_a_tenth(self):
        means, _ = overall(off_by_a_tenth)
        assert means["error"] == pytest.approx(0.1 * 20 / 21, abs=0.02)
        assert means["at_1"] == pytest.approx(0.9, abs=0.02)
        assert means["spearman"] > 0.98

    def test_turning_is_of_both_ends_alone(self):
        heights = {-1: 0.05, 0: 0.3, 1: 0.1}  # of an arch, by ℓ
        turned = []

        def arch(path):
            height = [heights[int(level)] for level in path.legibility]
            bent = sideways(path, np.outer(height, np.sin(np.linspace(0, np.pi, 10))))
            curves = path_curve(bent, 400)
            headings = np.arctan2(*np.moveaxis(np.diff(curves, axis=1), -1, 0)[::-1])
            angles = np.abs(np.diff(np.unwrap(headings, axis=1), axis=1)).sum(1)
            turned.append(angles[np.abs(path.legibility) == 1].mean())
            return bent

        config = DialConfig(scenes=2, levels=9, samples=2, modes=("quick",), candidates=0)
        rows = evaluate_dial(Bent(arch), config)["scenes"]
        assert [row["quick"]["turning"] for row in rows] == pytest.approx(turned, rel=1e-5)
        assert 0.3 < turned[0] < 0.8
        assert not any(row["quick"]["waves"] for row in rows)

    def test_waves(self):
        def waves(path):
            """Four of them where ℓ is 1."""
            height = 0.15 * (path.legibility == 1)
            return sideways(path, np.outer(height, np.sin(np.linspace(0, 4 * np.pi, 10))))

        config = DialConfig(scenes=2, levels=3, samples=2, modes=("bare",), candidates=0)
        rows = evaluate_dial(Bent(waves), config)["scenes"]
        assert [row["bare"]["waves"] for row in rows] == [0.5, 0.5]

    def test_what_touches_something_is_not_feasible(self):
        config = DialConfig(
            scenes=8, regime="obstacles", levels=3, samples=1, modes=("bare",), candidates=0
        )
        rows = evaluate_dial(Bent(lambda path: sideways(path, np.zeros((len(path), 10)))), config)[
            "scenes"
        ]
        blocked = [row["blocked"] for row in rows]
        assert 0 < sum(blocked) < 8
        assert [row["bare"]["feasible"] for row in rows] == [float(not b) for b in blocked]
        assert all(1 <= row["obstacles"] <= 4 for row in rows)

    def test_replaced_paths_are_counted(self):
        fake = Fake(perfect)
        plan = fake.plan

        def replace(scene, target=0, legibility=1.0, **options):
            path = plan(scene, target, legibility, **options)
            return dataclasses.replace(path, replaced=np.asarray(legibility) > 0.9)

        fake.plan = replace
        found = evaluate_dial(fake, dataclasses.replace(SMALL, candidates=0, modes=("exact",)))
        assert found["overall"]["exact"]["replaced"]["mean"] == pytest.approx(1 / len(WANTED))

    def test_dragans_legibility_by_its_formula(self):
        """P(g|ξ) ∝ exp(−β (‖x − g‖ − ‖s − g‖)) and ∫ P(g*|ξ) (T − t) dt / ∫ (T − t) dt."""
        rng, answers = np.random.default_rng(0), []
        for _ in range(40):
            scene = lg.Scene.random(rng, dim=2)
            way = scene.goals[0] - scene.start
            sides = np.sin(np.linspace(0, np.pi, 200)) * rng.normal(0, 0.2, (3, 1))
            line = scene.start + np.linspace(0, 1, 200)[:, None] * way
            curves = line + sides[..., None] * np.array([-way[1], way[0]])
            points = resample(curves, 100)
            apart = np.linalg.norm(points[:, :, None] - scene.goals, axis=-1)
            likely = np.exp(-10 / scene.size * (apart - apart[:, :1]))
            belief = likely[..., 0] / likely.sum(-1)
            left = np.linspace(1, 0, 100)
            legibility = np.trapezoid(belief * left) / np.trapezoid(left + 0 * belief)
            answers.append(bool(legibility[0] < legibility[1] < legibility[2]))
            assert dragan_rises(curves, scene, np.arange(3), np.arange(3)) == answers[-1]
        assert 0 < sum(answers) < 40


class TestLimits:
    def test_a_perfect_dial_is_as_exact_as_its_limit(self):
        config = DialConfig(scenes=4, levels=21, samples=1, modes=("quick",), candidates=0)
        result = evaluate_dial(Fake(perfect), config)["overall"]
        noise = result["limits"]["noise"]["mean"]
        assert 0.001 < noise < 0.02
        assert result["quick"]["error"]["mean"] < 3 * noise
        assert result["limits"]["spearman"]["mean"] == pytest.approx(1, abs=2e-3)

    def test_the_same_archive_has_no_noise(self, monkeypatch):
        stream = SceneStream("evaluation", seed=1)

        def same(scene, target, observer):
            return next(a for a in map(stream.archive, range(3), [observer] * 3)
                        if a.scene == scene)  # fmt: skip

        monkeypatch.setattr(dial, "scene_archive", same)
        config = dataclasses.replace(SMALL, modes=("bare",))
        found = evaluate_dial(Fake(random), config)["overall"]["limits"]
        assert found["noise"]["max"] < 1e-9

    def test_ranges_are_the_archives(self, tiny, found):
        for index, row in enumerate(found["scenes"]):
            archive = SceneStream("evaluation", seed=1).archive(index, tiny.config.observer)
            limits = row["limits"]
            assert (limits["below"], limits["above"]) == pytest.approx(archive.range, rel=1e-5)

    def test_degenerate_scenes_are_apart(self, tiny, found, monkeypatch):
        assert found["degenerate"] is None or found["degenerate"]["scenes"] < 3
        least = sorted(min(row["limits"]["below"], row["limits"]["above"])
                       for row in found["scenes"])  # fmt: skip
        monkeypatch.setattr(archives, "SMALLEST_RANGE", (least[0] + least[1]) / 2)
        again = evaluate_dial(tiny, SMALL)
        assert again["overall"] == found["overall"]
        assert (again["sound"]["scenes"], again["degenerate"]["scenes"]) == (2, 1)
        (apart,) = [row for row in again["scenes"] if row["degenerate"]]
        assert again["degenerate"]["quick"]["error"]["mean"] == apart["quick"]["error"]
        monkeypatch.setattr(archives, "SMALLEST_RANGE", np.inf)
        assert evaluate_dial(tiny, SMALL)["sound"] is None


class TestProtocol:
    @pytest.mark.parametrize("regime", EVALUATED)
    def test_scenes_and_observers_are_of_the_evaluation_stream(self, regime):
        fake = Fake(perfect)
        config = DialConfig(
            scenes=2, regime=regime, levels=3, samples=1, candidates=0, seed=5, goals=(3, 4)
        )
        rows = evaluate_dial(fake, config)["scenes"]
        stream = SceneStream("evaluation", 2, regime, (3, 4), 5)
        scenes = [stream.scene(i) for i in range(2)]
        assert list(dict.fromkeys(fake.scenes)) == scenes
        observers = [stream.observer_of(i, scenes[i], fake.config.observer) for i in range(2)]
        assert list(dict.fromkeys(fake.observers)) == list(dict.fromkeys(observers))
        assert [row["goals"] for row in rows] == [scene.num_goals for scene in scenes]

    def test_levels_samples_and_modes_are_asked(self):
        fake = Fake(perfect)
        evaluate_dial(fake, DialConfig(scenes=1, levels=5, samples=2, candidates=3))
        bare, quick, candidates, exact = fake.asked
        for asked in (bare, quick, exact):
            np.testing.assert_allclose(asked, np.repeat(WANTED, 2), atol=1e-12)
        np.testing.assert_allclose(candidates, np.linspace(-1, 1, 5), atol=1e-12)
        sampling = {"guidance": None, "steps": None}
        assert fake.options == [
            {**sampling, "refine": False}, sampling, sampling, {**sampling, "exact": True}
        ]  # fmt: skip

    def test_guidance_and_steps_are_handed_on(self):
        fake = Fake(perfect)
        config = DialConfig(scenes=1, levels=3, samples=1, candidates=1, guidance=0.5, steps=7)
        evaluate_dial(fake, config)
        assert {(o["guidance"], o["steps"]) for o in fake.options} == {(0.5, 7)}

    def test_progress(self):
        seen = []
        config = DialConfig(scenes=2, levels=3, samples=1, modes=("bare",))
        evaluate_dial(Fake(perfect), config, progress=lambda *count: seen.append(count))
        assert seen == [(0, 2), (1, 2), (2, 2)]


class TestReport:
    def test_structure(self, found):
        result = found["overall"]
        assert set(result) == {"scenes", "limits", *MODES}
        assert result["scenes"] == 3
        assert set(result["limits"]) == set(LIMITS)
        assert set(result["quick"]) == set(METRICS) - EXECUTED
        for mode in ("bare", "exact"):
            assert set(result[mode]) == set(METRICS) - EXECUTED - {"error_candidates"}
        assert found["levels"] == [-1, -0.5, 0, 0.5, 1]
        assert len(found["scenes"]) == 3
        for index, row in enumerate(found["scenes"]):
            assert row["scene"] == index
            assert 2 <= row["goals"] <= 6
            for mode in MODES:
                assert len(row[mode]["achieved"]) == len(row[mode]["error_by_level"]) == 5
        assert json.loads(json.dumps(found, allow_nan=False)) == found

    def test_overall_is_over_the_scenes(self, found):
        for mode in MODES:
            for name, figures in found["overall"][mode].items():
                values = [row[mode][name] for row in found["scenes"] if row[mode][name] is not None]
                assert figures["mean"] == pytest.approx(np.mean(values))
                assert figures["median"] == pytest.approx(np.median(values))
                assert (figures["min"], figures["max"]) == (min(values), max(values))
                low, high = figures["interval"]
                assert min(values) - 1e-12 <= low <= figures["mean"] + 1e-12
                assert figures["mean"] - 1e-12 <= high <= max(values) + 1e-12

    def test_rows_hang_together(self, found):
        for row in (scene[mode] for scene in found["scenes"] for mode in MODES):
            assert row["at_-1"] == row["achieved"][0]
            assert row["at_0"] == row["achieved"][2]
            assert row["at_1"] == row["achieved"][-1]
            assert row["error"] == pytest.approx(np.mean(row["error_by_level"]), abs=1e-5)

    def test_ranges(self, found):
        shares = ("feasible", "replaced", "wrong_order", "adjacent_order", "beyond_archive",
                  "waves", "dragan_rises", "dragan_rises_at_3")  # fmt: skip
        for row in (scene[mode] for scene in found["scenes"] for mode in MODES):
            assert -1 <= row["spearman"] <= 1
            assert 0 <= row["error"] <= 2
            assert row["length_ratio_at_0"] >= 1 - 1e-4
            for name in shares:
                assert 0 <= row[name] <= 1
            assert all(-1 <= label <= 1 for label in row["achieved"])

    def test_refined_plans_are_feasible_and_exact_ones_exact(self, found):
        result = found["overall"]
        assert result["quick"]["feasible"]["min"] == result["exact"]["feasible"]["min"] == 1
        assert result["exact"]["error"]["mean"] < result["quick"]["error"]["mean"] < 0.03

    def test_reproducible(self, tiny, found):
        assert evaluate_dial(tiny, SMALL) == found
        other = evaluate_dial(tiny, dataclasses.replace(SMALL, seed=2))
        assert other["scenes"] != found["scenes"]

    def test_samples_of_a_scene_do_not_hang_on_the_number_of_scenes(self, tiny, found):
        fewer = evaluate_dial(tiny, dataclasses.replace(SMALL, scenes=2))
        assert fewer["scenes"] == found["scenes"][:2]

    @pytest.mark.parametrize("mode", MODES)
    def test_metrics_equal_a_plan_by_hand(self, mode, tiny, found, monkeypatch):
        archive = SceneStream("evaluation", seed=1).archive(0, tiny.config.observer)
        scene = archive.scene
        seeds = []
        plan = tiny.plan
        monkeypatch.setattr(
            tiny, "plan", lambda *a, seed, **k: seeds.append(seed) or plan(*a, seed=seed, **k)
        )
        evaluate_dial(tiny, dataclasses.replace(SMALL, scenes=1, modes=(mode,), candidates=0))
        options = {"bare": {"refine": False}, "quick": {}, "exact": {"exact": True}}[mode]
        asked = np.repeat(WANTED, 2)
        path = plan(scene, 0, asked, seed=seeds[0], **options)
        achieved = archive.label_of(path.score)
        counted = np.isin(asked, np.linspace(-1, 1, 5))
        row = found["scenes"][0][mode]
        errors = np.abs(achieved - asked)[counted]
        assert row["error"] == pytest.approx(errors.mean(), rel=1e-5)
        labels = achieved[counted].reshape(5, 2).mean(1)
        np.testing.assert_allclose(row["achieved"], labels, rtol=1e-5)
        assert row["feasible"] == path.feasible[counted].mean()

    def test_without_candidates(self, tiny):
        plain = evaluate_dial(tiny, dataclasses.replace(SMALL, candidates=0, scenes=1))
        assert "error_candidates" not in plain["overall"]["quick"]

    def test_threads_are_left_as_they_were(self, tiny):
        before = torch.get_num_threads()
        try:
            torch.set_num_threads(2)
            evaluate_dial(tiny, dataclasses.replace(SMALL, modes=("bare",), scenes=1))
            assert torch.get_num_threads() == 2
        finally:
            torch.set_num_threads(before)


class TestClosedLoop:
    """What is measured is the executed motion, whatever was planned."""

    @pytest.fixture
    def executed(self, tiny, monkeypatch):
        """Metrics of motions that follow their paths exactly but for what `change` does to them."""

        def measure(change=lambda states: states, success=True, mode="exact"):
            def execute(env, *, legibility, seed, paths, observer):
                seen.append((env.hidden["gain"].copy(), env.scenes, env.targets))
                np.testing.assert_array_equal([p.legibility for p in paths], legibility)
                assert {p.observer for p in paths} == {observer}
                found = []
                for one in paths:
                    states = change(one.trajectory(SCORE_POINTS))
                    off = np.full(len(states) - 1, 0.01)
                    found.append(Rollout(one, states, np.diff(states, axis=0), success,
                                         "reached" if success else "lost", (), off, 0.05,
                                         0, 0, 0))  # fmt: skip
                return found

            monkeypatch.setattr(tiny, "execute_many", execute, raising=False)
            config = dataclasses.replace(SMALL, closed_loop=True, modes=(mode,))
            return evaluate_dial(tiny, config)

        seen = measure.seen = []
        return measure

    def test_of_motions_that_follow_their_paths_it_is_the_dial_of_plans(self, executed, found):
        closed = executed()
        assert set(closed["overall"]) == {"scenes", "limits", "exact"}
        assert set(closed["overall"]["exact"]) == set(METRICS) - {"error_candidates"}
        for name in ("spearman", "error", "at_1", "at_0", "at_-1", "length_ratio_at_0"):
            for one, other in zip(closed["scenes"], found["scenes"], strict=True):
                assert one["exact"][name] == pytest.approx(other["exact"][name], abs=0.02)
        assert closed["overall"]["exact"]["success"]["min"] == 1
        assert json.loads(json.dumps(closed, allow_nan=False)) == closed

    def test_motions_that_go_straight_have_no_dial(self, executed):
        closed = executed(lambda states: np.linspace(*states[[0, -1]], 60), success=False)
        result = closed["overall"]["exact"]
        assert result["spearman"]["mean"] == 0
        assert result["at_1"]["mean"] == pytest.approx(0, abs=0.02)
        assert result["length_ratio_at_0"]["mean"] == pytest.approx(1)
        assert result["success"]["mean"] == 0

    def test_every_motion_has_a_world_of_its_own(self, executed):
        closed = executed()
        for index, (gains, scenes, targets) in enumerate(executed.seen):
            scene = SceneStream("evaluation", seed=1).scene(index)
            assert set(scenes) == {scene}
            assert not targets.any()
            assert len(np.unique(gains)) == len(gains) == 2 * len(WANTED)
            length = np.linalg.norm(scene.goals[0] - scene.start)
            assert 0 < closed["scenes"][index]["exact"]["deviation"] < 0.01 / length

    def test_the_real_thing(self, exact):
        config = DialConfig(
            scenes=2, levels=5, samples=1, seed=1, closed_loop=True, modes=("exact",)
        )
        closed = evaluate_dial(exact, config)
        result = closed["overall"]["exact"]
        assert result["success"]["min"] == 1
        assert result["spearman"]["min"] > 0.85
        assert evaluate_dial(exact, config)["scenes"] == closed["scenes"]


class TestMethodsOfTheUser:
    @pytest.fixture
    def file(self, tmp_path):
        file = tmp_path / "own.py"
        file.write_text("""
import functools
import numpy as np
import legibility as lg

archive = functools.cache(lambda *where: lg.build_archive(*where[:2], observer=where[2], seed=99))

def perfect(scene, target, legibility, observer):
    known = archive(scene, target, observer)
    return known.trajectories[known.nearest(legibility)]

def line(scene, target):
    return [scene.start, scene.goals[target]]

class Toward:
    def __init__(self, scene, target):
        self.goal = scene.goals[target]

    def act(self, position, limit):
        gap = self.goal - position
        return gap * min(1, limit / (2 * np.abs(gap).max()))
""")
        return file

    def test_a_planner_is_measured_as_it_plans(self, file, tiny):
        names = f"{file}:perfect", f"{file}:line"
        config = dataclasses.replace(SMALL, modes=("bare",), method=names)
        result = evaluate_dial(tiny, config)
        perfect, line = (result["overall"][name] for name in names)
        assert perfect["spearman"]["min"] > 0.99
        assert perfect["error"]["mean"] < 0.03
        assert line["spearman"]["mean"] == 0
        assert line["length_ratio_at_1"]["mean"] == pytest.approx(1)
        assert result["own"][names[0]]["kind"] == "planner"
        plain = evaluate_dial(tiny, dataclasses.replace(config, method=()))
        assert plain["overall"]["bare"] == result["overall"]["bare"]
        document = {"config": dataclasses.asdict(config), "seed": 1, "result": result}
        table = next(part for part in dial_section(document) if isinstance(part, Table))
        assert [f"{name}: mean" in table.columns for name in names] == [True, True]

    def test_a_policy_is_measured_as_it_moves(self, file, exact):
        names = f"{file}:line", f"{file}:Toward"
        config = DialConfig(
            scenes=1, levels=3, samples=1, seed=1, closed_loop=True, modes=("exact",), method=names
        )
        result = evaluate_dial(exact, config)["overall"]
        for name in names:
            assert result[name]["success"]["min"] == 1
            assert result[name]["length_ratio_at_1"]["mean"] == pytest.approx(1, abs=0.02)
            assert abs(result[name]["at_1"]["mean"]) < 0.1
        assert ["deviation" in result[name] for name in names] == [True, False]

    def test_a_policy_has_no_plan(self, file, tiny):
        with pytest.raises(InvalidInputError, match="is a policy, which needs closed_loop"):
            evaluate_dial(tiny, dataclasses.replace(SMALL, method=(f"{file}:Toward",)))

    def test_a_scene_in_which_it_fails_is_named(self, file, tiny):
        file.write_text("def plan(seed): return [[seed, 0], [0, float('nan')]]")
        with pytest.raises(InvalidInputError, match=r"own.py:plan, scene 0, target 0, ℓ = -1: "):
            evaluate_dial(tiny, dataclasses.replace(SMALL, method=(f"{file}:plan",)))


def test_modes_by_default():
    assert DialConfig().modes == MODES
    assert DialConfig(closed_loop=True).modes == ("quick",)


@pytest.mark.parametrize("wrong", [
    {"scenes": 0}, {"goals": (1, 2)}, {"goals": (5, 4)}, {"seed": -1}, {"levels": 2},
    {"levels": 4.5}, {"samples": 0}, {"candidates": -1}, {"guidance": np.nan}, {"steps": 0},
    {"regime": "training"}, {"regime": "kitchen"}, {"modes": ("slow",)}, {"env": "2d"},
    {"regime": "rooms", "closed_loop": True},
], ids=str)  # fmt: skip
def test_bad_settings(tiny, wrong):
    with pytest.raises(InvalidInputError, match=next(iter(wrong))):
        evaluate_dial(tiny, dataclasses.replace(SMALL, **wrong))
