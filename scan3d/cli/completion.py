"""Completion scripts for shells, made from the command line's own parser.

bash: eval "$(scan3d completion bash)" in ~/.bashrc; zsh: the same with zsh in ~/.zshrc, after compinit; fish:
scan3d completion fish > ~/.config/fish/completions/scan3d.fish.
"""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

# Placeholders of options whose value is a file or a folder; words without an option are files or folders anyway.
_FILES = ("FILE", "MESH")
_FOLDERS = ("DIR",)


@dataclass(frozen=True)
class _Argument:
    """One option, or one word that stands without an option."""

    flags: tuple[str, ...]
    help: str
    name: str
    """What stands for its value; empty if it takes none."""
    values: tuple[str, ...]
    """All that it may be, if that is known."""
    repeated: bool

    @property
    def kind(self) -> str:
        """'none', 'values', 'folder', 'file' or 'other'."""
        if not self.name:
            return "none"
        if self.values:
            return "values"
        if not self.flags or self.name in _FILES:
            return "file"
        return "folder" if self.name in _FOLDERS else "other"


def script(parser: argparse.ArgumentParser, shell: str, values: Mapping[str, tuple[str, ...]]) -> str:
    """The script for one of `choices.SHELLS`; `values` are those of options that the parser takes as they come, by name."""
    commands = next(a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    about = {choice.dest: choice.help or "" for choice in commands._choices_actions}
    found = {name: _arguments(one, values) for name, one in commands.choices.items()}
    top = [argument for argument in _arguments(parser, values) if argument.flags]
    return {"bash": _bash, "zsh": _zsh, "fish": _fish}[shell](about, top, found)


def _arguments(parser: argparse.ArgumentParser, values: Mapping[str, tuple[str, ...]]) -> list[_Argument]:
    found = []
    for action in parser._actions:
        if action.help == argparse.SUPPRESS or isinstance(action, argparse._SubParsersAction):
            continue
        metavar = action.metavar if isinstance(action.metavar, str) else action.dest.upper()
        found.append(
            _Argument(
                flags=tuple(action.option_strings),
                help=(action.help or "").replace("%%", "%"),
                name="" if action.nargs == 0 else metavar,
                values=tuple(map(str, action.choices or values.get(action.dest, ()))),
                repeated=action.nargs in ("*", "+"),
            )
        )
    return found


def _bash(about: Mapping[str, str], top: list[_Argument], commands: Mapping[str, list[_Argument]]) -> str:
    after, words = [], [f"        '') words={shlex.quote(' '.join([*about, *_flags(top)]))} ;;"]
    for command, arguments in commands.items():
        # what follows an option, options with the same together
        wanted: dict[str, list[str]] = {}
        for one in (one for one in arguments if one.flags and one.kind != "none"):
            patterns = wanted.setdefault(_bash_words(one), [])
            patterns += [f"{command}:{flag}" for flag in one.flags]
        after += [f"        {'|'.join(patterns)}) {what} ;;" for what, patterns in wanted.items()]
        flags = shlex.quote(" ".join(_flags(arguments)))
        free = next((_bash_words(one) for one in arguments if not one.flags), "return")
        words.append(f"        {command}) if [[ $current == -* ]]; then words={flags}; else {free}; fi ;;")
    nl = "\n"
    return f"""\
# bash completion for scan3d; put this into ~/.bashrc: eval "$(scan3d completion bash)"
_scan3d() {{
    local current=${{COMP_WORDS[COMP_CWORD]}} before=${{COMP_WORDS[COMP_CWORD-1]}}
    local command='' words='' files='' word IFS=$' \\t\\n'
    COMPREPLY=()
    # --option=value comes as three words
    if [[ $current == '=' ]]; then current=''
    elif [[ $before == '=' ]]; then before=${{COMP_WORDS[COMP_CWORD-2]}}; fi
    for word in "${{COMP_WORDS[@]:1:COMP_CWORD-1}}"; do
        case $word in {"|".join(about)}) command=$word; break ;; esac
    done
    case $command:$before in
{nl.join(after)}
        *) case $command in
{nl.join(words)}
        esac ;;
    esac
    if [[ -n $files ]]; then
        compopt -o filenames 2>/dev/null
        IFS=$'\\n'
        COMPREPLY=($(compgen $files -- "$current"))
    else
        COMPREPLY=($(compgen -W "$words" -- "$current"))
    fi
}}
complete -F _scan3d scan3d
"""


def _bash_words(one: _Argument) -> str:
    words = f"words={shlex.quote(' '.join(one.values))}"
    return {"values": words, "folder": "files=-d", "file": "files=-f"}.get(one.kind, "return")


def _zsh(about: Mapping[str, str], top: list[_Argument], commands: Mapping[str, list[_Argument]]) -> str:
    listed = "\n".join(f"            {shlex.quote(f'{name}:{_plain(text)}')}" for name, text in about.items())
    cases = "\n".join(
        f"        {command}) _arguments {' '.join(_zsh_specs(arguments))} ;;" for command, arguments in commands.items()
    )
    return f"""\
#compdef scan3d
# zsh completion for scan3d; put this into ~/.zshrc, after compinit: eval "$(scan3d completion zsh)"
_scan3d() {{
    local context state state_descr line
    typeset -A opt_args
    _arguments -C {" ".join(_zsh_specs(top))} '1: :->command' '*:: :->arguments'
    case $state in
    command)
        local -a commands
        commands=(
{listed}
        )
        _describe command commands ;;
    arguments)
        case $words[1] in
{cases}
        esac ;;
    esac
}}
if [[ $funcstack[1] == _scan3d ]]; then _scan3d "$@"; else compdef _scan3d scan3d; fi
"""


def _zsh_specs(arguments: Iterable[_Argument]) -> list[str]:
    specs = []
    for one in arguments:
        action = {"values": f"({' '.join(one.values)})", "folder": "_files -/", "file": "_files"}.get(one.kind, " ")
        value = f":{_plain(one.name)}:{action}" if one.name else ""
        for flag in one.flags:
            equals = "=" if one.name and flag.startswith("--") else ""
            specs.append(shlex.quote(f"{flag}{equals}[{_plain(one.help)}]{value}"))
        if not one.flags:
            specs.append(shlex.quote(f"{'*' if one.repeated else ''}{value}"))
    return specs


def _plain(text: str) -> str:
    """Without what means something to _arguments."""
    return text.replace("[", "(").replace("]", ")").replace("\\", "/").replace(":", "\\:")


def _fish(about: Mapping[str, str], top: list[_Argument], commands: Mapping[str, list[_Argument]]) -> str:
    lines = [
        "# fish completion for scan3d: scan3d completion fish > ~/.config/fish/completions/scan3d.fish",
        "complete -c scan3d -f",
    ]
    for where, arguments in (("__fish_use_subcommand", top), *commands.items()):
        condition = where if where not in commands else f"__fish_seen_subcommand_from {where}"
        start = f"complete -c scan3d -n {shlex.quote(condition)}"
        if where in commands:
            lines.append(
                f"complete -c scan3d -n __fish_use_subcommand -a {where} -d {_fish_quoted(about.get(where, ''))}"
            )
        for one in arguments:
            flags = " ".join(f"-l {flag[2:]}" if flag.startswith("--") else f"-s {flag[1:]}" for flag in one.flags)
            wanted = {
                "none": "",
                "values": f"-x -a {_fish_quoted(' '.join(one.values))}",
                "folder": "-x -a '(__fish_complete_directories)'",
                "file": "-r -F",
                "other": "-x",
            }[one.kind]
            if one.flags:
                lines.append(" ".join(filter(None, [start, flags, wanted, f"-d {_fish_quoted(one.help)}"])))
            else:
                lines.append(f"{start} {wanted.removeprefix('-r ').removeprefix('-x ')}")
    return "\n".join(lines) + "\n"


def _fish_quoted(text: str) -> str:
    return "'" + text.replace("\\", "\\\\").replace("'", "\\'") + "'"


def _flags(arguments: Iterable[_Argument]) -> list[str]:
    return [flag for one in arguments for flag in one.flags]
