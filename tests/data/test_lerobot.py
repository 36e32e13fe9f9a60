"""A folder of LeRobot has the published layout, and what others recorded in one is read."""

import json
import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from legibility.data.configuration import DatasetConfig, DemonstrationsConfig
from legibility.data.dataset import Dataset, generate
from legibility.data.demonstrations import Demonstrations, demonstrate
from legibility.data.lerobot import read_lerobot, write_lerobot
from legibility.data.recorded import RecordedPaths, read_scenes
from legibility.data.recordings import read_recordings
from legibility.errors import DatasetError, InvalidInputError
from legibility.scene import Scene

SOURCE = DatasetConfig(
    scenes=3, views=2, cells=6, per_scene=9, candidates=4096, regime="observers", goals=(2, 4)
)

# The published schema of LeRobotDataset v3.0: keys of meta/info.json, features that every dataset
# has, columns of meta/episodes, and statistics of a feature.
INFO = {
    "codebase_version": str, "robot_type": str, "total_episodes": int, "total_frames": int,
    "total_tasks": int, "chunks_size": int, "data_files_size_in_mb": int,
    "video_files_size_in_mb": int, "fps": int, "splits": dict, "data_path": str,
    "video_path": type(None), "features": dict,
}  # fmt: skip
COMMON = {
    "timestamp": "float32", "frame_index": "int64", "episode_index": "int64", "index": "int64",
    "task_index": "int64",
}  # fmt: skip
EPISODES = [
    "episode_index", "tasks", "length", "data/chunk_index", "data/file_index",
    "dataset_from_index", "dataset_to_index", "meta/episodes/chunk_index",
    "meta/episodes/file_index",
]  # fmt: skip
STATISTICS = {"min", "max", "mean", "std", "count", "q01", "q10", "q50", "q90", "q99"}
FILES = [
    "data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet",
    "meta/info.json", "meta/scenes.json", "meta/stats.json", "meta/tasks.parquet",
]  # fmt: skip


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """A dataset with demonstrations."""
    folder = tmp_path_factory.mktemp("source")
    generate(SOURCE, folder)
    demonstrate(folder, DemonstrationsConfig(demonstrations=2, pushed=0.5))
    return folder


@pytest.fixture(scope="module")
def shown(source):
    return Demonstrations.load(source)


@pytest.fixture(scope="module")
def written(source, shown, tmp_path_factory):
    folder = tmp_path_factory.mktemp("lerobot")
    write_lerobot(Dataset.load(source), shown, folder)
    return folder


@pytest.fixture
def copy(written, tmp_path):
    return shutil.copytree(written, tmp_path / "copy")


def information(folder):
    return json.loads((folder / "meta/info.json").read_text())


def change(folder, **keys):
    (folder / "meta/info.json").write_text(json.dumps({**information(folder), **keys}))


