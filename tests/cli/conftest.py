import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from legibility.cli import main

TINY = (
    "--scenes 4 --per-scene 4 --dropout 0 --warmup 1 --validate-every 10 --checkpoint-every 10"
    " --channels 8 16 --condition 16 --encoder-width 8 --resolution 16"
)
"""Training of a model that learns nothing, in no time."""

DATA = (
    "--scenes 4 --goals 2..3 --per-scene 17 --cells 8 --candidates 4096 --regime observers"
    " --views 2"
)
"""Settings of a dataset that is made in no time."""

SCENE = "start: [0.0, 0.5]\ngoals: [[0.8, 0.6], [1.0, 0.3]]\n"
SCENE_3D = "start: [-0.2, -0.2, 0.3]\ngoals: [[0.0, 0.1, 0.02], [0.0, -0.1, 0.02]]\n"


def call(words: str, *more: object) -> int:
    """The exit status of `legibility` with `words` and `more`."""
    return main([*words.split(), *map(str, more)])


@pytest.fixture(scope="session")
def cli() -> Callable[..., int]:
    return call


@pytest.fixture
def tiny() -> str:
    return TINY


@pytest.fixture(scope="session")
def data_flags() -> str:
    return DATA


@pytest.fixture(scope="session")
def one_thread() -> Iterator[None]:
    """Networks this small run slower on several threads, most of all on a busy machine."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="session")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cli") / "data"
    assert call(f"data {DATA} --out", folder) == 0
    return folder


@pytest.fixture(scope="session")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset with demonstrations."""
    folder = tmp_path_factory.mktemp("cli") / "shown"
    assert call(f"data {DATA} --views 1 --demonstrations 2 --out", folder) == 0
    return folder


@pytest.fixture(scope="session")
def run(dataset: Path, tmp_path_factory: pytest.TempPathFactory, one_thread: None) -> Path:
    """The folder of a training that has ended, with its report beside it."""
    folder = tmp_path_factory.mktemp("cli") / "run"
    paths = ["--data", dataset, "--validation", dataset, "--out", folder]
    report = ["--json", folder.with_suffix(".json")]
    assert call(f"train path --steps 20 {TINY}", *paths, *report) == 0
    return folder


@pytest.fixture(scope="session")
def weights(run: Path) -> str:
    """A model as it is given to `--model`."""
    return str(run / "weights")


@pytest.fixture(scope="session")
def executable(
    run: Path, dataset: Path, shown: Path, tmp_path_factory: pytest.TempPathFactory
) -> str:
    """A model with both stages as it is given to `--model`."""
    folder = tmp_path_factory.mktemp("cli")
    weights = shutil.copytree(run / "weights", folder / "both")
    words = (
        "train policy --steps 20 --batch 16 --warmup 1 --validate-every 20 --checkpoint-every 20"
        " --channels 8 16 --condition 16"
    )
    paths = ["--data", shown, "--validation", dataset, "--out", folder / "policy"]
    assert call(words, *paths, "--weights", weights) == 0
    return str(weights)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working directory but for scene.yaml and solid.yaml."""
    (tmp_path / "scene.yaml").write_text(SCENE)
    (tmp_path / "solid.yaml").write_text(SCENE_3D)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def refused(here: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Run a command that must fail: status 2, one line, and no file more or other than before."""

    def files() -> dict[str, int]:
        paths = list(here.rglob("*"))
        return {str(path): path.stat().st_mtime_ns if path.is_file() else 0 for path in paths}

    def check(words: str, *more: object) -> str:
        before = files()
        status = call(words, *more)
        output = capsys.readouterr()
        assert (status, output.out) == (2, "")
        assert output.err.startswith("legibility: error: ")
        assert output.err.endswith("\n")
        assert output.err.count("\n") == 1
        assert files() == before
        return output.err

    return check
