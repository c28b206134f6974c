"""Completion scripts for shells, generated from the parser of the command line.

In bash the line ``eval "$(scan3d completion bash)"`` in ~/.bashrc switches completion on, in zsh the same line with zsh in
~/.zshrc after compinit.  In fish it is ``scan3d completion fish > ~/.config/fish/completions/scan3d.fish``.
"""

from __future__ import annotations

import argparse
import shlex
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

# Placeholders of options whose value is a file or a folder.  Arguments without an option always complete to files.
_FILES = ("FILE", "MESH")
_FOLDERS = ("DIR",)


@dataclass(frozen=True)
class _Argument:
    """An option with its flags, or an argument without an option."""

    flags: tuple[str, ...]
    help: str
    name: str
    """Placeholder of its value; empty if it takes no value."""
    values: tuple[str, ...]
    """The allowed values, if there is a list of them."""
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
    """The script for one of `choices.SHELLS`.

    `values` has the values of options that the parser itself does not restrict, by the name of the option.
    """
    commands = next(a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    descriptions = {choice.dest: choice.help or "" for choice in commands._choices_actions}
    by_command = {name: _arguments(command, values) for name, command in commands.choices.items()}
    top = [argument for argument in _arguments(parser, values) if argument.flags]
    return {"bash": _bash, "zsh": _zsh, "fish": _fish}[shell](descriptions, top, by_command)


def _arguments(parser: argparse.ArgumentParser, values: Mapping[str, tuple[str, ...]]) -> list[_Argument]:
    arguments = []
    for action in parser._actions:
        if action.help == argparse.SUPPRESS or isinstance(action, argparse._SubParsersAction):
            continue
        metavar = action.metavar if isinstance(action.metavar, str) else action.dest.upper()
        arguments.append(
            _Argument(
                flags=tuple(action.option_strings),
                help=(action.help or "").replace("%%", "%"),
                name="" if action.nargs == 0 else metavar,
                values=tuple(map(str, action.choices or values.get(action.dest, ()))),
                repeated=action.nargs in ("*", "+"),
            )
        )
    return arguments


def _bash(descriptions: Mapping[str, str], top: list[_Argument], commands: Mapping[str, list[_Argument]]) -> str:
    after, cases = [], [f"        '') words={shlex.quote(' '.join([*descriptions, *_flags(top)]))} ;;"]
    for command, arguments in commands.items():
        # the completion after an option; options with the same completion share a line
        patterns_by_words: dict[str, list[str]] = {}
        for option in (argument for argument in arguments if argument.flags and argument.kind != "none"):
            patterns = patterns_by_words.setdefault(_bash_words(option), [])
            patterns += [f"{command}:{flag}" for flag in option.flags]
        after += [f"        {'|'.join(patterns)}) {words} ;;" for words, patterns in patterns_by_words.items()]
        flags = shlex.quote(" ".join(_flags(arguments)))
        positional = next((_bash_words(argument) for argument in arguments if not argument.flags), "return")
        cases.append(f"        {command}) if [[ $current == -* ]]; then words={flags}; else {positional}; fi ;;")
    nl = "\n"
    return f"""\
# bash completion for scan3d; put this into ~/.bashrc: eval "$(scan3d completion bash)"
_scan3d() {{
    local current=${{COMP_WORDS[COMP_CWORD]}} before=${{COMP_WORDS[COMP_CWORD-1]}}
    local command='' words='' files='' word IFS=$' \\t\\n'
    COMPREPLY=()
    # bash splits --option=value into three words
    if [[ $current == '=' ]]; then current=''
    elif [[ $before == '=' ]]; then before=${{COMP_WORDS[COMP_CWORD-2]}}; fi
    for word in "${{COMP_WORDS[@]:1:COMP_CWORD-1}}"; do
        case $word in {"|".join(descriptions)}) command=$word; break ;; esac
    done
    case $command:$before in
{nl.join(after)}
        *) case $command in
{nl.join(cases)}
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


def _bash_words(argument: _Argument) -> str:
    words = f"words={shlex.quote(' '.join(argument.values))}"
    return {"values": words, "folder": "files=-d", "file": "files=-f"}.get(argument.kind, "return")


def _zsh(descriptions: Mapping[str, str], top: list[_Argument], commands: Mapping[str, list[_Argument]]) -> str:
    listed = "\n".join(f"            {shlex.quote(f'{name}:{_plain(text)}')}" for name, text in descriptions.items())
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
    for argument in arguments:
        actions = {"values": f"({' '.join(argument.values)})", "folder": "_files -/", "file": "_files"}
        value = f":{_plain(argument.name)}:{actions.get(argument.kind, ' ')}" if argument.name else ""
        for flag in argument.flags:
            equals = "=" if argument.name and flag.startswith("--") else ""
            specs.append(shlex.quote(f"{flag}{equals}[{_plain(argument.help)}]{value}"))
        if not argument.flags:
            specs.append(shlex.quote(f"{'*' if argument.repeated else ''}{value}"))
    return specs


def _plain(text: str) -> str:
    """The text without the characters that have a meaning for zsh's _arguments."""
    return text.replace("[", "(").replace("]", ")").replace("\\", "/").replace(":", "\\:")


def _fish(descriptions: Mapping[str, str], top: list[_Argument], commands: Mapping[str, list[_Argument]]) -> str:
    lines = [
        "# fish completion for scan3d: scan3d completion fish > ~/.config/fish/completions/scan3d.fish",
        "complete -c scan3d -f",
    ]
    for where, arguments in (("__fish_use_subcommand", top), *commands.items()):
        condition = where if where not in commands else f"__fish_seen_subcommand_from {where}"
        start = f"complete -c scan3d -n {shlex.quote(condition)}"
        if where in commands:
            lines.append(
                f"complete -c scan3d -n __fish_use_subcommand -a {where} -d {_fish_quoted(descriptions.get(where, ''))}"
            )
        for argument in arguments:
            flags = " ".join(f"-l {flag[2:]}" if flag.startswith("--") else f"-s {flag[1:]}" for flag in argument.flags)
            completion = {
                "none": "",
                "values": f"-x -a {_fish_quoted(' '.join(argument.values))}",
                "folder": "-x -a '(__fish_complete_directories)'",
                "file": "-r -F",
                "other": "-x",
            }[argument.kind]
            if argument.flags:
                lines.append(" ".join(filter(None, [start, flags, completion, f"-d {_fish_quoted(argument.help)}"])))
            else:
                lines.append(f"{start} {completion.removeprefix('-r ').removeprefix('-x ')}")
    return "\n".join(lines) + "\n"


def _fish_quoted(text: str) -> str:
    return "'" + text.replace("\\", "\\\\").replace("'", "\\'") + "'"


def _flags(arguments: Iterable[_Argument]) -> list[str]:
    return [flag for argument in arguments for flag in argument.flags]
