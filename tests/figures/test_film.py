"""Films and pictures of executed motions: complete, tidy, the same every time, or not there."""

import itertools
import os
import stat
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib import rcParams
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from pictures import SCENES, path_of, rollout_of, small_archive
from PIL import Image

from legibility.errors import InvalidInputError, OutputError
from legibility.figures import film
from legibility.figures.film import check_film, execution_figure, execution_film
from legibility.figures.scene_axes import goal_colors
from legibility.figures.style import STYLE

TARGET = 1


@pytest.fixture(scope="module")
def archives():
    return {dim: small_archive(dim, TARGET) for dim in SCENES}


@pytest.fixture
def motions(archives):
    """Rollouts of these levels that follow their paths exactly, each in another time."""

    def build(*levels, dim=2, steps=12, reason="reached"):
        archive, found = archives[dim], []
        for number, level in enumerate(levels):
            path = path_of(archive, level)
            found.append(rollout_of(path, path.trajectory(steps + number + 1), reason))
        return found

    return build


@pytest.fixture
def drawn(monkeypatch, tmp_path):
    """The figure behind a picture, with its layout settled."""

    def draw(rollouts):
        seen = []
        save = Figure.savefig
        monkeypatch.setattr(
            Figure, "savefig", lambda self, *a, **k: seen.append(self) or save(self, *a, **k)
        )
        execution_figure(rollouts, tmp_path / "drawn.png")
        seen[0].draw_without_rendering()
        return seen[0]

    return draw


def frames(file):
    with Image.open(file) as image:
        for index in range(image.n_frames):
            image.seek(index)
            yield np.asarray(image.convert("RGB")).astype(int), image.info["duration"]


def scenes_and_panels(figure):
    return figure.axes[1::2], figure.axes[::2]


LEVELS = {n: np.linspace(-1, 1, n) if n > 1 else [0.7] for n in (1, 2, 3, 5, 6, 9)}


class TestPicture:
    @pytest.mark.parametrize("number", LEVELS)
    def test_nothing_overlaps_or_is_cut_off(self, number, motions, drawn, tmp_path):
        figure = drawn(motions(*LEVELS[number]))
        scenes, panels = scenes_and_panels(figure)
        assert len(scenes) == len(panels) == number
        texts = [axes.title for axes in figure.axes] + [axes.xaxis.label for axes in panels]
        texts += [axes.yaxis.label for axes in panels] + [figure.legends[0]]
        boxes = [text.get_window_extent() for text in texts]
        boxes = [box for box in boxes if box.width > 1]
        assert len(boxes) > 2 * number
        for first, second in itertools.combinations(boxes, 2):
            assert not first.overlaps(second)
        for box in boxes:
            assert figure.bbox.x0 < box.x0 < box.x1 < figure.bbox.x1
            assert figure.bbox.y0 < box.y0 < box.y1 < figure.bbox.y1
        with Image.open(tmp_path / "drawn.png") as image:
            pixels = np.asarray(image.convert("RGB")).astype(int)
        for rim in (pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1]):
            assert (rim == 255).all()

    @pytest.mark.parametrize(("number", "rows"), [(1, [1]), (5, [5]), (6, [3, 3]), (9, [5, 4])])
    def test_rows_are_even_and_axes_aligned(self, number, rows, motions, drawn):
        scenes, panels = scenes_and_panels(drawn(motions(*LEVELS[number])))
        tops = [round(axes.get_position().y1, 6) for axes in scenes]
        assert [len(list(group)) for _, group in itertools.groupby(tops)] == rows
        for axes, panel in zip(scenes, panels, strict=True):
            above, below = axes.get_position(), panel.get_position()
            assert (above.x0, above.x1) == pytest.approx((below.x0, below.x1))
            assert above.y0 > below.y1

    def test_a_trail_has_the_colour_of_what_is_believed(self, motions, drawn):
        rollout = motions(-1)[0]
        (trail,) = [a for a in drawn([rollout]).axes[1].collections if type(a) is not LineCollection
                    and isinstance(a, LineCollection)]  # fmt: skip
        colors = np.array([to_rgb(color) for color in goal_colors(2, TARGET)])
        expected = rollout.posterior @ colors
        found = trail.get_colors()[:, :3]
        np.testing.assert_allclose(found, (expected[1:] + expected[:-1]) / 2)
        assert len(trail.get_segments()) == len(rollout.actions)

    def test_says_the_time_to_confidence(self, motions, drawn):
        rollouts = motions(-1, 1)
        early, late = rollouts[1], rollouts[0]
        never = rollout_of(late.path, late.states[:3], "lost")
        _, panels = scenes_and_panels(drawn([late, early, never]))
        times = [rollout.time_to_confidence for rollout in (late, early)]
        assert 0 < times[1] < times[0]
        expected = [f"confident after {time:.2f} s" for time in times] + ["never confident"]
        assert [panel.get_title() for panel in panels] == expected
        at_goal = rollout_of(early.path, early.states[:-3:-1])
        assert at_goal.time_to_confidence == 0
        assert drawn([at_goal]).axes[0].get_title() == "confident from the start"

    def test_time_to_confidence(self, motions):
        for rollout in motions(-1, -0.5, 0, 1):
            held = rollout.posterior[:, TARGET] >= 0.8
            step = round(rollout.time_to_confidence / rollout.step_seconds)
            assert rollout.time_to_confidence == pytest.approx(step * rollout.step_seconds)
            assert held[step:].all()
            assert step == 0 or not held[step - 1]

    def test_says_what_went_wrong(self, motions, drawn):
        figure = drawn(motions(-0.5, reason="stalled"))
        title = figure.axes[1].get_title()
        assert title.startswith(r"$\ell$ = −0.5" + "\nachieved −0.")
        assert title.endswith(", stalled")

    @pytest.mark.parametrize("suffix", [".png", ".pdf", ".svg"])
    def test_same_bytes_whatever_the_users_style(self, suffix, motions, tmp_path, monkeypatch):
        for name in ("first", "second"):
            execution_figure(motions(-1, 1), tmp_path / f"{name}{suffix}")
            monkeypatch.setitem(rcParams, "lines.linewidth", 9)
        first, second = (tmp_path / f"{name}{suffix}" for name in ("first", "second"))
        assert first.read_bytes() == second.read_bytes()


