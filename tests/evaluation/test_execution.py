"""The comparison of what moves the robot is fair, and measures what it says."""

import dataclasses
import json

import numpy as np
import pytest
import torch

from legibility.data.configuration import SceneStream
from legibility.errors import CheckpointError, InvalidInputError, InvalidSceneError
from legibility.evaluation import execution
from legibility.evaluation.configuration import ExecutionConfig
from legibility.evaluation.execution import ROWS, evaluate_execution
from legibility.modulator import Modulator

SMALL = ExecutionConfig(scenes=3, rollouts=18, seed=1)


@pytest.fixture(scope="module")
def modulator(exact, coarsely):
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield exact
    torch.set_num_threads(threads)


@pytest.fixture(scope="module")
def seen():
    """What `evaluate_execution` has executed, in the order of the rows."""
    return []


@pytest.fixture(scope="module")
def found(modulator, seen):
    execute = modulator.execute_many

    def spy(env, **options):
        gains, positions = env.hidden["gain"].copy(), env.positions.copy()
        rollouts = execute(env, **options)
        if options.get("driver") is not None:
            seen.append((gains, positions, options, rollouts))
        return rollouts

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(modulator, "execute_many", spy)
        return evaluate_execution(modulator, SMALL)


class TestFair:
    def test_all_rows_share_scenes_levels_plans_and_gains(self, found, seen):
        assert len(seen) == len(ROWS)
        gains, positions, options, rollouts = seen[0]
        assert len(np.unique(gains)) == 18
        for other_gains, other_positions, other_options, other_rollouts in seen[1:]:
            np.testing.assert_array_equal(gains, other_gains)
            np.testing.assert_array_equal(positions, other_positions)
            np.testing.assert_array_equal(options["legibility"], other_options["legibility"])
            for one, other in zip(rollouts, other_rollouts, strict=True):
                assert one.path.scene == other.path.scene
                np.testing.assert_array_equal(one.path.waypoints, other.path.waypoints)
        errors = [row["error_of_plan"] for row in found["rows"].values()]
        assert all(error == errors[0] for error in errors)

    def test_scenes_are_of_the_evaluation_stream(self, seen):
        expected = [SceneStream("evaluation", seed=1).scene(i) for i in range(3)]
        assert list(dict.fromkeys(r.path.scene for r in seen[0][-1])) == expected

    def test_levels_are_all_over_the_dial(self, seen):
        levels = seen[0][2]["legibility"]
        assert len(np.unique(levels)) == 18
        assert np.abs(levels).max() <= 1
        assert levels.min() < -0.3
        assert levels.max() > 0.3

    def test_the_open_loop_never_looks(self, found, seen):
        for name, gain in (("open loop", 1.0), ("open loop, mean gain", 0.75)):
            rollouts = seen[list(ROWS).index(name)][-1]
            for rollout in rollouts:
                assert not rollout.replans
                if rollout.reason == "stalled":  # the whole path was sent, once
                    sent = rollout.actions.sum(0) * gain
                    ends = rollout.path.waypoints[[0, -1]]
                    np.testing.assert_allclose(sent, ends[1] - ends[0], atol=0.05)
                    assert not rollout.actions[-1].any()

    def test_open_loops_never_replan(self, found):
        for name, row in ROWS.items():
            if not row.replan:
                assert found["rows"][name]["replanned"] == 0

    def test_disturbances_happen(self, found):
        rows = found["rows"]
        for name in ("policy, pushed", "policy, goal moved", "feedback, pushed"):
            assert rows[name]["replanned"] > 0.5
        assert rows["policy"]["replanned"] < 0.3


