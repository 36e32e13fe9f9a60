"""What is exported holds the same numbers, and stands whole or not at all."""

import json

import numpy as np
import pyarrow.csv as pc
import pytest
import torch
from safetensors import safe_open

from legibility.data.configuration import DatasetConfig, DemonstrationsConfig
from legibility.data.dataset import Dataset, generate
from legibility.data.demonstrations import Demonstrations, demonstrate
from legibility.data.export import FORMATS, export
from legibility.errors import DatasetError, InvalidInputError, OutputError

SOURCE = DatasetConfig(
    scenes=3, views=2, cells=6, per_scene=9, candidates=4096, regime="observers", goals=(2, 4)
)


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """A dataset with demonstrations."""
    folder = tmp_path_factory.mktemp("source")
    generate(SOURCE, folder)
    demonstrate(folder, DemonstrationsConfig(demonstrations=2))
    return folder


@pytest.fixture(scope="module")
def data(source):
    return Dataset.load(source)


def read(file):
    table = pc.read_csv(file)
    return {name: table[name].to_numpy() for name in table.column_names}


class TestTorch:
    def test_samples(self, data):
        samples = data.to_torch()
        assert isinstance(samples, torch.utils.data.Dataset)
        assert len(samples) == 6 * 9
        for index in (0, 10, 53, -1):
            sample = samples[index]
            row, each = divmod(index % 54, 9)
            scene = data.scenes[row]
            assert sample["row"] == row
            np.testing.assert_array_equal(sample["start"], scene.start.astype(np.float32))
            goals = scene.goals.astype(np.float32)
            np.testing.assert_array_equal(sample["goals"][sample["goal_mask"]], goals)
            assert not sample["goals"][~sample["goal_mask"]].any()
            np.testing.assert_array_equal(sample["waypoints"], data.waypoints[row, each])
            assert sample["label"] == float(data.labels[row, each])
            assert sample["score"] == float(data.scores[row, each])
        for index in (54, -55):
            with pytest.raises(IndexError, match="must be below 54"):
                samples[index]

    def test_batches(self, data):
        (batch,) = torch.utils.data.DataLoader(data.to_torch(), batch_size=54)
        assert batch["waypoints"].shape == (54, 8, 2)
        assert batch["goals"].shape == (54, *batch["goal_mask"].shape[1:], 2)
        assert batch["label"].dtype == torch.float32
        np.testing.assert_array_equal(batch["label"], data.labels.ravel())

    def test_files(self, source, data, tmp_path):
        files = export(source, "torch", tmp_path / "out")
        assert [f.name for f in files] == ["dataset.safetensors", "demonstrations.safetensors"]
        with safe_open(files[0], framework="pt") as file:
            np.testing.assert_array_equal(file.get_tensor("labels"), data.labels)
            np.testing.assert_array_equal(file.get_tensor("controls"), data.controls)
            assert file.get_tensor("goal_mask").sum() == sum(s.num_goals for s in data.scenes)
            texts = {name: json.loads(text) for name, text in file.metadata().items()}
        assert texts["config"] == data.config.to_dict()
        assert texts["scenes"] == [scene.to_dict() for scene in data.scenes]
        shown = Demonstrations.load(source)
        with safe_open(files[1], framework="np") as file:
            actions = np.split(file.get_tensor("actions"), np.cumsum(file.get_tensor("steps"))[:-1])
            np.testing.assert_array_equal(actions[1], shown.actions[1].astype(np.float32))
            np.testing.assert_array_equal(file.get_tensor("scenes"), shown.scenes)


@pytest.fixture(scope="module")
def folder(source, tmp_path_factory):
    """The CSV files of the dataset."""
    folder = tmp_path_factory.mktemp("csv") / "a" / "b"
    names = [file.name for file in export(source, "csv", folder)]
    assert names == ["demonstrations.csv", "scenes.csv", "trajectories.csv"]
    return folder


class TestCsv:
    def test_scenes(self, folder, data):
        found = read(folder / "scenes.csv")
        assert found["scene"].tolist() == [0, 0, 1, 1, 2, 2]
        assert found["view"].tolist() == [0, 1] * 3
        assert json.loads(found["scene_json"][3]) == data.scenes[3].to_dict()
        assert json.loads(found["observer_json"][5]) == data.observers[5].to_dict()
        np.testing.assert_allclose(found["coverage"], data.summary["coverage"])

    def test_trajectories(self, folder, data):
        found = read(folder / "trajectories.csv")
        assert list(found) == ["row", "trajectory", "label", "score", "point", "x", "y"]
        points = np.stack([found["x"], found["y"]], -1).reshape(6, 9, 10, 2)
        np.testing.assert_allclose(points[:, :, 1:-1], data.waypoints, rtol=1e-6)
        for row, scene in enumerate(data.scenes):
            np.testing.assert_allclose(points[row, :, 0], np.tile(scene.start, (9, 1)), rtol=1e-6)
            np.testing.assert_allclose(
                points[row, :, -1], np.tile(scene.goals[0], (9, 1)), rtol=1e-6
            )
        np.testing.assert_allclose(found["label"].reshape(6, 9, 10)[..., 0], data.labels, rtol=1e-6)
        assert found["trajectory"].reshape(6, 9, 10)[5, 8, 0] == 53

    def test_demonstrations(self, folder, source):
        shown = Demonstrations.load(source)
        found = read(folder / "demonstrations.csv")
        first = found["trajectory"] == 0
        np.testing.assert_allclose(found["x"][first], shown.states[0][:, 0], rtol=1e-6)
        np.testing.assert_allclose(np.diff(found["t"][first]), 1 / 20)
        sent = found["action_y"][first]
        np.testing.assert_allclose(sent[:-1], shown.actions[0][:, 1], rtol=1e-5)
        assert np.isnan(sent[-1])
        last = (folder / "demonstrations.csv").read_text().splitlines()[first.sum()]
        assert last.endswith(",,"), "nothing is sent in the last state"


def test_lerobot_needs_demonstrations(source, tmp_path):
    plain = tmp_path / "plain"
    generate(SOURCE, plain)
    with pytest.raises(DatasetError, match=r"plain has no demonstrations.*--demonstrations N"):
        export(plain, "lerobot", tmp_path / "out")
    assert [folder.name for folder in tmp_path.iterdir()] == ["plain"]
    names = [file.name for file in export(plain, "csv", tmp_path / "out")]
    assert names == ["scenes.csv", "trajectories.csv"]


@pytest.mark.parametrize("form", FORMATS)
class TestFolder:
    def test_is_not_written_over(self, form, source, tmp_path):
        (tmp_path / "out").mkdir()
        (tmp_path / "out" / "mine.txt").write_text("mine")
        with pytest.raises(OutputError, match="out: it is there and not empty"):
            export(source, form, tmp_path / "out")
        assert [file.name for file in tmp_path.rglob("*")] == ["out", "mine.txt"]

    def test_may_be_empty(self, form, source, tmp_path):
        for file in export(source, form, tmp_path):
            assert file.is_file()


def test_nothing_is_left_of_a_failure(source, tmp_path, monkeypatch):
    monkeypatch.setattr("legibility.data.export._write_table", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        export(source, "csv", tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_refuses(source, tmp_path):
    with pytest.raises(InvalidInputError, match="export must be one of torch, lerobot, csv, got"):
        export(source, "hdf5", tmp_path / "out")
    with pytest.raises(DatasetError, match="cannot read the dataset manifest"):
        export(tmp_path, "csv", tmp_path / "out")
    assert not list(tmp_path.iterdir())
