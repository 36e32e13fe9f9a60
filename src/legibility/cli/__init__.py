"""The command `legibility`: one file a verb, which parses, calls and prints.

A verb's file is imported only when it is called, so that help and errors appear at once.
"""

import importlib
import io
import os
import sys
from collections.abc import Callable, Sequence
from typing import Any

from ..errors import LegibilityError
from .output import ARGUMENTS

__all__ = ["main"]

_VERBS = {
    "plan": "plan motions through a scene, one for each level of legibility",
    "execute": "plan motions and execute them in an environment",
    "score": "rate the trajectories of a CSV file by every metric; no model is needed",
    "data": "make a dataset of labelled trajectories, or describe one",
    "train all": "make every stage of a model, from its data to its weights",
    "train path": "train stage 1, the path diffuser",
    "train distill": "distill stage 1 into a student that samples in one step",
    "train policy": "train stage 2, the path-guided policy",
    "train diffusion-policy": "train a baseline that knows the goal alone",
    "train legibility-diffuser": "train a baseline that is guided away from the distractors",
    "evaluate dial": "measure achieved against asked legibility on held-out scenes",
    "evaluate eyes": "measure how one observer's dial looks to every other observer",
    "evaluate planning": "measure error against planning time, beside search and archives",
    "evaluate optimum": "compare plans with the best motions of their length and with a bound",
    "evaluate timing": "check that timed motions keep their limits, and what they cost",
    "evaluate controller": "disturb motions on the way and see how the controller goes on",
    "evaluate external": "rate motions, ours and yours, by other people's definitions",
    "evaluate execution": "measure executed motions and their controllers on held-out scenes",
    "evaluate table1": "the paper's Table I: every method's most legible motions, executed",
    "evaluate single-scene": "Table I of methods that learned in its scene alone",
    "evaluate unseen": "the same methods on held-out scenes, relative to each scene's oracle",
    "evaluate spectrum": "the paper's figure 3: motions over the whole dial and their cost",
    "evaluate ablations": "measure the worth of each part of stage 1 by small runs without it",
    "bench": "measure the speed of planning, control and training on this machine",
    "report": "render results as a page with pictures, and as model cards",
    "doctor": "check the installation and suggest remedies",
}
_GROUPS = {
    "train": "make the weights of a model from a dataset",
    "evaluate": "measure a model on held-out scenes",
}
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


def _run(arguments: list[str]) -> None:
    if arguments == ["--version"]:
        from .. import __version__

        print(f"legibility {__version__}")
        return
    from tyro.conf import OmitArgPrefixes
    from tyro.extras import subcommand_cli_from_dict

    group = arguments[0] if arguments and arguments[0] in _GROUPS else ""
    if group:
        arguments = arguments[1:]
        verbs = {n: s for n, s in _VERBS.items() if n.startswith(f"{group} ")}
    else:
        verbs = {n: s for n, s in _VERBS.items() if " " not in n} | _GROUPS
    commands: dict[str, Callable[..., Any]] = {}
    for name, summary in verbs.items():
        word = name.split()[-1]
        commands[word] = _load(name) if arguments[:1] == [word] else _stand_in(summary)
    subcommand_cli_from_dict(
        commands,
        prog=f"legibility {group}".rstrip(),
        description=f"{_GROUPS[group].capitalize()}." if group else _DESCRIPTION,
        args=arguments,
        config=(OmitArgPrefixes,),
    )


_DESCRIPTION = """\
Robot motion with a dial for legibility, from most ambiguous (−1) to most legible (1).

Call a verb with --help for its options, or legibility --version."""


def _load(name: str) -> Callable[..., Any]:
    """The function of a verb: `plan` of cli/plan.py, `path` of cli/train.py for "train path"."""
    module, *words = name.replace("-", "_").split()
    return getattr(importlib.import_module(f".{module}", __name__), (words or [module])[0])


def _stand_in(summary: str) -> Callable[[], None]:
    """A verb that is listed but not called."""

    def verb() -> None: ...

    verb.__doc__ = summary
    return verb
