"""The record of a training is the same after a round trip through JSON."""

import json
from dataclasses import fields, replace

import pytest

from legibility.models.provenance import TeacherRecord, TrainingRecord

RECORD = TrainingRecord(
    data={"dim": 2, "goals": [2, 6]}, digest="00ff", training={"steps": 3}, parameters=12,
    seconds=1.5, step_seconds=0.5, device="cpu", processes=1, precision="no", threads=2,
    torch="2.6",
)  # fmt: skip


@pytest.mark.parametrize(
    "record",
    [
        RECORD,
        replace(RECORD, demonstrations={"number": 4}),
        replace(RECORD, teacher=TeacherRecord("ab", 3, 0.3)),
        replace(RECORD, teacher=TeacherRecord("ab", 3, 0.3, training=replace(RECORD, seconds=9.0))),
    ],
    ids=["plain", "policy", "teacher", "teacher of a teacher"],
)
def test_round_trip(record):
    content = json.loads(json.dumps(record.to_dict()))
    assert TrainingRecord.from_dict(content) == record


def test_nothing_stands_for_what_does_not_apply():
    names = {f.name for f in fields(TrainingRecord)}
    assert set(RECORD.to_dict()) == names - {"demonstrations", "teacher"}


def test_a_missing_or_unknown_key():
    content = RECORD.to_dict()
    with pytest.raises(TypeError, match="speed"):
        TrainingRecord.from_dict({**content, "speed": 1})
    del content["digest"]
    with pytest.raises(TypeError, match="digest"):
        TrainingRecord.from_dict(content)
