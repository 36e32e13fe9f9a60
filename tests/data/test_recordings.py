import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from legibility import Scene
from legibility.data.recordings import read_recordings, write_trajectories
from legibility.errors import InvalidInputError

PLANE = Scene([0, 0.5], [[0.8, 0.6], [1, 0.3]])
SOLID = Scene([-0.2, -0.2, 0.3], [[0, 0.1, 0.02], [0, -0.1, 0.02]])


def curves(file, scene, **options):
    return {r.name: r.positions for r in read_recordings(file, scene.dim, **options)}


@pytest.mark.parametrize("scene", [PLANE, SOLID], ids=["2D", "3D"])
def test_round_trip(scene, tmp_path):
    rng = np.random.default_rng(0)
    trajectories = rng.uniform(*scene.workspace, (3, 7, scene.dim))
    write_trajectories(tmp_path / "t.csv", ["-1", "a, b", "-1"], trajectories)
    found = curves(tmp_path / "t.csv", scene)
    assert list(found) == ["-1", "a, b", "-1 (2)"]
    np.testing.assert_array_equal(list(found.values()), trajectories)


def test_anybodys_file(tmp_path):
    """A byte-order mark, Windows line ends, capitals, blanks, empty lines, interleaved, quoted."""
    file = tmp_path / "t.csv"
    file.write_bytes(
        '\ufeffTrajectory, Y ,X\r\n"b",.5,0\r\n\r\na,0.1,0.2\r\nb,6e-1,.8\r\na,0.3,0.4\r\n'.encode()
    )
    found = curves(file, PLANE)
    assert {name: points.tolist() for name, points in found.items()} == {
        "b": [[0, 0.5], [0.8, 0.6]],
        "a": [[0.2, 0.1], [0.4, 0.3]],
    }


@pytest.mark.parametrize("name", ["t", "time", "T [s]"])
def test_times(name, tmp_path):
    file = tmp_path / "t.csv"
    file.write_text(f"{name},x,y\n0,0,0\n1,0.1,1\n4,0.4,0\n")
    (recording,) = read_recordings(file, 2)
    np.testing.assert_array_equal(recording.times, [0, 1, 4])
    np.testing.assert_array_equal(recording.positions, [[0, 0], [0.1, 1], [0.4, 0]])


def test_what_is_the_same_for_a_trajectory_is_noted(tmp_path):
    file = tmp_path / "t.csv"
    file.write_text("trajectory,who,gaze,x,y\na,Ada,1,0,0\nb,Bo,1,0,0\na,Ada,2,1,1\nb,Bo,2,1,1\n")
    found = read_recordings(file, 2)
    assert [recording.notes for recording in found] == [{"who": "Ada"}, {"who": "Bo"}]


def test_targets_and_scenes(tmp_path):
    file = tmp_path / "t.csv"
    file.write_text(
        "trajectory,scene,target,x,y\na,lab,1,0,0\nb,hall,0.0,0,0\na,lab,1,1,1\nb,hall,0,1,1\n"
    )
    first, second = read_recordings(file, 2)
    assert (first.name, first.scene, first.target) == ("a", "lab", 1)
    assert (second.name, second.scene, second.target) == ("b", "hall", 0)


def frame(**options):
    pandas = pytest.importorskip("pandas")
    return pandas.DataFrame({"x": [0.1, 0.3], "y": [0.2, 0.4]}).to_csv(**options)


OTHERS = {
    "further columns": ("timestamp,x,yaw,y\n1e9,0.1,,0.2\n1e9,0.3,a,0.4\n", "yaw"),
    "an index of pandas": (frame(), "without a name"),
    "an index of pandas, tabs": (frame(sep="\t"), "without a name"),
    "semicolons": ("x;y\n.1;.2\n.3;.4\n", None),
    "tabs": ("x\ty\n.1\t.2\n.3\t.4\n", None),
    "blanks": ("x  y\n .1  .2\n .3  .4\n", None),
    "np.savetxt": ("# x,y\n1.0e-01,2.0e-01\n3.0e-01,4.0e-01\n", None),
    "np.savetxt of two lines": ("# made by a robot\n# x y\n0.1 0.2\n0.3 0.4\n", None),
    "ROS": ("%time,x,y,field.seq\n1700000000000,.1,.2,7\n1700000000500,.3,.4,8\n", "field.seq"),
    "units": ("X [m];Y (m);t [s]\n.1;.2;0\n.3;.4;1\n", None),
    "another frame": ("x,y,X_ref,x_dot\n.1,.2,9,9\n.3,.4,9,8\n", "x_dot"),
    "old line ends": ("x,y\r.1,.2\r.3,.4\r", None),
}


