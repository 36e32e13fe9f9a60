"""Networks, diffusion, the two stages and their checkpoints.

A forked child computes on one thread: PyTorch's pool of threads does not survive a fork, and work
that is given to it there would never end.
"""

import os
import sys


def _one_thread() -> None:
    torch = sys.modules.get("torch")
    if torch is not None:
        torch.set_num_threads(1)


if hasattr(os, "register_at_fork"):  # there is none on Windows, which does not fork
    os.register_at_fork(after_in_child=_one_thread)
