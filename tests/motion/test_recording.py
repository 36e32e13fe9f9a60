import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import legibility as lg
from legibility.curves import arc_length
from legibility.errors import InvalidInputError

SCENE = lg.Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]])
RATE, SECONDS = 100, 3
SHARE = np.linspace(0, 1, RATE * SECONDS)
SHARE = 10 * SHARE**3 - 15 * SHARE**4 + 6 * SHARE**5
RESTS = st.integers(0, 300)


def curve(bend, target=0, scene=SCENE):
    """A bent motion at 100 Hz, from rest to rest by least jerk."""
    across = np.sin(np.pi * SHARE)[:, None] * [0, bend]
    return scene.start + SHARE[:, None] * (scene.goals[target] - scene.start) + across


def recorded(motion, rng, before=200, after=200, noise=5e-4):
    resting = np.pad(motion, ((before, after), (0, 0)), "edge")
    times = np.arange(len(resting)) / RATE
    return lg.Recording(resting + rng.normal(0, noise, resting.shape), times)


@given(bend=st.floats(-0.3, 0.3), seed=st.integers(0, 2**32), before=RESTS, after=RESTS)
def test_rests_and_noise_change_no_label(bend, seed, before, after):
    motion = curve(bend)
    exact = lg.score(lg.Recording(motion), SCENE).achieved
    found = recorded(motion, np.random.default_rng(seed), before, after)
    assert lg.score(found, SCENE).achieved == pytest.approx(exact, abs=0.05)
    assert arc_length(found.motion) == pytest.approx(arc_length(motion), rel=0.01)
    assert 4e-4 < found.noise < 9e-4


def test_labels_of_many_motions():
    """Without our care the label falls by 0.13 in the mean."""
    errors, raw = [], []
    rng = np.random.default_rng(0)
    archive = lg.build_archive(SCENE)
    for bend in np.linspace(-0.3, 0.3, 31):
        motion, noisy = curve(bend), recorded(curve(bend), rng)
        label = archive.label_of(archive.observer.score(motion, SCENE, 0))
        raw.append(abs(archive.label_of(archive.observer.score(noisy.positions, SCENE, 0)) - label))
        errors.append(abs(lg.score(noisy, SCENE).achieved - label))
    assert np.mean(raw) > 0.1
    assert np.mean(errors) < 0.005
    assert max(errors) < 0.02


@given(bend=st.floats(-0.3, 0.3), before=RESTS, after=RESTS)
def test_without_noise_points_stay(bend, before, after):
    motion = curve(bend)
    found = recorded(motion, np.random.default_rng(0), before, after, noise=0)
    assert found.lost == 0
    assert found.noise < 2e-4  # of a motion of 0.8 m
    inside = np.isin(found.motion[1:-1], motion).all()
    assert inside
    np.testing.assert_allclose(found.motion[[0, -1]], motion[[0, -1]], atol=1e-3)


@pytest.mark.parametrize("corners", [[[0, 0], [0.5, 1.0]], [[0, 0], [0.5, 1.0], [1, 0], [1, 1]]])
def test_corners_stay(corners):
    recording = lg.Recording(corners)
    np.testing.assert_array_equal(recording.motion, corners)
    assert recording.lost == recording.noise == 0


@given(seed=st.integers(0, 2**32))
def test_correlated_noise_is_no_length(seed):
    """Noise of a sensor that filters, with a time constant of 45 ms."""
    rng, motion = np.random.default_rng(seed), curve(0.2)
    resting = np.pad(motion, ((200, 200), (0, 0)), "edge")
    white = rng.normal(0, 5e-4 * 0.6, resting.shape)
    for step in range(1, len(white)):
        white[step] += 0.8 * white[step - 1]
    found = lg.Recording(resting + white, np.arange(len(resting)) / RATE)
    assert arc_length(found.motion) == pytest.approx(arc_length(motion), rel=0.02)


@given(scale=st.floats(1e-3, 1e3), turn=st.floats(-3, 3), seed=st.integers(0, 2**32))
def test_same_motion_in_any_frame_and_unit(scale, turn, seed):
    found = recorded(curve(0.2), np.random.default_rng(seed))
    axes = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    other = lg.Recording(scale * found.positions @ axes.T + 5 * scale, found.times)
    assert arc_length(other.motion) / scale == pytest.approx(arc_length(found.motion), rel=0.01)
    assert other.noise / scale == pytest.approx(found.noise, rel=0.2)


def test_times():
    """Motions are at equal time steps, and their times are those of the recording."""
    rng, motion = np.random.default_rng(0), curve(0.1)
    keep = np.sort(rng.choice(np.arange(1, len(motion) - 1), 200, replace=False))
    keep = np.concatenate([[0], keep, [len(motion) - 1]])
    found = lg.Recording(motion[keep], 7 + keep / RATE)
    assert np.ptp(np.diff(found.motion_times)) < 1e-9
    assert 7 <= found.motion_times[0] < found.motion_times[-1] <= 10
    wanted = [np.interp(found.motion_times, 7 + np.arange(len(motion)) / RATE, x) for x in motion.T]
    np.testing.assert_allclose(found.motion, np.transpose(wanted), atol=2e-3)
    steps = lg.Recording(motion[keep])
    assert 0 <= steps.motion_times[0] < steps.motion_times[-1] <= len(keep) - 1


def test_long_recordings_are_averaged():
    rng = np.random.default_rng(0)
    dense = np.stack([np.interp(np.linspace(0, 299, 30_000), np.arange(300), x)
                      for x in curve(0.2).T], axis=-1)  # fmt: skip
    found = lg.Recording(dense + rng.normal(0, 1e-3, dense.shape))
    assert len(found.motion) < 600
    assert arc_length(found.motion) == pytest.approx(arc_length(dense), rel=0.005)
    assert found.lost > 0.9


BAD = {
    "one point": ({"positions": [[0, 0]]}, "recording 'a' must have at least 2 points"),
    "not a number": ({"positions": [[0, 0], [1, np.nan]]}, "recording 'a' must be finite, got nan"),
    "four axes": ({"positions": np.zeros((3, 4))}, r"must be \(T, 2\) or \(T, 3\), got \(3, 4\)"),
    "many": ({"positions": np.zeros((2, 3, 2))}, r"must be \(T, 2\) or \(T, 3\)"),
    "times": ({"times": [0, 1]}, "must be 3, one for each position, got 2"),
    "falling times": ({"times": [0, 2, 1]}, "'a' must rise, got 1.0 after 2.0"),
    "target": ({"target": -1}, "target must be"),
    "half a target": ({"target": 0.5}, "target must be an integer, got 0.5"),
}


@pytest.mark.parametrize(("values", "message"), BAD.values(), ids=BAD)
def test_bad_input(values, message):
    with pytest.raises(InvalidInputError, match=message):
        lg.Recording(**{"positions": [[0, 0], [0.5, 0.1], [1, 0]], "name": "a", **values})


def test_nothing_moves():
    rng = np.random.default_rng(0)
    for points in (np.zeros((100, 2)), rng.normal(0, 1e-3, (400, 2))):
        with pytest.raises(InvalidInputError, match="'1' must move"):
            lg.Recording(points).motion  # noqa: B018
