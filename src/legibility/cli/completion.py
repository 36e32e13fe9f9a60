"""`legibility completion`."""

import re
from typing import Annotated, NamedTuple

from tyro.conf import Positional

from ..checks import one_of
from .options import choices
from .verbs import GROUPS, VERBS, help_of, members

SHELLS = ("bash", "zsh")


def completion(shell: Annotated[Positional[str], choices(SHELLS)]) -> None:
    """Print a script by which a shell completes verbs, options and their values.

    Bash reads it from the folder of the example, zsh by a line of ~/.zshrc: source
    ~/.legibility.zsh. The script starts no program; print it again after an update.

    Args:
        shell: that reads the script.

    Examples:
        legibility completion bash > ~/.local/share/bash-completion/completions/legibility
        legibility completion zsh > ~/.legibility.zsh
    """
    one_of("shell", shell, SHELLS)
    cases = [f"    {name}) words='{' '.join(members(name))}' ;;" for name in GROUPS]
    cases += [_case(name, *_entries(help_of(name))) for name in VERBS]
    script = _SCRIPT.format(
        groups="|".join(GROUPS), top=" ".join(members("")), cases="\n".join(cases)
    )
    print((_ZSH if shell == "zsh" else "") + script, end="")


class _Option(NamedTuple):
    """An option by all its names, whether a value follows, and the values of a fixed set."""

    names: list[str]
    takes_value: bool
    values: list[str]


def _entries(text: str) -> tuple[list[_Option], list[str] | None]:
    """The options in a help text, and the values of its positional arguments, None without any."""
    options: list[_Option] = []
    positional: list[str] | None = None
    for line in text.splitlines():
        # An entry begins at the left edge of its box and ends before its explanation.
        entry = re.match(r"(?:│ |  )(-.*?|[A-Z]+|\{\S*\})(?:  | *│|$)", line)
        if entry is None:
            continue
        shown = re.search(r"\{(.*?)\}", entry[1])
        values = [v for v in shown[1].split(",") if not re.search("[A-Z]", v)] if shown else []
        if entry[1].startswith("-"):
            names = re.findall(r"(?:^|(?<= ))--?[a-z][\w-]*", entry[1])
            options.append(_Option(names, bool(re.search("[A-Z{]", entry[1])), values))
        else:
            positional = [*(positional or []), *values]
    return options, positional


def _case(name: str, options: list[_Option], positional: list[str] | None) -> str:
    """The branch of the script for a verb."""
    names = " ".join(word for option in options for word in option.names if word[:2] == "--")
    free = "$options" if positional is None else " ".join(positional)
    lines = [f"    '{name}')", f"        options='{names}'", "        case $option in"]
    for option in filter(lambda option: option.values, options):
        lines.append(f"        {'|'.join(option.names)}) words='{' '.join(option.values)}' ;;")
    open_ended = [n for o in options if o.takes_value and not o.values for n in o.names]
    lines += [f"        {'|'.join(open_ended)}) ;;"] if open_ended else []
    return "\n".join([*lines, f'        *) words="{free}" ;;', "        esac ;;"])


_ZSH = "autoload -U +X compinit && compinit\nautoload -U +X bashcompinit && bashcompinit\n"

_SCRIPT = """\
# Completion for legibility, printed by `legibility completion`.
_legibility() {{
    local word=${{COMP_WORDS[COMP_CWORD]}} option=${{COMP_WORDS[COMP_CWORD-1]}}
    local verb=${{COMP_WORDS[1]}} words='' options=''
    case $verb in {groups})
        [ "$COMP_CWORD" -gt 2 ] && verb="$verb ${{COMP_WORDS[2]}}" ;;
    esac
    [ "$COMP_CWORD" -le 1 ] && verb=''
    [ "$option" = = ] && option=${{COMP_WORDS[COMP_CWORD-2]}}
    [ "$word" = = ] && word=''
    case $verb in
    '') words='{top}' options='--help --version' ;;
{cases}
    esac
    case $word in -*) words=$options ;; esac
    # Where there are no words the shell offers files.
    COMPREPLY=($(compgen -W "$words" -- "$word"))
}}
complete -o bashdefault -o default -F _legibility legibility
"""