@pytest.mark.parametrize(("content", "left_out"), OTHERS.values(), ids=OTHERS)
def test_files_of_other_programs(content, left_out, tmp_path):
    file, notes = tmp_path / "t.csv", []
    file.write_bytes(content.encode())
    found = curves(file, PLANE, note=notes.append)
    np.testing.assert_array_equal(found["1"], [[0.1, 0.2], [0.3, 0.4]])
    assert notes == ([f"{file}: columns ignored: {left_out}"] if left_out else [])


@pytest.mark.parametrize("scene", [PLANE, SOLID], ids=["2D", "3D"])
def test_parquet(scene, tmp_path):
    """The same recordings as of a CSV file, to the last bit, whatever the columns' types."""
    rng, count = np.random.default_rng(0), 5
    table = {
        "Trajectory": pa.array(np.repeat([3, 4], count)),
        "target": pa.array(np.repeat([1, 0], count), pa.int8()),
        "t [s]": pa.array(np.tile(np.arange(count, dtype=np.float32), 2)),
        "note": pa.array(range(2 * count)),
        **{axis: rng.random(2 * count) for axis in "xyz"[: scene.dim]},
    }
    pq.write_table(pa.table(table), tmp_path / "r.parquet")
    notes = []
    found = read_recordings(tmp_path / "r.parquet", scene.dim, notes.append)
    assert [r.name for r in found] == ["3", "4"]
    assert [r.target for r in found] == [1, 0]
    assert "columns ignored: note" in notes[0]
    for recording, rows in zip(found, (slice(count), slice(count, None)), strict=True):
        wanted = np.stack([table[axis][rows] for axis in "xyz"[: scene.dim]], axis=-1)
        np.testing.assert_array_equal(recording.positions, wanted)
        np.testing.assert_array_equal(recording.times, np.arange(count))


BAD_PARQUET = {
    "a gap": ({"x": [0.1, None], "y": [0.2, 0.3]}, "row 1: x must be a number, got ''"),
    "NaN": ({"x": [0.1, 0.2], "y": [np.nan, 0.3]}, "row 0: y must be finite, got nan"),
    "no y": ({"x": [0.1, 0.2]}, "columns x, y are needed, got x"),
    "no rows": ({"x": pa.array([], pa.float64()), "y": pa.array([], pa.float64())}, "no points"),
}


@pytest.mark.parametrize(("content", "message"), BAD_PARQUET.values(), ids=BAD_PARQUET)
def test_bad_parquet(content, message, tmp_path):
    pq.write_table(pa.table(content), tmp_path / "r.parquet")
    with pytest.raises(InvalidInputError, match=message):
        read_recordings(tmp_path / "r.parquet", 2)


def test_no_parquet(tmp_path):
    (tmp_path / "r.parquet").write_text("x,y\n0,0\n1,1\n")
    for name in ("r.parquet", "none.parquet"):
        with pytest.raises(InvalidInputError, match="cannot read the trajectory file"):
            read_recordings(tmp_path / name, 2)