class TestFilm:
    def test_a_frame_a_step_and_a_rest(self, motions, tmp_path):
        rollouts = motions(-1, 0, 1)
        execution_film(rollouts, tmp_path / "f.gif")
        found = list(frames(tmp_path / "f.gif"))
        assert len(found) == max(len(r.actions) for r in rollouts) + 1
        assert [duration for _, duration in found] == [50] * (len(found) - 1) + [1550]
        with Image.open(tmp_path / "f.gif") as image:
            assert image.info["loop"] == 0
        ink = [(np.ptp(pixels, axis=-1) > 60).sum() for pixels, _ in found]
        assert (np.diff(ink) > 0).all()
        assert all((pixels[0] == 255).all() for pixels, _ in found)

    def test_ends_as_the_picture_shows_it(self, motions, tmp_path, monkeypatch):
        monkeypatch.setitem(film._DPI, ".gif", 100)
        monkeypatch.setitem(STYLE, "savefig.dpi", 100)
        rollouts = motions(-1, 1)
        execution_film(rollouts, tmp_path / "f.gif")
        execution_figure(rollouts, tmp_path / "f.png")
        *_, (last, _) = frames(tmp_path / "f.gif")
        with Image.open(tmp_path / "f.png") as image:
            picture = np.asarray(image.convert("RGB")).astype(int)
        assert last.shape == picture.shape
        assert (np.abs(last - picture).max(-1) > 40).mean() < 0.002
        assert np.abs(last - picture).mean() < 1

    def test_the_goals_keep_their_colours(self, motions, tmp_path):
        execution_film(motions(-1, 1), tmp_path / "f.gif")
        for pixels, _ in frames(tmp_path / "f.gif"):
            for color in goal_colors(2, TARGET):
                exact = np.round(255 * np.array(to_rgb(color)))
                assert (pixels == exact).all(-1).sum() > 50

    def test_three_dimensions(self, motions, tmp_path):
        rollouts = motions(-1, 1, dim=3)
        with np.errstate(all="raise"):
            execution_figure(rollouts, tmp_path / "f.png")
            execution_film(rollouts, tmp_path / "f.gif")
        found = [(np.ptp(pixels, axis=-1) > 60).sum() for pixels, _ in frames(tmp_path / "f.gif")]
        assert found[-1] > found[0] + 100

    def test_same_bytes(self, motions, tmp_path):
        for name in ("first", "second"):
            execution_film(motions(-1, 0.5), tmp_path / f"{name}.gif")
        assert (tmp_path / "first.gif").read_bytes() == (tmp_path / "second.gif").read_bytes()

    def test_progress(self, motions, tmp_path):
        seen = []
        rollouts = motions(0)
        total = len(rollouts[0].actions) + 1
        execution_film(rollouts, tmp_path / "f.gif", progress=lambda *count: seen.append(count))
        assert seen == [(done, total) for done in range(total)]

    def test_no_global_state(self, motions, tmp_path, monkeypatch):
        monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)  # importing it now fails
        before = {name: rcParams[name] for name in set(rcParams) - {"backend"}}
        execution_film(motions(0), tmp_path / "f.gif")
        assert {name: rcParams[name] for name in before} == before


