"""A dataset is the same bytes however it was made, flat along ℓ, and refuses to be read in part."""

import dataclasses
import hashlib
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import legibility as lg
from legibility.curves import NUM_WAYPOINTS, arc_length, path_curve
from legibility.data import dataset
from legibility.data.configuration import DatasetConfig
from legibility.data.dataset import LABEL_KNOTS, Dataset, generate, shard_names
from legibility.errors import DatasetError, InvalidInputError, OutputError
from legibility.intent.metrics import SCORE_POINTS

SOURCE = str(Path(lg.__file__).parents[1])
TINY = DatasetConfig(scenes=6, views=2, cells=6, per_scene=9, candidates=4096)
"""Two shards where a shard is four scenes."""
SCRIPT = """
import json, sys
from legibility.data import dataset
dataset.SHARD = 4
config = dataset.DatasetConfig.from_dict(json.loads(sys.argv[2]))
dataset.generate(config, sys.argv[1])
"""
SHARDS = ["train-00000.parquet", "train-00001.parquet"]


def hashes(folder):
    """Of every file; what a killed process left half-written is hidden."""
    return {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.iterdir())
        if not path.name.startswith(".")
    }


@pytest.fixture
def small_shards(monkeypatch):
    monkeypatch.setattr(dataset, "SHARD", 4)


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """`TINY`, whole, in two shards."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(dataset, "SHARD", 4)
        folder = tmp_path_factory.mktemp("data") / "tiny"
        generate(TINY, folder)
    return folder


@pytest.fixture
def copy(tiny, tmp_path, small_shards):
    """A copy of `tiny` to spoil."""
    for path in tiny.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    return tmp_path


@pytest.fixture(
    scope="module",
    params=[(2, "anchored", "dragan"), (2, "rank", "paper"), (3, "anchored", "all")],
    ids=str,
)
def data(request, tmp_path_factory):
    dim, label, regime = request.param
    config = DatasetConfig(
        dim=dim, scenes=3, views=2, cells=20 if dim == 2 else 9, per_scene=65, regime=regime,
        candidates=16_384, observer=lg.Observer(label=label), seed=4,
    )  # fmt: skip
    return generate(config, tmp_path_factory.mktemp("data"))


@pytest.fixture(scope="module")
def archives(data):
    """That of each row of `data`."""
    config = data.config
    found = [
        config.archive(i, config.observer, cells=config.cells, max_candidates=config.candidates)
        for i in range(config.scenes)
    ]
    return [
        found[row // config.views].seen_by(observer) for row, observer in enumerate(data.observers)
    ]


def spoil_manifest(folder, **changes):
    path = folder / "manifest.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))


class TestSameBytes:
    def test_for_one_worker_and_two(self, tiny, tmp_path, small_shards):
        generate(TINY, tmp_path, workers=2)
        assert list(hashes(tmp_path)) == ["manifest.json", *SHARDS]
        assert hashes(tmp_path) == hashes(tiny)

    def test_for_any_number_of_threads(self, tiny, tmp_path):
        for threads in ("1", "2"):
            folder = tmp_path / threads
            environment = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), threads)
            subprocess.run(
                [sys.executable, "-c", SCRIPT, str(folder), json.dumps(TINY.to_dict())],
                env={**os.environ, "PYTHONPATH": SOURCE, **environment},
                check=True,
            )
            assert hashes(folder) == hashes(tiny)

    @pytest.mark.parametrize("lost", [[0], [1], [0, 1]])
    def test_after_shards_were_not_reached(self, copy, tiny, lost):
        for number in lost:
            (copy / SHARDS[number]).unlink()
        manifest = json.loads((tiny / "manifest.json").read_text())
        begun = {key: manifest[key] for key in ("format", "config")}
        (copy / "manifest.json").write_text(json.dumps({**begun, "complete": False}))
        with pytest.raises(DatasetError, match="not complete"):
            Dataset.load(copy)
        done = []
        generate(TINY, copy, progress=lambda *count: done.append(count))
        assert done == [(2 - k, 2) for k in range(len(lost), -1, -1)]
        assert hashes(copy) == hashes(tiny)

    @pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="no SIGKILL on this system")
    def test_after_a_kill_in_the_middle_of_a_shard(self, tiny, tmp_path, small_shards):
        kill = """