class TestLayout:
    def test_files(self, written):
        files = sorted(p.relative_to(written).as_posix() for p in written.rglob("*") if p.is_file())
        assert files == FILES

    def test_information(self, written, shown):
        info = information(written)
        assert {key: type(value) for key, value in info.items()} == INFO
        assert info["codebase_version"] == "v3.0"
        assert (info["total_episodes"], info["fps"]) == (len(shown), 20)
        assert info["total_frames"] == sum(map(len, shown.states))
        assert info["splits"] == {"train": f"0:{len(shown)}"}
        place = info["data_path"].format(chunk_index=0, file_index=0)
        assert place == FILES[0]
        features = info["features"]
        for name, entry in features.items():
            assert "/" not in name
            assert set(entry) == {"dtype", "shape", "names"}
            assert entry["names"] is None or [len(entry["names"])] == entry["shape"]
        for name, dtype in COMMON.items():
            assert features[name] == {"dtype": dtype, "shape": [1], "names": None}
        assert features["observation.state"]["names"] == ["x", "y"]
        assert features["action"]["shape"] == [2]
        most = max(scene.num_goals for scene in map(SOURCE.scene, range(3)))
        assert features["observation.environment_state"]["shape"] == [2 * most + 1]
        assert features["path"]["shape"] == [20]

    def test_frames(self, written, shown):
        table = pq.read_table(written / FILES[0])
        features = information(written)["features"]
        assert set(table.column_names) == set(features)
        for name, entry in features.items():
            kind = pa.from_numpy_dtype(np.dtype(entry["dtype"]))
            (size,) = entry["shape"]
            assert table.schema.field(name).type == (kind if size == 1 else pa.list_(kind, size))
        content = {name: np.array(table[name].to_pylist()) for name in table.column_names}
        lengths = [len(states) for states in shown.states]
        np.testing.assert_array_equal(content["index"], np.arange(sum(lengths)))
        frames = np.concatenate([np.arange(n) for n in lengths])
        np.testing.assert_array_equal(content["frame_index"], frames)
        np.testing.assert_allclose(content["timestamp"], frames / 20, rtol=1e-6)
        scenes = [
            Scene.from_dict(s) for s in json.loads((written / "meta/scenes.json").read_text())
        ]
        for number, rows in enumerate(np.split(np.arange(sum(lengths)), np.cumsum(lengths)[:-1])):
            assert (content["episode_index"][rows] == number).all()
            np.testing.assert_allclose(content["action"][rows[:-1]], shown.actions[number])
            assert not content["action"][rows[-1]].any()
            np.testing.assert_allclose(content["path"][rows[0]], shown.paths[number].ravel())
            assert (content["legibility"][rows] == shown.labels[number]).all()
            scene = scenes[shown.scenes[number]]
            goals = content["observation.environment_state"][rows[0]]
            assert goals[-1] == shown.labels[number]
            goals = goals[:-1].reshape(-1, 2)
            np.testing.assert_allclose(goals[: scene.num_goals], scene.goals, rtol=1e-6)
            np.testing.assert_array_equal(
                goals[scene.num_goals :],
                np.tile(goals[scene.num_goals - 1], (len(goals) - scene.num_goals, 1)),
            )
            np.testing.assert_allclose(shown.paths[number][0], scene.start, atol=1e-6)

    def test_episodes(self, written, shown):
        table = pq.read_table(written / FILES[1])
        columns = [name for name in table.column_names if not name.startswith("stats/")]
        assert columns == EPISODES
        lengths = [len(states) for states in shown.states]
        assert table["length"].to_pylist() == lengths
        assert table["dataset_to_index"].to_pylist() == np.cumsum(lengths).tolist()
        assert table["dataset_from_index"].to_pylist() == [0, *np.cumsum(lengths)[:-1].tolist()]
        assert table["tasks"].to_pylist() == [[f"reach goal 0 in scene {s}"] for s in shown.scenes]
        found = {name: np.array(table[name].to_pylist()) for name in table.column_names[7:-2]}
        for name in ("observation.state", "legibility"):
            assert {key for key in STATISTICS if f"stats/{name}/{key}" in found} == STATISTICS
        for number, states in enumerate(shown.states):
            for key, value in (("min", states.min(0)), ("mean", states.mean(0)),
                               ("std", states.std(0)), ("q90", np.quantile(states, 0.9, axis=0)),
                               ("count", [len(states)])):  # fmt: skip
                read = found[f"stats/observation.state/{key}"][number]
                np.testing.assert_allclose(read, value, rtol=1e-4, atol=1e-6)

    def test_statistics(self, written, shown):
        statistics = json.loads((written / "meta/stats.json").read_text())
        assert set(statistics) == set(information(written)["features"])
        states = np.concatenate(shown.states)
        for entry in statistics.values():
            assert set(entry) == STATISTICS
            assert entry["count"] == [len(states)]
        found = statistics["observation.state"]
        for key, value in (
            ("max", states.max(0)),
            ("mean", states.mean(0)),
            ("std", states.std(0)),
        ):
            np.testing.assert_allclose(found[key], value, rtol=1e-5)

    def test_tasks_as_pandas_reads_them(self, written, shown):
        pandas = pytest.importorskip("pandas", reason="LeRobot's tasks are NOT TESTED")
        tasks = pandas.read_parquet(written / "meta/tasks.parquet")
        assert list(tasks.columns) == ["task_index"]
        assert tasks.index.name == "task"
        for scene in set(shown.scenes.tolist()):
            assert tasks.loc[f"reach goal 0 in scene {scene}"].task_index == scene


class TestRead:
    def test_what_was_written(self, written, shown):
        episodes = read_lerobot(written)
        assert len(episodes) == len(shown)
        for episode, states, scene in zip(episodes, shown.states, shown.scenes, strict=True):
            np.testing.assert_array_equal(episode.positions, states)
            np.testing.assert_allclose(np.diff(episode.times), 1 / 20)
            assert episode.times[0] == 0
            assert episode.task == f"reach goal 0 in scene {scene}"

    def test_several_files_in_any_order(self, copy, written):
        table = pq.read_table(copy / FILES[0])
        middle = len(table) // 2 + 1  # amid an episode
        pq.write_table(table[middle:][::-1], copy / FILES[0])
        pq.write_table(table[:middle], copy / "data/chunk-000/file-001.parquet")
        for one, other in zip(read_lerobot(copy), read_lerobot(written), strict=True):
            np.testing.assert_array_equal(one.positions, other.positions)

    @pytest.mark.parametrize(
        ("names", "axes", "chosen"),
        [
            (["y", "x"], (), [1, 0]),
            (["x", "y"], (), [0, 1]),
            (["a", "b"], (), [0, 1]),
            (["a", "b"], ("b", "a"), [1, 0]),
            (None, (), [0, 1]),
            ({"motors": ["y", "x"]}, (), [1, 0]),
            ({"y": 0, "x": 1}, (), [1, 0]),
        ],
    )
    def test_components(self, copy, written, names, axes, chosen):
        features = information(copy)["features"]
        features["observation.state"]["names"] = names
        change(copy, features=features)
        found = read_lerobot(copy, axes=axes)[0].positions
        np.testing.assert_array_equal(found, read_lerobot(written)[0].positions[:, chosen])

    def test_another_feature(self, written, shown):
        goal = ("goal_0_x", "goal_0_y")
        found = read_lerobot(written, "observation.environment_state", goal)[0].positions
        np.testing.assert_allclose(found, np.tile(shown.paths[0][-1], (len(found), 1)), rtol=1e-6)

    def test_a_version_with_the_same_first_number(self, copy, written):
        change(copy, codebase_version="v3.1")
        assert len(read_lerobot(copy)) == len(read_lerobot(written))


