"""Makes the pages of the commands from the table of options: ``python docs/site/commands.py [FOLDER]``.

Each command has a page in ``docs/commands``: what it does, its usage, an example, its options with their defaults, and
its exit statuses if they are its own.
"""

from __future__ import annotations

import html
import re
import sys
from inspect import cleandoc
from pathlib import Path
from typing import TYPE_CHECKING

from pc2scan.cli.commands import COMMANDS
from pc2scan.options.option import Parameter
from pc2scan.options.table import options_of, spellings

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from pc2scan.cli.commands import Argument, Command
    from pc2scan.options.option import Option

FOLDER = Path(__file__).parents[1] / "commands"

#: The pages that explain what a command is for, as a list of links.
READ_ON = {
    "convert": "[topics, times and formats](../formats.md), [parameters](../parameters.md), [frames](../frames.md), "
    "[which points](../choosing-points.md), [robots that move](../moving-robots.md), [ready for SLAM](../slam.md)",
    "batch": "[a whole dataset](../datasets.md)",
    "export": "[files for learning and evaluation](../export.md)",
    "view": "[look, and tune by eye](../look.md)",
    "plot": "[look, and tune by eye](../look.md)",
    "map": "[a map at once](../look.md#a-map-at-once)",
    "check": "[would SLAM take the scans?](../check.md)",
    "info": "[parameters and their traps](../parameters.md)",
    "tf": "[frames](../frames.md)",
    "repair": "[the recording is damaged](../troubleshooting.md#the-recording-is-damaged)",
    "diff": "[comparing recordings](../diff.md)",
    "golden": "[golden cases, and CI](../golden.md)",
}

HEAD = "| option | what it does | default |\n|---|---|---|"


def main(folder: Path) -> None:
    """Write all pages, and the list of them."""
    folder.mkdir(exist_ok=True)
    for name, text in pages().items():
        (folder / name).write_text(text, "utf-8")


def pages() -> dict[str, str]:
    """Return the text of each page, by the name of its file."""
    found = {f"{name}.md": page(name, command) for name, command in COMMANDS.items()}
    rows = [f"| [`{name}`]({name}.md) | {_prose(_sentences(each.help)[0])} |" for name, each in COMMANDS.items()]
    listed = "\n".join(["| | |", "|---|---|", *rows])
    return {"index.md": f"# Commands\n\n{listed}\n\n{_STATUSES}\n\n{_COMMENT}\n", **found}


_COMMENT = "<!-- Made by `python docs/site/commands.py` from src/pc2scan/options. -->"
_STATUSES = (
    "`pc2scan COMMAND --help` shows the options that most people use, `--help-all` every option. Exit statuses are "
    "[the same in all commands](../report.md#exit-statuses)."
)


def page(name: str, command: Command) -> str:
    """Return the page of a command."""
    description, *further = cleandoc(command.help).split("\n\n")
    sentences = [description, *_sentences(" ".join(further))[:1]]
    statuses = [_prose(text) for text in further[1:] if text.startswith("Exit status")]
    typed, what = next(iter(command.examples.items()))
    taken = " ".join(_usage(each) for each in command.arguments if each.required or not each.spellings)
    parts = [
        f"# pc2scan {name}",
        _prose(" ".join(sentences)),
        f"```sh\n{typed}  # {what}\n```",
        f"Usage: `pc2scan {name} [OPTIONS] {taken}`",
        *_option_tables(name, command),
        *statuses,
        f"More: {READ_ON[name]}, [exit statuses](../report.md#exit-statuses).",
        _COMMENT,
    ]
    return "\n\n".join(parts) + "\n"


