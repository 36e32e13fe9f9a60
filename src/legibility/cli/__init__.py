"""The command `legibility`: one file a verb, which parses, calls and prints."""

import io
import os
import sys
from collections.abc import Sequence

from ..errors import LegibilityError
from .output import ARGUMENTS
from .verbs import call

__all__ = ["main"]

_RESUMED = ("data", "train", "evaluate ablations", "evaluate single-scene")
"""Verbs that resume after an interrupt."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `legibility` and return its exit status: 0, 2 for a mistake, 130 for an interrupt.

    Args:
        arguments: without the command's own name; those of the process if not given.
    """
    words = list(sys.argv[1:] if arguments is None else arguments)
    token = ARGUMENTS.set(words)
    _prepare_process()
    try:
        _run(list(map(_at_home, words)))
        sys.stdout.flush()
        return 0
    except BrokenPipeError:
        # The reader has left. The rest of the buffer would fail again at exit, uncaught.
        sys.stdout = open(os.devnull, "w")  # noqa: SIM115
        return 0
    except SystemExit as stop:  # of the parser: 0 after --help, 2 after a mistake
        return stop.code if isinstance(stop.code, int) else 2
    except KeyboardInterrupt:
        resumes = " ".join(words[:2]).startswith(_RESUMED)
        return _fail("interrupted" + "; the same command resumes" * resumes, 130)
    except LegibilityError as error:
        return _fail(f"error: {error}", 2)
    except OSError as error:  # a full or failing disk below a library
        return _fail(f"error: {error.filename or 'input/output'}: {error.strerror or error}", 2)
    finally:
        ARGUMENTS.reset(token)


def _prepare_process() -> None:
    """Make the process independent of the shell or notebook that started it."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:  # closed by the shell (>&-)
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115
        elif isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # characters that it cannot show become ?
    if "MPLBACKEND" in os.environ:  # a notebook's, which may not be installed here
        os.environ["MPLBACKEND"] = "agg"


def _at_home(argument: str) -> str:
    """An argument with the home folder for `~`, which no shell expands in `--json=~/file`."""
    flag, equals, value = argument.rpartition("=") if argument[:2] == "--" else ("", "", argument)
    return flag + equals + os.path.expanduser(value)


def _fail(message: str, status: int) -> int:
    print("legibility:", " ".join(message.split()), file=sys.stderr)
    return status


def _run(words: list[str]) -> None:
    if words == ["--version"]:
        from .. import __version__

        print(f"legibility {__version__}")
    else:
        call(words)