@pytest.fixture
def encoder(tmp_path, monkeypatch):
    """Puts a program of this text in ffmpeg's place."""

    def install(text):
        folder = tmp_path / "bin"
        folder.mkdir(exist_ok=True)
        (folder / "ffmpeg").write_text(f"#!{sys.executable}\nimport sys\n{text}\n")
        (folder / "ffmpeg").chmod(stat.S_IRWXU)
        monkeypatch.setenv("PATH", str(folder))

    return install


class TestMp4:
    def test_every_frame_reaches_the_encoder(self, encoder, motions, tmp_path):
        encoder(
            "size = sys.argv[sys.argv.index('-s') + 1]\n"
            "data = sys.stdin.buffer.read()\n"
            "open(sys.argv[-1], 'w').write(f'{size} {len(data)}')"
        )
        rollouts = motions(-1, 1)
        execution_film(rollouts, tmp_path / "f.mp4")
        size, found = (tmp_path / "f.mp4").read_text().split()
        width, height = map(int, size.split("x"))
        steps = max(len(r.actions) for r in rollouts)
        assert int(found) == width * height * 3 * (steps + 1 + 30)

    @pytest.mark.parametrize("reads", [True, False], ids=["at the end", "at once"])
    def test_an_encoder_that_fails(self, reads, encoder, motions, tmp_path):
        encoder(
            "sys.stdin.buffer.read()\n" * reads
            + "open(sys.argv[-1], 'w').write('half')\nsys.exit('no space left')"
        )
        with pytest.raises(OutputError, match=r"cannot write .*f\.mp4: ffmpeg: no space left"):
            execution_film(motions(-1, 1), tmp_path / "f.mp4")
        assert [p.name for p in tmp_path.iterdir()] == ["bin"]

    def test_without_an_encoder(self, motions, tmp_path, monkeypatch):
        monkeypatch.setenv("PATH", str(tmp_path))
        with pytest.raises(OutputError, match=r"cannot write the film .*\.mp4 needs ffmpeg"):
            execution_film(motions(0), tmp_path / "f.mp4")
        assert not list(tmp_path.iterdir())


class TestBadInput:
    @pytest.mark.parametrize("name", ["f.avi", "f", "f.gif.txt", ".gif"])
    def test_suffix(self, name, motions, tmp_path):
        for refuse in (check_film, lambda file: execution_film(motions(0), file)):
            with pytest.raises(OutputError, match=r"its name must end in \.gif, \.mp4"):
                refuse(tmp_path / name)
        assert not list(tmp_path.iterdir())

    def test_picture_suffix(self, motions, tmp_path):
        with pytest.raises(OutputError, match="must end in"):
            execution_figure(motions(0), tmp_path / "f.gif")
        assert not list(tmp_path.iterdir())

    @pytest.mark.parametrize("number", [0, 26])
    def test_number_of_motions(self, number, motions, tmp_path):
        rollouts = motions(0) * number
        for draw, name in ((execution_film, "f.gif"), (execution_figure, "f.png")):
            with pytest.raises(InvalidInputError, match=f"shows 1 to 25 motions, got {number}"):
                draw(rollouts, tmp_path / name)
        assert not list(tmp_path.iterdir())

    def test_a_file_in_the_way(self, motions, tmp_path):
        (tmp_path / "file").write_text("")
        with pytest.raises(OutputError, match="cannot write"):
            execution_film(motions(0), tmp_path / "file" / "f.gif")

    @pytest.mark.skipif(not os.path.isdir("/proc/self"), reason="/proc of Linux, read-only")
    def test_read_only(self, motions):
        with pytest.raises(OutputError, match="cannot write"):
            execution_film(motions(0), Path("/proc/f.gif"))

    def test_what_is_interrupted_leaves_nothing(self, motions, tmp_path):
        def interrupt(done, total):
            if done == 5:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            execution_film(motions(0), tmp_path / "f.gif", progress=interrupt)
        assert not list(tmp_path.iterdir())
