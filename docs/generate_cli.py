"""Write docs/cli.md from the commands themselves.

Run it after any change to a command, an option or a help text: ``python docs/generate_cli.py``.
What click prints differs between its versions, so nothing is taken from its formatter: only names,
kinds and texts.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from pathlib import Path

import click

from usdskin.cli import cli

REFERENCE = Path(__file__).with_name("cli.md")

HEAD = """# Command line reference

Made by `python docs/generate_cli.py` from the commands; `usdskin COMMAND --help` says the same.
Flags on the command line win over settings authored in a stage, which win over fallbacks.

| exit code | means |
|---|---|
| 0 | done |
| 1 | a bug of ours, with its traceback |
| 2 | a wrong option or argument |
| 3 | bad or missing input; one line says where, what and what to do |
| 4 | findings: `validate` found errors, `compare` passed a bar |
| 5 | some frames of a sequence failed |
| 6 | no such device, or not enough memory |
| 130, 143 | interrupted, terminated |

Folders that are missing are made when a file is written into them. An output that cannot be
written is refused before the work begins.

"""


def reference() -> str:
    """Return the whole page."""
    sections = [HEAD, _contents(), "\n## Global options\n\n"]
    sections += ["Before or after a command's name.\n\n", _options(cli)]
    sections += [_section(name, command) for name, command in _commands("usdskin", cli)]
    return "".join(sections)


def _commands(name: str, group: click.Group) -> Iterator[tuple[str, click.Command]]:
    """Yield every command that does something, with its whole name, in the order of the help."""
    context = click.Context(group)
    for part in group.list_commands(context):
        command = group.commands[part]
        if isinstance(command, click.Group):
            yield from _commands(f"{name} {part}", command)
        else:
            yield f"{name} {part}", command


def _contents() -> str:
    lines = []
    for name, command in _commands("usdskin", cli):
        first = " ".join(_paragraphs(command)[0].split())
        lines.append(f"| [`{name}`](#{name.replace(' ', '-')}) | {_cell(first)} |")
    return "\n".join(["| command | |", "|---|---|", *lines]) + "\n"


def _section(name: str, command: click.Command) -> str:
    arguments = [param for param in command.params if isinstance(param, click.Argument)]
    usage = " ".join([name, "[OPTIONS]", *(_argument(argument) for argument in arguments)])
    body = "".join(f"{_block(text)}\n\n" for text in _paragraphs(command))
    return f"\n## {name}\n\n```text\n{usage}\n```\n\n{body}{_options(command)}"


def _paragraphs(command: click.Command) -> list[str]:
    text = inspect.cleandoc((command.help or "").replace("\\b\n", "\b\n"))
    return [part.strip("\n") for part in text.split("\n\n") if part.strip()]


def _block(text: str) -> str:
    """Return a paragraph; what is kept as typed (examples) becomes code under its first line."""
    if not text.startswith("\b"):
        return _plain(" ".join(text.split()))
    title, *lines = text.removeprefix("\b").strip("\n").splitlines()
    code = inspect.cleandoc("\n" + "\n".join(lines))
    return f"{title.strip()}\n\n```sh\n{code}\n```"


def _argument(argument: click.Argument) -> str:
    name = argument.metavar or (argument.name or "").upper()
    name += "..." if argument.nargs == -1 and not name.endswith("...") else ""
    return name if argument.required or name.startswith("[") else f"[{name}]"


def _options(command: click.Command) -> str:
    rows = [
        f"| {_names(option)} | {_cell(_told(option))} |"
        for option in command.params
        if isinstance(option, click.Option) and not option.hidden
    ]
    return "\n".join(["| option | |", "|---|---|", *rows]) + "\n" if rows else ""


def _names(option: click.Option) -> str:
    flags = ", ".join([*option.opts, *option.secondary_opts])
    return f"`{_cell(' '.join([flags, _value(option)]).strip())}`"


def _value(option: click.Option) -> str:
    """Return what stands for the value of an option."""
    if option.is_flag or option.count:
        return ""
    if option.metavar:
        return option.metavar
    if isinstance(option.type, click.Choice):
        return "[" + "|".join(str(choice) for choice in option.type.choices) + "]"
    kinds = {click.Path: "PATH", click.IntRange: "INTEGER", click.FloatRange: "NUMBER"}
    plain = {"integer": "INTEGER", "float": "NUMBER", "text": "TEXT"}
    kind = kinds.get(type(option.type)) or plain.get(option.type.name, option.type.name.upper())
    return " ".join([kind] * max(option.nargs, 1))


def _told(option: click.Option) -> str:
    text = " ".join((option.help or "").split())
    if option.required:
        return f"{text} Required."
    if option.show_default and not (option.is_flag and not option.default):
        shown = option.show_default if isinstance(option.show_default, str) else option.default
        return f"{text}  [default: {shown}]"
    return text


def _cell(text: str) -> str:
    return _plain(text).replace("|", "\\|").replace("  [default:", " [default:")


def _plain(text: str) -> str:
    return text.replace("<", "&lt;")  # else Markdown takes <stage> for a tag


if __name__ == "__main__":
    REFERENCE.write_text(reference(), encoding="utf-8")
    print(REFERENCE)
