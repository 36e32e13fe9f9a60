"""The verbs by name: how words find theirs, and what every verb has in common.

A verb's file is imported only when it is called, so that help and errors appear at once.
"""

import contextlib
import importlib
import inspect
import io
import itertools
import os
import re
from collections.abc import Callable, Sequence
from typing import Annotated, Any, get_type_hints

from ..checks import did_you_mean
from ..errors import InvalidInputError
from .output import speaking

VERBS = {
    "plan": "plan motions through a scene, one for each level of legibility",
    "execute": "plan motions and execute them in an environment",
    "score": "rate recorded trajectories by every metric; no model is needed",
    "data": "make a dataset of labelled trajectories, from recordings too, describe or export one",
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
    "completion": "print a script by which a shell completes verbs and options",
}
"""What each verb does, in a line; its function ends its docstring with two examples."""

GROUPS = {
    "train": "make the weights of a model from a dataset",
    "evaluate": "measure a model on held-out scenes",
}

TALK = ("-q", "--quiet", "-v", "--verbose")
"""Options that may stand before the verb, too."""

_DESCRIPTION = """\
Robot motion with a dial for legibility, from most ambiguous (−1) to most legible (1).

Call a verb with --help for its options and two examples, or legibility --version."""


def call(words: Sequence[str]) -> None:
    """Call the verb that the words of a command name, or print the help that they ask for.

    Raises:
        InvalidInputError: there is no such verb.
        SystemExit: by the parser: 0 after help, 2 after a mistake in the options.
    """
    talk = list(itertools.takewhile(TALK.__contains__, words))  # before the verb, as after it
    words = words[len(talk) :]
    size = 2 if words and words[0] in GROUPS else 1
    name, rest = " ".join(words[:size]), words[size:]
    if name in VERBS:
        _parse(name, [*talk, *rest])
        return
    group, word = (words[0] if size == 2 else ""), (words[size - 1 :] or [""])[0]
    if word not in ("-h", "--help"):
        raise InvalidInputError(_no_verb(group, word))
    _list(group)


def load(name: str) -> Callable[..., Any]:
    """The function of a verb: `plan` of cli/plan.py, `path` of cli/train.py for "train path"."""
    module, *words = name.replace("-", "_").split()
    return getattr(importlib.import_module(f"{__package__}.{module}"), (words or [module])[0])


def members(group: str) -> dict[str, str]:
    """The verbs of a group, or for "" the verbs and groups of the command, and what each does."""
    if group:
        return {n.split()[1]: text for n, text in VERBS.items() if n.startswith(f"{group} ")}
    return {n: text for n, text in VERBS.items() if " " not in n} | GROUPS


def examples(verb: Callable[..., Any]) -> list[str]:
    """The commands below `Examples:` in the docstring of a verb's function."""
    section = re.search(r"^Examples:\n((?: +.*\n?)+)", inspect.getdoc(verb) or "", re.MULTILINE)
    return [" ".join(line.split()) for line in section[1].splitlines()] if section else []


def help_of(name: str) -> str:
    """The help of a verb, in lines of 129 characters, which leaves it one column of boxes."""
    text, columns = io.StringIO(), os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = "129"
    try:
        with contextlib.redirect_stdout(text), contextlib.suppress(SystemExit):
            _parse(name, ["--help"])
    finally:
        del os.environ["COLUMNS"]
        if columns is not None:
            os.environ["COLUMNS"] = columns
    return text.getvalue()


def _parse(name: str, words: list[str]) -> None:
    import tyro

    verb, box = load(name), io.StringIO()
    try:
        with contextlib.redirect_stderr(box):
            call = tyro.cli(
                _talking(verb), prog=f"legibility {name}", args=words,
                config=(tyro.conf.OmitArgPrefixes,),
            )  # fmt: skip
    except SystemExit as stop:
        if stop.code:
            raise InvalidInputError(_mistake(box.getvalue(), name)) from None
        print("\n".join(["examples:", *(f"  {line}" for line in examples(verb))]))
        raise
    call()


def _mistake(box: str, name: str) -> str:
    """The parser's box about a mistake in one line: the mistake, and the nearest option."""
    lines = [line.strip("│|").rstrip() for line in box.splitlines()]
    is_rule = [not line.strip("─-╭╮╰╯+ ") or line[:1] in "╭╰+" for line in lines]
    ends = [i for i, rule in enumerate(is_rule) if rule] + [len(lines)]
    parts = [lines[a + 1 : b] for a, b in itertools.pairwise(ends) if b > a + 1]  # below a title
    (first, *options), *more = parts or [["it cannot be read"]]
    inner = len(first) - len(first.lstrip()) + 4
    named = [line.strip() for line in options if len(line) - len(line.lstrip()) == inner]
    wrapped = [] if named else [line.strip() for line in options]
    problem = " ".join([first.strip(), *wrapped]) + " " * bool(named) + ", ".join(named)
    meant = re.search(r"Perhaps you meant:\s*(--[\w-]+)", "\n".join(itertools.chain(*more)))
    hint = f"; did you mean {meant[1]}?" if meant else ""
    return f"{problem[0].lower()}{problem[1:]}{hint} (legibility {name} --help tells more)"


def _talking(verb: Callable[..., Any]) -> Callable[..., Any]:
    """A verb's function with the flags --quiet and --verbose, which returns the call to make."""
    from tyro.conf import FlagCreatePairsOff, arg

    quiet = Annotated[
        FlagCreatePairsOff[bool],
        arg(aliases=["-q"], help="print nothing but errors; files are written as asked",
            help_behavior_hint=""),
    ]  # fmt: skip
    verbose = Annotated[
        FlagCreatePairsOff[bool],
        arg(aliases=["-v"], help="tell what is read, loaded and written, and how long it takes",
            help_behavior_hint=""),
    ]  # fmt: skip

    def talking(*arguments: Any, quiet: bool, verbose: bool, **options: Any) -> Callable[[], None]:
        def call() -> None:
            with speaking(quiet, verbose):
                verb(*arguments, **options)

        return call

    hints = {"quiet": quiet, "verbose": verbose}
    more = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=hint)
        for name, hint in hints.items()
    ]
    signature = inspect.signature(verb)
    talking.__signature__ = signature.replace(  # pyright: ignore[reportFunctionMemberAccess]
        parameters=[*signature.parameters.values(), *more]
    )
    talking.__annotations__ = get_type_hints(verb, include_extras=True) | hints
    talking.__doc__ = verb.__doc__
    return talking


def _list(group: str) -> None:
    """Print the verbs of a group, or of the command."""
    from tyro.extras import subcommand_cli_from_dict

    subcommand_cli_from_dict(
        {name: _stand_in(summary) for name, summary in members(group).items()},
        prog=f"legibility {group}".rstrip(),
        description=f"{GROUPS[group].capitalize()}." if group else _DESCRIPTION,
        args=["--help"],
    )


def _stand_in(summary: str) -> Callable[[], None]:
    """A verb that is listed but not called."""

    def verb() -> None: ...

    verb.__doc__ = summary
    return verb


def _no_verb(group: str, word: str) -> str:
    """The error for a word, perhaps none, that is no verb of a group."""
    known = ", ".join(members(group))
    of_group = f" of {group}" if group else ""
    if not word:
        return f"a verb{of_group} is missing, one of {known}"
    meant = {name.split()[-1]: name for name in VERBS if name.startswith(group)}
    if not group:
        meant |= {name: name for name in GROUPS}
    return f"there is no verb{of_group} {word!r}, only {known}{did_you_mean(word, meant)}"