def _option_tables(name: str, command: Command) -> Iterable[str]:
    """Yield the tables of a command's options, each under the title of its group."""
    known = options_of(name)
    elsewhere = _of_convert(name, known)
    groups: dict[str, list[str]] = {"": [_row_of_own(each) for each in command.arguments]}
    for option in known.values():
        if option.spelling and option.name not in elsewhere:
            groups.setdefault(option.panel or "", []).append(_row(option))
    # An option that is alone in its group needs no title.
    for title in [title for title, rows in groups.items() if title and len(rows) == 1]:
        groups[""] += groups.pop(title)
    for title, rows in groups.items():
        if title:
            yield f"## {title}"
        yield "\n".join([HEAD, *rows])
    if elsewhere:
        titles = list(dict.fromkeys(option.panel for option in elsewhere.values() if option.panel))
        yield "## Options of convert"
        yield (
            f"{', '.join(titles)}: described on the page of [`pc2scan convert`](convert.md). `--help-all` lists them."
        )


def _of_convert(name: str, known: Mapping[str, Option]) -> dict[str, Option]:
    """Return the options that are only named on a command's page, because the page of ``convert`` describes them."""
    if name == "convert":
        return {}
    others = options_of("convert")
    return {key: option for key, option in known.items() if others.get(key) is option and option.spelling}


def _row(option: Option) -> str:
    """Return the row of an option of the table."""
    value = option.value
    spellings = [f"`{each}`" for each in (option.short, option.spelling) if each]
    if value.kind != "bool":
        # A choice of words has no name of its own, nor has a number without a unit.
        name = "WORD" if value.words and value.metavar in {None, "|".join(value.words)} else value.metavar or "X"
        spellings[-1] = f"`{option.spelling} {name.replace('|', '` or `')}`"
    elif isinstance(option, Parameter):
        spellings.append(f"`{option.negation}`")
    text = _prose(option.help)
    if value.words and not all(re.search(rf"\b{re.escape(word)}\b", text) for word in value.words):
        text += f" One of {', '.join(f'`{word}`' for word in value.words)}."
    text += " Repeatable." if value.repeats else ""
    return f"| {', '.join(spellings)} | {text} | {option.default_text} |"


def _row_of_own(argument: Argument) -> str:
    """Return the row of an argument that is not in the table of options."""
    name = f"`{argument.shown}`"
    if argument.spellings:
        name = ", ".join(f"`{each}`" for each in argument.spellings)[:-1] + f" {argument.metavar}`"
    default = argument.default_text or ("required" if argument.required else "")
    return f"| {name} | {_prose(argument.help)} | {default} |"


def _usage(argument: Argument) -> str:
    """Return an argument, or a required option, as the usage has it."""
    return f"-o {argument.metavar}" if argument.spellings else argument.metavar


def _sentences(text: str) -> list[str]:
    return re.split(r"(?<=[.!?])\s+(?=[A-Z])", text.strip())


#: What is shown as code: what the help has in quotation marks, options, and suffixes.
_CODE = re.compile(r"(?<=[ (])'([^']+ [^']+)'(?=[ ,.;:)]|$)|(?<![\w-])(--[a-z][a-z-]*[a-z]|\*\.[a-z]+)")


def _prose(text: str) -> str:
    """Return a text of the help as a line of Markdown."""
    parts = re.sub("`([a-z_]+)(?:=([^`]*))?`", _spelled, " ".join(text.split())).split("`")
    # Every second part is code already.
    parts[::2] = ["`".join(_marked(part)) for part in parts[::2]]
    return "`".join(parts)


def _spelled(named: re.Match[str]) -> str:
    """Return an option that is named as in Python as it is typed."""
    name, value = named.groups()
    words = [spellings().get(name, name), *([value] if value not in {None, "True"} else [])]
    return f"`{' '.join(words)}`"


def _marked(text: str) -> Iterable[str]:
    """Yield prose and code in turns."""
    end = 0
    for found in _CODE.finditer(text):
        yield html.escape(text[end : found.start()], quote=False)
        yield found[1] or found[2]
        end = found.end()
    yield html.escape(text[end:], quote=False)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if sys.argv[1:] else FOLDER)