BAD = {
    "empty": ("", "is empty"),
    "fields of ROS": (
        "%time,field.position.x,field.position.y\n1,0,0.5\n2,0.8,0.6\n",
        "columns x, y are needed, got time, field.position.x",
    ),
    "z in 2-D": ("x,y,z\n0,0.5,0\n0.8,0.6,0\n", "there is a column z"),
    "blank": ("\n\n", "is empty"),
    "no points": ("x,y\n", "no points"),
    "no header": ("0,0.5\n0.8,0.6\n", "line 1: there is no header: .* must name .*, as x,y$"),
    "no header of blanks": ("0.0e+00 5.0e-01\n8.0e-01 6.0e-01\n", "line 1: there is no header"),
    "no header, decimal commas": ("0,5;0,6\n0,7;0,6\n", "line 1: there is no header"),
    "decimal commas": ("x;y\n0,5;0,6\n0;0\n", "line 2: x must be .*'0,5'; write a decimal point"),
    "centimetres": ("x [cm],y [cm]\n0,0\n1,1\n", r"line 1: x must be in metres, got x \[cm\]"),
    "comments alone": ("# a\n# b\n", "line 1: the scene is 2D: columns x, y are needed, got a"),
    "missing column": ("x\n0\n1\n", "line 1: the scene is 2D: columns x, y are needed, got x"),
    "third dimension": ("x,y,z\n0,0,0\n1,1,0\n", "line 1: the scene is 2D"),
    "other names": ("a,b\n0,0\n1,1\n", "line 1: the scene is 2D: .* got a, b"),
    "column twice": ("x [m],y,X\n0,0,0\n1,1,1\n", "line 1: a column is there twice"),
    "time twice": ("x,y,t,time\n0,0,0,0\n1,1,1,1\n", "line 1: a column is there twice"),
    "text": ("x,y\n0,0\n1,one\n", "line 3: y must be a number, got 'one'"),
    "gap": ("x,y\n0,0\n\n1,\n", "line 4: y must be a number, got ''"),
    "NaN": ("x,y\n0,0\n1,nan\n", "line 3: y must be finite, got nan"),
    "infinite": ("x,y\n-inf,0\n1,1\n", "line 2: x must be finite, got -inf"),
    "short row": ("x,y\n0,0\n1\n", "line 3: 1 cells, the header has 2"),
    "long row": ("x,y\n0,0\n1,1,1\n", "line 3: 3 cells, the header has 2"),
    "one point": ("x,y\n0,0\n", "line 2: trajectory '1' must have at least 2 points"),
    "one point of two": ("trajectory,x,y\na,0,0\na,1,1\nb,1,1\n", "line 4: trajectory 'b' must"),
    "no name": ("trajectory,x,y\na,0,0\n,1,1\n", "line 3: the trajectory has no name"),
    "minutes": ("x,y,t [min]\n0,0,0\n1,1,1\n", r"line 1: t must be in seconds, got t \[min\]"),
    "target is text": ("x,y,target\n0,0,a\n1,1,a\n", "line 2: target must be the index .*'a'"),
    "half a target": ("x,y,target\n0,0,.5\n1,1,.5\n", "line 2: target must be the index"),
    "negative target": ("x,y,target\n0,0,-1\n1,1,-1\n", "line 2: target must be the index"),
    "mixed targets": ("x,y,target\n0,0,0\n1,1,1\n", "line 3: target must be the same .* 1 after 0"),
    "mixed scenes": ("x,y,scene\n0,0,a\n1,1,b\n", "line 3: scene must be the same .* b after a"),
    "no scene": ("x,y,scene\n0,0,\n1,1,a\n", "line 2: the scene has no name"),
    "time stands": ("x,y,t\n0,0,0\n1,1,0\n", "line 3: t must rise, got 0"),
    "time is text": ("x,y,t\n0,0,0\n1,1,now\n", "line 3: t must be a number"),
    "open quote": ('x,y\n0,0\n1,"1\n', "line 3: unexpected end of data"),
    "not text": (b"x,y\n\xff\xfe\x00\n", "not a text file"),
}


@pytest.mark.parametrize(("content", "message"), BAD.values(), ids=BAD.keys())
def test_bad_file(content, message, tmp_path):
    file = tmp_path / "t.csv"
    file.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InvalidInputError, match=message):
        curves(file, PLANE)


def test_flat_file_for_a_solid_scene(tmp_path):
    (tmp_path / "t.csv").write_text("x,y\n0,0\n0,0.1\n")
    with pytest.raises(InvalidInputError, match="the scene is 3D: columns x, y, z are needed"):
        curves(tmp_path / "t.csv", SOLID)


def test_no_file(tmp_path):
    with pytest.raises(InvalidInputError, match="cannot read the trajectory file"):
        curves(tmp_path / "t.csv", PLANE)
