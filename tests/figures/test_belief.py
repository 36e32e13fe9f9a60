"""Whose belief is shown, and what it is called."""

import numpy as np
import pytest
from pictures import SCENES, path_of, rollout_of, small_archive

import legibility as lg
from legibility.figures.belief import DRAGAN, describe, readers
from legibility.figures.film import execution_figure
from legibility.figures.paper import plan_figure


@pytest.fixture
def drawn(monkeypatch, tmp_path):
    """The text of a figure, by lines."""
    from matplotlib.figure import Figure
    from matplotlib.text import Text

    def draw(function, content):
        seen = []
        save = Figure.savefig
        with monkeypatch.context() as patch:
            patch.setattr(
                Figure, "savefig", lambda self, *a, **k: seen.append(self) or save(self, *a, **k)
            )
            function(content, tmp_path / "drawn.png")
        texts = [text.get_text() for text in seen[0].findobj(Text)]
        return [" ".join(text.split()) for text in texts if text]

    return draw


SCENE = SCENES[2]
SIZE = SCENE.size
OTHERS = {
    "gaussian, uniform, σ = 0.15 m": lg.Observer.paper(2),
    f"gaussian, neutral, σ = {0.15 * SIZE:.3g} m": lg.Observer(kind="gaussian"),
    "gaussian, prior 1 : 3, σ = 0.2 m": lg.Observer(kind="gaussian", prior=(1, 3), sigma=0.2),
    "gaussian, neutral, σ = 0.1 m, seen from (0, −1), depth 2": lg.Observer(
        kind="gaussian", sigma=0.1, viewpoint=(0, -1), depth=2
    ),
    "boltzmann, neutral, β = 10 m⁻¹": lg.Observer(beta=10),
    f"boltzmann, uniform, β = {20 / SIZE:.3g} m⁻¹": lg.Observer(prior="uniform"),
}


@pytest.mark.parametrize(("text", "observer"), OTHERS.items(), ids=OTHERS)
def test_another_observer_is_shown_beside_dragans(text, observer):
    found = describe(SCENE, observer)
    assert " ".join(found.split()) == text
    first, second = readers(SCENE, observer)
    assert (first.observer, first.title) == (lg.Observer(), DRAGAN)
    assert second.observer == observer
    assert second.title == f"the observer the dial is turned for ({found})"


@pytest.mark.parametrize(
    "observer",
    [lg.Observer(), lg.Observer(alpha=1, detour=2, label="rank"), lg.Observer(beta=20 / SIZE)],
    ids=["default", "other labels", "the same β"],
)
def test_who_reads_as_dragans_observer_is_not_shown_twice(observer):
    assert [reader.title for reader in readers(SCENE, observer)] == [DRAGAN]
    assert describe(SCENE, observer) == DRAGAN


@pytest.fixture(scope="module")
def rollout():
    archive = small_archive(2, 1).seen_by(lg.Observer.paper(2))
    path = path_of(archive, 0.5)
    return rollout_of(path, path.trajectory(13))


def test_beliefs_of_a_rollout(rollout):
    dragan, dial = (reader.belief(rollout) for reader in readers(SCENE, rollout.path.observer))
    np.testing.assert_allclose(
        dragan[0], lg.metrics.dragan_posterior(rollout.states, SCENE.goals, 20 / SIZE)
    )
    np.testing.assert_array_equal(dial[0], rollout.posterior)
    assert dial[1] == rollout.time_to_confidence
    assert dragan[0][0] == pytest.approx(0.5)


def test_figures_say_whose_belief_is_which(rollout, drawn):
    whose = "belief of the observer the dial is turned for (gaussian, uniform, σ = 0.15 m)"
    text = drawn(plan_figure, path_of(rollout.path.archive, [-1, 0, 1]))
    assert {"belief of Dragan’s observer", whose} <= set(text)
    assert any(line.endswith("of the dial’s observer") for line in text)
    text = drawn(execution_figure, [rollout])
    assert {"belief of Dragan’s observer", "belief of the dial’s observer"} <= set(text)
    assert any("observer the dial is turned for (gaussian, uniform, σ = 0.15 m)" in t for t in text)
    assert sum(line.startswith("confident") or line == "never confident" for line in text) == 2


def test_one_belief_where_the_dial_is_turned_for_dragans_observer(drawn):
    text = drawn(plan_figure, path_of(small_archive(2, 0), [-1, 1]))
    assert sum("belief" in line for line in text) == 1
    assert "belief $P(g^*|x_t)$ of Dragan’s observer" in text
    assert any(line.endswith("of Dragan’s observer") and "potential" in line for line in text)
