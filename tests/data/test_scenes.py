"""Streams of random scenes: no scene in two of them, and none that depends on other settings."""

import numpy as np
import pytest

import legibility as lg
from legibility.data.scenes import SceneStream
from legibility.errors import InvalidInputError
from legibility.seeds import STREAMS


@pytest.mark.parametrize("dim", [2, 3])
def test_streams_seeds_and_indices_never_share_a_scene(dim):
    scenes = [
        SceneStream(stream, dim, seed=seed).scene(index)
        for stream in STREAMS
        for seed in (0, 1, 2)
        for index in (0, 1, 2)
    ]
    points = {point.tobytes() for scene in scenes for point in scene.goals}
    assert len(points) == sum(scene.num_goals for scene in scenes)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_scene_depends_on_its_index_alone(dim):
    first, again = (SceneStream("train", dim, seed=7) for _ in range(2))
    scenes = [first.scene(index) for index in range(5)]
    assert [again.scene(index) for index in reversed(range(5))] == scenes[::-1]
    assert all(scene.dim == dim for scene in scenes)


def test_number_of_goals():
    numbers = [SceneStream("train", goals=(3, 4)).scene(i).num_goals for i in range(12)]
    assert set(numbers) == {3, 4}


class TestArchive:
    def test_is_of_the_scene_and_the_observer(self):
        stream, observer = SceneStream("validation", seed=1), lg.Observer(0.3, 1.0, "rank")
        archive = stream.archive(2, observer, cells=9)
        assert archive.scene == stream.scene(2)
        assert archive.observer == observer
        assert archive.field.sigma == 0.3
        assert archive.target == 0
        assert len(archive) <= 81

    def test_other_observers_read_the_same_curves(self):
        stream = SceneStream("train")
        one, other = (stream.archive(0, lg.Observer(sigma=sigma), cells=8) for sigma in (0.1, 0.3))
        np.testing.assert_array_equal(one.controls, other.controls)
        assert (one.scores != other.scores).any()

    def test_its_seed_is_of_the_index(self):
        stream, scene = SceneStream("train"), SceneStream("train").scene(0)
        ours = stream.archive(0, lg.Observer(), cells=8)
        assert not np.array_equal(ours.controls, lg.build_archive(scene, cells=8).controls)
        again = stream.archive(0, lg.Observer(), cells=8)
        np.testing.assert_array_equal(ours.controls, again.controls)


@pytest.mark.parametrize(
    "wrong",
    [
        {"stream": "test"},
        {"stream": None},
        {"dim": 4},
        {"dim": "2"},
        {"seed": -1},
        {"seed": 0.5},
        {"seed": None},
        {"goals": (1, 4)},
        {"goals": (4, 3)},
        {"goals": (2, 13)},
        {"goals": (2.5, 4)},
        {"goals": (2, 3, 4)},
        {"goals": 3},
    ],
    ids=str,
)
def test_refuses(wrong):
    with pytest.raises(InvalidInputError, match=next(iter(wrong))):
        SceneStream(**{"stream": "train", **wrong})