class TestMeasuresWhatItSays:
    def test_structure(self, found):
        assert list(found["rows"]) == list(ROWS)
        for row in found["rows"].values():
            assert row["rollouts"] == 18 == sum(row["reasons"].values())
            low, high = row["success"]["interval"]
            assert 0 <= low <= row["success"]["mean"] <= high <= 1
            assert row["success"]["mean"] == row["reasons"].get("reached", 0) / 18
        assert json.loads(json.dumps(found, allow_nan=False)).keys() == found.keys()

    def test_the_path_is_what_makes_the_dial(self, found):
        rows = found["rows"]
        assert rows["policy"]["success"]["mean"] == 1
        assert rows["policy"]["spearman"]["mean"] > 0.9
        assert rows["policy"]["deviation"]["mean"] < 0.01
        assert abs(rows["goal only"]["spearman"]["mean"]) < 0.85
        assert rows["goal only"]["deviation"]["mean"] > 10 * rows["policy"]["deviation"]["mean"]
        assert rows["open loop"]["success"]["mean"] < 0.2
        for name in ("open loop", "open loop, mean gain"):
            assert rows[name]["error"]["mean"] > rows["policy"]["error"]["mean"]
            assert rows[name]["deviation"]["mean"] > rows["policy"]["deviation"]["mean"]

    def test_nothing_unsafe(self, found):
        for row in found["rows"].values():
            for kind in ("states_outside", "actions_not_finite", "actions_over_limit"):
                assert row[kind] == 0

    def test_a_label_belongs_to_a_scene(self, found):
        for name, row in found["rows"].items():
            assert ("error" in row) == ("spearman" in row) == (name != "policy, goal moved")

    def test_stage_2_shakes_little_more_than_the_controller(self, found):
        """Measured: 1.03 times its jerk over 60 scenes."""
        rows = found["rows"]
        assert rows["policy"]["jerk"]["mean"] < 1.3 * rows["feedback"]["jerk"]["mean"]
        for name in ("policy", "feedback"):
            turned = rows[name]["turned"]["mean"]
            assert turned == pytest.approx(rows[name]["turned_of_plan"]["mean"], rel=0.3)

    def test_deviation_is_over_the_length_of_the_first_path(self, found, seen):
        rollouts = seen[0][-1]
        shares = np.array([r.deviation.mean() / r.path.length for r in rollouts])
        expected = shares.reshape(3, 6).mean(1)
        assert found["rows"]["policy"]["deviation"]["mean"] == pytest.approx(expected.mean())

    def test_nothing_is_touched_where_nothing_is(self, found):
        for row in found["rows"].values():
            assert row["contacts"] == row["touching"] == 0

    def test_reproducible(self, modulator, found):
        again = evaluate_execution(modulator, SMALL)
        assert again["rows"] == found["rows"]

    def test_other_seeds_are_other_scenes(self, modulator, monkeypatch):
        monkeypatch.setattr(execution, "ROWS", {"policy": ROWS["policy"]})
        rows = [
            evaluate_execution(modulator, ExecutionConfig(scenes=1, rollouts=3, seed=seed))["rows"]
            for seed in (1, 2)
        ]
        assert rows[0] != rows[1]


def test_past_obstacles(modulator):
    config = ExecutionConfig(scenes=2, regime="obstacles", rollouts=6, seed=1)
    rows = evaluate_execution(modulator, config)["rows"]
    for row in rows.values():
        assert 0 <= row["touching"] <= min(6, row["contacts"])
    assert rows["feedback"]["contacts"] == 0


def test_scenes_that_the_robot_cannot_pass_are_counted_and_others_taken(modulator, monkeypatch):
    stream = SceneStream("evaluation", regime="obstacles", seed=1)
    shut, executed = [stream.scene(0), stream.scene(2)], []
    monkeypatch.setattr(execution, "arm_can_pass", lambda kind, scene, _: scene not in shut)
    monkeypatch.setattr(execution, "ROWS", {"policy": ROWS["policy"]})
    rollouts = execution._rollouts

    def spy(*arguments):
        executed.extend(rollouts(*arguments))
        return executed

    monkeypatch.setattr(execution, "_rollouts", spy)
    config = ExecutionConfig(scenes=2, regime="obstacles", rollouts=6, seed=1)
    found = evaluate_execution(modulator, config)
    assert found["impassable"] == 2
    scenes = list(dict.fromkeys(r.path.scene for r in executed))
    assert scenes == [stream.scene(1), stream.scene(3)]
    monkeypatch.setattr(execution, "arm_can_pass", lambda *_: False)
    with pytest.raises(InvalidSceneError, match="can pass 0 of 32 random scenes only, 2 are"):
        evaluate_execution(modulator, config)


def test_failures_that_gather_in_a_scene_widen_the_interval():
    spread, gathered = np.ones((2, 20, 10), dtype=bool)
    spread[:10, 0] = False
    gathered[0] = False
    intervals = [execution._interval(s.ravel(), s.mean(1)) for s in (spread, gathered)]
    assert intervals[1][0] < intervals[0][0]
    for low, high in intervals:
        assert low < 0.95 < high
    assert execution._interval(np.ones(200, dtype=bool), np.ones(20))[0] < 0.99


@pytest.mark.parametrize(
    "wrong",
    [{"scenes": 0}, {"rollouts": 0}, {"rollouts": 20}, {"rollouts": 6}, {"seed": -1},
     {"goals": (1, 2)}, {"regime": "rooms"}, {"regime": "all"}, {"disturbance": -0.1},
     {"disturbance": np.nan}],
    ids=str,
)  # fmt: skip
def test_bad_settings(modulator, wrong):
    with pytest.raises(InvalidInputError, match=next(iter(wrong))):
        evaluate_execution(modulator, dataclasses.replace(SMALL, **wrong))


def test_a_model_without_stage_2(modulator):
    with pytest.raises(CheckpointError, match="no stage 2"):
        evaluate_execution(Modulator(modulator.path_diffuser), SMALL)