class TestRefuses:
    def refused(self, folder, *arguments, **keywords):
        with pytest.raises(DatasetError) as error:
            read_lerobot(folder, *arguments, **keywords)
        assert "\n" not in str(error.value)
        return str(error.value)

    @pytest.mark.parametrize("version", ["v2.1", "v2.0", "v4.0", "3"])
    def test_another_version(self, copy, version):
        change(copy, codebase_version=version)
        assert f"is of version {version} of LeRobot's format, v3.0 is read" in self.refused(copy)

    def test_no_dataset(self, tmp_path):
        for folder in (tmp_path, tmp_path / "absent"):
            message = self.refused(folder)
            assert "cannot read the information of a LeRobot dataset" in message

    @pytest.mark.parametrize("text", ["", "{", "[]", "null", "{}", '{"codebase_version": "v3.0"}'])
    def test_broken_information(self, copy, text):
        (copy / "meta/info.json").write_text(text)
        assert "is no whole LeRobot dataset" in self.refused(copy)

    def test_a_missing_feature(self, written):
        message = self.refused(written, "observation.ee")
        assert "no positions in a feature 'observation.ee': those of several numbers are" in message
        assert "observation.state, " in message

    def test_only_a_video(self, copy):
        features = information(copy)["features"]
        video = {"dtype": "video", "shape": [480, 640, 3], "names": ["height", "width", "channel"]}
        change(copy, features={name: features[name] for name in COMMON} | {"top": video})
        assert "'top' of type video: those of several numbers are none" in self.refused(copy, "top")
        assert "a feature 'observation.state': those" in self.refused(copy)

    @pytest.mark.parametrize("axes", [(), ("x",), ("goal_0_x", "goal_9_y"), ("a",) * 4])
    def test_components_that_are_not_positions(self, written, axes):
        message = self.refused(written, "observation.environment_state", axes)
        assert "must be named by axes" in message
        assert "goal_0_x, goal_0_y, " in message

    @pytest.mark.parametrize("file", [FILES[0], "meta/tasks.parquet"])
    def test_files_that_are_missing_or_damaged(self, copy, file):
        (copy / file).write_bytes((copy / file).read_bytes()[:-100])
        assert "is no whole LeRobot dataset" in self.refused(copy)
        (copy / file).unlink()
        assert "there is no" in self.refused(copy)

    def rewrite(self, folder, **columns):
        table = pq.read_table(folder / FILES[0])
        for name, values in columns.items():
            place = table.column_names.index(name)
            column = pa.array(values, table.schema.field(name).type)
            table = table.set_column(place, name, column)
        pq.write_table(table, folder / FILES[0])

    @pytest.mark.parametrize("value", [[np.nan, 0.0], [0.0, np.inf], None], ids=str)
    def test_positions_that_are_none(self, copy, value):
        values = pq.read_table(copy / FILES[0])["observation.state"].to_pylist()
        self.rewrite(copy, **{"observation.state": [*values[:3], value, *values[4:]]})
        message = self.refused(copy)
        assert "episode 0: observation.state must be finite" in message or value is None

    def test_frames_that_do_not_rise(self, copy):
        rows = pq.read_table(copy / FILES[0]).num_rows
        self.rewrite(copy, frame_index=[7] * rows)
        assert "episode 0: it needs at least 2 frames, rising" in self.refused(copy)

    def test_fewer_frames_than_it_says(self, copy):
        pq.write_table(pq.read_table(copy / FILES[0])[:-1], copy / FILES[0])
        assert "is damaged: it has" in self.refused(copy)


def test_is_recordings(written, shown):
    """Each episode is a recording, and its task names its scene of `meta/scenes.json`."""
    scenes = read_scenes(written / "meta" / "scenes.json")
    recordings = read_recordings(written, 2)
    assert len(recordings) == len(shown)
    for recording, states in zip(recordings, shown.states, strict=True):
        np.testing.assert_allclose(recording.positions, states, atol=1e-6)
    found = RecordedPaths(recordings, scenes)
    assert found.scenes == [scenes[str(i)] for i in np.unique(shown.scenes)]
    with pytest.raises(InvalidInputError, match="the motions are 2D, the scene is 3D"):
        read_recordings(written, 3)
