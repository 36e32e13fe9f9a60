"""Figures and films: they draw and compute nothing else.

Figures need none of matplotlib's backends, so one in `MPLBACKEND` that is not installed is ignored.
"""

import os

try:
    import matplotlib as _matplotlib
except ValueError:
    _backend = os.environ.pop("MPLBACKEND", "")
    try:
        import matplotlib as _matplotlib  # noqa: F401
    finally:
        os.environ["MPLBACKEND"] = _backend