import os, signal
from legibility import files
from legibility.data import shards
def half(path, content):
    if "00001" not in path.name:
        return files.write_bytes(path, content)
    with files.atomic_path(path) as temporary:
        temporary.write_bytes(content[: len(content) // 2])
        os.kill(os.getpid(), signal.SIGKILL)
shards.write_bytes = half
"""
        folder = tmp_path / "killed"
        run = subprocess.run(
            [sys.executable, "-c", kill + SCRIPT, str(folder), json.dumps(TINY.to_dict())],
            env={**os.environ, "PYTHONPATH": SOURCE},
            capture_output=True,
            text=True,
        )
        assert run.returncode == -signal.SIGKILL, run.stderr
        assert list(hashes(folder)) == ["manifest.json", "train-00000.parquet"]
        with pytest.raises(DatasetError, match="not complete"):
            Dataset.load(folder)
        generate(TINY, folder)
        assert hashes(folder) == hashes(tiny)

    def test_when_it_was_complete_nothing_is_written(self, copy, tiny):
        before = {path.name: path.stat().st_mtime_ns for path in copy.iterdir()}
        generate(TINY, copy)
        assert {path.name: path.stat().st_mtime_ns for path in copy.iterdir()} == before

    @pytest.mark.parametrize(
        "change", [lambda file: file.unlink(), lambda file: file.write_bytes(b"x")]
    )
    def test_a_complete_one_that_was_damaged_is_repaired(self, copy, tiny, change):
        change(copy / SHARDS[1])
        with pytest.raises(DatasetError, match="missing or not as it was written"):
            Dataset.load(copy)
        generate(TINY, copy)
        assert hashes(copy) == hashes(tiny)

    def test_shards_left_by_another_configuration_are_not_taken_over(self, copy, tmp_path_factory):
        (copy / "manifest.json").unlink()
        other = dataclasses.replace(TINY, seed=1)
        fresh = tmp_path_factory.mktemp("fresh")
        generate(other, copy)
        generate(other, fresh)
        assert hashes(copy) == hashes(fresh)

    def test_damaged_shard_of_an_interrupted_run_is_made_again(self, copy, tiny):
        spoil_manifest(copy, complete=False)
        shard = copy / SHARDS[0]
        content = bytearray(shard.read_bytes())
        content[len(content) // 3] ^= 255
        shard.write_bytes(content)
        generate(TINY, copy)
        assert hashes(copy) == hashes(tiny)


class TestRefuses:
    @pytest.mark.parametrize(
        "change",
        [
            {"seed": 1},
            {"scenes": 7},
            {"stream": "validation"},
            {"efficiency": 0.2},
            {"regime": "all"},
            {"views": 1},
            {"candidates": 5000},
        ],
    )
    @pytest.mark.parametrize("complete", [True, False])
    def test_a_folder_of_another_configuration(self, copy, change, complete):
        spoil_manifest(copy, complete=complete)
        before = hashes(copy)
        with pytest.raises(DatasetError, match="another configuration"):
            generate(dataclasses.replace(TINY, **change), copy)
        assert hashes(copy) == before

    def test_a_changed_shard(self, copy):
        shard = copy / SHARDS[1]
        content = bytearray(shard.read_bytes())
        content[len(content) // 2] ^= 1
        shard.write_bytes(content)
        with pytest.raises(DatasetError, match=r"train-00001\.parquet is missing or not as it was"):
            Dataset.load(copy)

    def test_a_truncated_shard(self, copy):
        shard = copy / SHARDS[0]
        shard.write_bytes(shard.read_bytes()[:-10])
        with pytest.raises(DatasetError, match=r"train-00000\.parquet is missing or not as it was"):
            Dataset.load(copy)

    def test_a_missing_shard(self, copy):
        (copy / SHARDS[1]).unlink()
        with pytest.raises(DatasetError, match=r"train-00001\.parquet is missing"):
            Dataset.load(copy)

    def test_folders_without_a_dataset(self, tmp_path):
        (tmp_path / "file").write_text("not a folder")
        for folder in (tmp_path, tmp_path / "absent", tmp_path / "file"):
            with pytest.raises(DatasetError, match="cannot read the dataset manifest"):
                Dataset.load(folder)

    @pytest.mark.parametrize(
        "text", ["", "{", "[]", "null", '"text"', "{}", '{"format": 1}', '{"format": 99}', "\xff"]
    )
    def test_a_broken_manifest(self, copy, text):
        (copy / "manifest.json").write_text(text, encoding="latin-1")
        for read in (Dataset.load, lambda folder: generate(TINY, folder)):
            with pytest.raises(DatasetError):
                read(copy)

    @pytest.mark.parametrize("size", [0.2, 0.5, 0.9, 0.999])
    def test_a_truncated_manifest(self, copy, size):
        path = copy / "manifest.json"
        path.write_text(path.read_text()[: int(size * len(path.read_text())) - 1])
        with pytest.raises(DatasetError):
            Dataset.load(copy)

    @pytest.mark.parametrize(
        "change",
        [
            {"shards": []},
            {"shards": None},
            {"shards": [{}]},
            {"config": {}},
            {"config": None},
            {"config": {**TINY.to_dict(), "speed": 1}},
            {"config": {**TINY.to_dict(), "dim": 4}},
            {"config": {**TINY.to_dict(), "goals": 3}},
            {"config": {**TINY.to_dict(), "scenes": 5}},
            {"config": {**TINY.to_dict(), "dim": 3}},
            {"config": {**TINY.to_dict(), "per_scene": 8}},
            {"config": {**TINY.to_dict(), "views": 3}},
            {"config": {**TINY.to_dict(), "regime": "home"}},
        ],
        ids=str,
    )
    def test_a_manifest_that_lies(self, copy, change):
        spoil_manifest(copy, **change)
        with pytest.raises(DatasetError):
            Dataset.load(copy)

    def test_a_folder_that_cannot_be_written(self, tmp_path):
        (tmp_path / "file").write_text("in the way")
        for folder in (tmp_path / "file", tmp_path / "file" / "below"):
            with pytest.raises(OutputError, match="cannot write"):
                generate(TINY, folder)
        assert [path.name for path in tmp_path.iterdir()] == ["file"]

    @pytest.mark.parametrize("workers", [0, -1, 1.5, "2", True])
    def test_workers(self, tmp_path, workers):
        with pytest.raises(InvalidInputError, match="workers"):
            generate(TINY, tmp_path / "data", workers=workers)
        assert not (tmp_path / "data").exists()


def test_shard_names():
    names = shard_names(DatasetConfig(scenes=129, stream="validation"))
    assert names == [f"validation-0000{i}.parquet" for i in range(3)]


class TestContent:
    def test_shapes(self, data):
        config = data.config
        size, num, dim = config.scenes * config.views, config.per_scene, config.dim
        assert len(data.scenes) == len(data.observers) == size
        assert data.controls.shape == (size, num, 4, dim)
        assert data.waypoints.shape == (size, num, NUM_WAYPOINTS, dim)
        assert data.scores.shape == data.labels.shape == (size, num)
        assert data.score_at_label.shape == (size, len(LABEL_KNOTS))
        assert data.controls.dtype == data.waypoints.dtype == data.labels.dtype == np.float32
        for values in data.summary.values():
            assert values.shape == (size,)

    def test_views_share_the_scene_and_the_archive(self, data, archives):
        for row, (scene, observer, archive) in enumerate(
            zip(data.scenes, data.observers, archives, strict=True)
        ):
            index, view = divmod(row, data.config.views)
            assert scene is data.scenes[index * data.config.views]
            assert scene == data.config.scene(index)
            assert observer == data.config.observer_of(index, scene, data.config.observer, view)
            found = {name: values[row] for name, values in data.summary.items()}
            assert found == {
                "elites": len(archive),
                "candidates": archive.num_candidates,
                "coverage": archive.coverage,
                "anchor_score": archive.anchor_score,
            }
            np.testing.assert_array_equal(data.score_at_label[row], archive.score_of(LABEL_KNOTS))

    def curves(self, data, row):
        scene, waypoints = data.scenes[row], data.waypoints[row].astype(np.float64)
        ends = [np.tile(end, (len(waypoints), 1, 1)) for end in (scene.start, scene.goals[0])]
        return path_curve(np.concatenate([ends[0], waypoints, ends[1]], axis=1), SCORE_POINTS)

    def test_labels_are_those_of_the_curve_through_the_waypoints(self, data, archives):
        for row, (scene, observer) in enumerate(zip(data.scenes, data.observers, strict=True)):
            scores = observer.score(self.curves(data, row), scene, 0)
            np.testing.assert_allclose(data.scores[row], scores, rtol=1e-3, atol=1e-5)
            knots = LABEL_KNOTS, data.score_at_label[row]
            spans = np.diff(knots[1]) > 1e-4 * np.abs(knots[1][:-1])
            if spans.all():  # elsewhere float32 is too coarse for the label
                labels = archives[row].label_of(scores)
                np.testing.assert_allclose(data.labels[row], labels, atol=0.02)

    def test_curves_keep_clear_of_everything(self, data):
        for row, scene in enumerate(data.scenes):
            margin = scene.margin_at(self.curves(data, row), 0)
            assert (margin >= -1e-6 * scene.diagonal).all()

    def test_waypoints_lie_on_the_beziers_at_equal_arc_length(self, data):
        for row, scene in enumerate(data.scenes):
            ends = data.controls[row][:, [0, -1]]
            wanted = np.stack([scene.start, scene.goals[0]])
            np.testing.assert_allclose(ends, np.tile(wanted, (len(ends), 1, 1)), rtol=1e-6)
            dense = dataset.bezier_trajectories(data.controls[row].astype(np.float64), 2001)
            at = np.linspace(0, 2000, NUM_WAYPOINTS + 2).round().astype(int)[1:-1]
            gaps = np.linalg.norm(dense[:, at] - data.waypoints[row], axis=-1)
            assert (gaps.max(1) < 0.002 * arc_length(dense)).all()

    def test_labels_are_flat(self, data):
        wanted = np.linspace(-1, 1, data.config.per_scene)
        assert np.abs(data.labels - wanted).mean() < 0.03
        shares = np.histogram(data.labels, bins=8, range=(-1, 1))[0] / data.labels.size
        assert (np.abs(shares - 1 / 8) < 0.06).all()  # a thin side has few labels

    def test_level_zero_is_the_straight_line_where_it_is_free(self, data, archives):
        if data.config.observer.label == "rank":
            return  # its ℓ = 0 is the median
        middle = data.config.per_scene // 2
        for row, scene in enumerate(data.scenes):
            if archives[row].blocked:
                continue
            curve = self.curves(data, row)[middle]
            assert arc_length(curve) < 1.01 * np.linalg.norm(scene.goals[0] - scene.start)

    def test_another_set_has_another_digest(self, tiny, tmp_path):
        other = generate(dataclasses.replace(TINY, scenes=1, seed=9), tmp_path)
        assert other.digest != Dataset.load(tiny).digest


class TestFirst:
    def test_is_the_dataset_of_as_many_scenes(self, tiny, tmp_path, small_shards):
        found = Dataset.load(tiny).first(2)
        whole = generate(dataclasses.replace(TINY, scenes=2), tmp_path)
        assert (found.config, found.scenes, found.observers) == (
            whole.config, whole.scenes, whole.observers
        )  # fmt: skip
        for field in dataclasses.fields(Dataset)[4:-1]:
            np.testing.assert_array_equal(getattr(found, field.name), getattr(whole, field.name))
        assert found.summary.keys() == whole.summary.keys()
        for name, values in found.summary.items():
            np.testing.assert_array_equal(values, whole.summary[name])

    def test_digest_says_so(self, tiny):
        whole = Dataset.load(tiny)
        assert whole.first(2).digest == f"{whole.digest}[:2]"
        assert whole.first(6) is whole

    def test_refuses(self, tiny):
        with pytest.raises(InvalidInputError, match="the data have 6 scenes, 7 are asked"):
            Dataset.load(tiny).first(7)
        with pytest.raises(InvalidInputError, match="scenes must be an integer of at least 1"):
            Dataset.load(tiny).first(0)
