from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pytest
import tyro

import legibility as lg
from legibility.cli.options import flags, levels, made, read_scene, span
from legibility.errors import InvalidInputError, InvalidSceneError


@pytest.mark.parametrize(
    ("entries", "expected"),
    [
        (["0.5"], [0.5]),
        (["-1", "-.5", "1e-3"], [-1, -0.5, 0.001]),
        (["-1:1:9"], np.linspace(-1, 1, 9)),
        (["-1:1:11"], [-1, -0.8, -0.6, -0.4, -0.2, 0, 0.2, 0.4, 0.6, 0.8, 1]),
        (["1:-1:3", "0"], [1, 0, -1, 0]),
        (["0.3:0.3:1"], [0.3]),
    ],
)
def test_levels(entries, expected):
    found = levels(entries)
    np.testing.assert_array_equal(found, expected)
    assert not np.signbit(found[found == 0]).any()


@pytest.mark.parametrize(
    "entries",
    [[], [""], ["a"], ["nan"], ["inf"], ["1.01"], ["-2:1:3"], ["-1:1"], ["-1:1:0"], ["-1:1:2.5"],
     ["-1:1:3:4"], ["nan:1:3"], ["-1:1:9999999999"]],
)  # fmt: skip
def test_wrong_levels(entries):
    with pytest.raises(InvalidInputError, match="legibility must"):
        levels(entries)


@pytest.mark.parametrize(
    ("text", "expected"), [("2..6", (2, 6)), ("3", (3, 3)), (" 4..4 ", (4, 4))]
)
def test_span(text, expected):
    assert span("goals", text) == expected


@pytest.mark.parametrize(
    "text", ["", "..", "2..", "..6", "2-6", "2...6", "a", "-1..3", "2.5", "6..2", "²"]
)
def test_wrong_span(text):
    with pytest.raises(InvalidInputError, match="goals must"):
        span("goals", text)


@dataclass(frozen=True)
class Settings:
    """What to do.

    Attributes:
        size: of the thing.
        goals: least and most.
        widths: of its parts.
        weight: of it, if any.
        kind: of thing.
    """

    size: int = 3
    goals: tuple[int, int] = (2, 6)
    widths: tuple[int, ...] = (1, 2)
    weight: float | None = None
    kind: str = "plain"

    def __post_init__(self):
        if self.size > 9:
            raise InvalidInputError("size must be at most 9")


def test_flags_are_the_fields():
    parsed = tyro.cli(flags(Settings), args=[])
    assert made(Settings, parsed) == Settings()
    arguments = "--goals 3 --widths 4 5 6 --weight -0.5 --size 7"
    parsed = tyro.cli(flags(Settings), args=arguments.split())
    expected = Settings(size=7, goals=(3, 3), widths=(4, 5, 6), weight=-0.5)
    assert made(Settings, parsed) == expected


def test_flags_leave_out_what_is_given_otherwise():
    parsed = tyro.cli(flags(Settings, "kind", "size"), args=[])
    assert asdict(made(Settings, parsed, kind="other", size=5)) == asdict(Settings(5, kind="other"))


@pytest.mark.parametrize(
    ("arguments", "message"), [("--size 10", "at most 9"), ("--goals 6..2", "goals must")]
)
def test_mistakes_in_flags_are_told_in_our_words(arguments, message):
    parsed = tyro.cli(flags(Settings), args=arguments.split())
    with pytest.raises(InvalidInputError, match=message):
        made(Settings, parsed)


PLANE = "start: [0, 0.5]\ngoals: [[0.8, 0.6], [1, 0.3]]\n"
SOLID = "start: [-0.2, -0.2, 0.3]\ngoals: [[0.0, 0.1, 0.02], [0.0, -0.1, 0.02]]\n"
WIDE = lg.Observer(kind="gaussian", sigma=0.3)


@pytest.fixture
def scene_file(tmp_path):
    def write(text, name="scene.yaml"):
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return write


@pytest.mark.parametrize(
    ("text", "given", "expected"),
    [
        (PLANE, None, lg.Observer()),
        (PLANE, "dragan", lg.Observer()),
        (PLANE, "paper", lg.Observer.paper(2)),
        (SOLID, "paper", lg.Observer.paper(3)),
        (PLANE + "observer: paper\n", None, lg.Observer.paper(2)),
        (PLANE + "observer: {kind: gaussian, sigma: 0.3}\n", None, WIDE),
        (PLANE + "observer: {kind: gaussian, sigma: 0.3}\n", "dragan", lg.Observer()),
        (PLANE + "observer: paper\n", "wide", WIDE),
        (PLANE + "observer: wide\n", None, WIDE),
    ],
)  # fmt: skip
def test_observer_of_a_scene(text, given, expected, scene_file, tmp_path):
    wide = str(tmp_path / "wide.yaml")
    WIDE.save(wide)
    file = scene_file(text.replace("observer: wide", f"observer: {wide}"))
    scene, observer = read_scene(file, wide if given == "wide" else given)
    assert observer == expected
    assert scene == lg.Scene.from_dict(scene.to_dict())


def test_scene_of_json_with_an_observer_and_obstacles(scene_file):
    text = '{"start": [0, 0.5], "goals": [[0.8, 0.6], [1, 0.3]], "observer": {"beta": 7}, '
    text += '"obstacles": [{"ball": {"center": [0.4, 0.2], "radius": 0.1}}]}'
    scene, observer = read_scene(scene_file(text, "scene.json"))
    assert observer == lg.Observer(beta=7)
    assert len(scene.obstacles) == 1


@pytest.mark.parametrize(
    ("observer", "message"),
    [
        ("someone", "observer must be dragan, paper or a file, .yaml or .json, got 'someone'"),
        ("7", "observer must be dragan, paper or a file"),
        ("nowhere.yaml", r"cannot read the observer file .*nowhere\.yaml"),
        ("{sigma: 0.3}", "a boltzmann observer has no sigma"),
        ("{kind: gaussian, sigma: 0}", "sigma must be"),
        ("{who: me}", "unknown: who"),
        ("{prior: [1, 2, 3]}", "prior must be 2 numbers"),
        ("{kind: gaussian, viewpoint: [0, 0, 1]}", "viewpoint must be 2 numbers"),
        ("{kind: gaussian, viewpoint: [0.9, 0.45]}", "viewpoint must not lie in the middle"),
    ],
)
def test_wrong_observer_of_a_scene(observer, message, scene_file):
    file = scene_file(f"{PLANE}observer: {observer}\n")
    with pytest.raises(InvalidInputError, match=message) as caught:
        read_scene(file)
    assert str(caught.value).startswith(f"{file}: ")
    if not observer.startswith(("{", "7")):
        with pytest.raises(InvalidInputError, match=message):
            read_scene(scene_file(PLANE), observer)


@pytest.mark.parametrize(
    ("name", "text"), [("scene.txt", PLANE), ("scene.yaml", "observer: paper\n"), ("s.yaml", "")]
)
def test_wrong_scene(name, text, scene_file):
    with pytest.raises(InvalidSceneError):
        read_scene(scene_file(text, name))


_EXAMPLES = sorted(Path(__file__).parents[2].glob("examples/*.yaml"))


@pytest.mark.parametrize("file", [file for file in _EXAMPLES if "start" in file.read_text()])
def test_examples(file):
    scene, observer = read_scene(file)
    assert observer == lg.Observer()
    assert scene.feasible(np.stack([scene.start, scene.goals[0]]), 0)
