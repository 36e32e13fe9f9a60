"""Figures and films: they draw and compute nothing else.

They need none of matplotlib's backends. So a backend in MPLBACKEND that is not installed, such as a
notebook sets for the shells that it opens, is ignored; matplotlib could not be imported with it.
"""

import contextlib
import os
import sys

if "matplotlib" not in sys.modules and (_backend := os.environ.pop("MPLBACKEND", None)):
    import matplotlib as _matplotlib

    with contextlib.suppress(ValueError):
        _matplotlib.rcParams["backend"] = _backend
    os.environ["MPLBACKEND"] = _backend
