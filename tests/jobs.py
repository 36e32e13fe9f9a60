"""What the workers of tests do; it lies beside the tests, so that their processes can import it."""

import os
import signal
from functools import partial
from pathlib import Path


def square(number):
    return number**2


def fail_at(bad, number):
    if number == bad:
        raise LookupError(f"no {number}")
    return number**2


def die_once(note: Path, fatal, function, item):
    """Kill this process, a worker's, the first time that it comes to the item `fatal`."""
    if item == fatal and not note.exists():
        note.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return function(item)


def die_always(fatal, item):
    if item == fatal:
        os.kill(os.getpid(), signal.SIGKILL)
    return item


def dying_once(note: Path, fatal, function):
    return partial(die_once, note, fatal, function)
