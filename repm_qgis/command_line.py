"""``repm STAGE --option value ...``: the stages on a terminal, for those without QGIS.

Options are those of :mod:`repm_qgis.contracts.options`, with ``-`` in place of ``_``. ``--job`` reads more of them from
a JSON file, over which those of the command line go. Progress and messages go to standard error, the results to
standard output, one a line. With ``--json``, all goes to standard output as JSON lines, as
:mod:`repm_qgis.engine_process` has them, what is wrong with the command too. The exit codes are the same: 0, 1 for an
expected failure, 2 for a bug and, as of all programs, for a command that cannot be read.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import re
import shutil
import sys
from functools import cache
from typing import Any, List, Match, NoReturn, Optional, Sequence, TextIO, Tuple, Type, get_args, get_origin

from . import __version__
from .contracts import options as options_of_stages
from .contracts.checks import Choice, Number
from .contracts.documents import JsonMapping, JsonObject, Keywords
from .contracts.errors import OptionError
from .contracts.options import Options
from .contracts.products import PRODUCTS
from .contracts.stages import STAGES
from .engine_process import own_output, read_job, serve
from .runtime.progress import JsonLines

_BAR = 24  # characters of the bar
_LEAST_COLUMNS = 40


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the command line of a terminal; gives the exit code."""
    words = sys.argv[1:] if arguments is None else arguments
    parser = _parser(type("Parser", (_Parser,), {"as_json": "--json" in words}))
    given = {name: value for name, value in vars(parser.parse_args(words)).items() if value is not None}
    stage, path, as_json = given.pop("stage"), given.pop("job"), given.pop("json")
    lines = JsonLines(own_output()) if as_json else Terminal(own_output(), sys.stderr)

    def asked() -> tuple[str, JsonObject]:
        return stage, {**(read_job(path) if path else {}), **given}

    return serve(lines, lambda cancelling: asked)


class _Parser(argparse.ArgumentParser):
    """A parser that says what is wrong with a command to a program, too."""

    as_json = False

    def error(self, message: str) -> NoReturn:
        if self.as_json:
            JsonLines(sys.stdout).send(type="error", kind=OptionError.__name__, text=message)
        super().error(message)


def _parser(kind: Type[_Parser] = _Parser) -> argparse.ArgumentParser:
    programs = (
        "For programs: 'python -m repm_qgis STAGE JOB.json' takes the options from a file, and writes JSON lines."
    )
    about = "Surface models from satellite images with RPCs."
    parser = kind(prog="repm", description=about, epilog=programs)
    parser.add_argument("--version", action="version", version=f"repm {__version__}")
    stages = parser.add_subparsers(dest="stage", required=True, metavar="STAGE")
    for name, declared in STAGES.items():
        options = declared.options
        text = _plain(options.__doc__ or "")
        each = stages.add_parser(name, help=text.split(". ")[0].rstrip("."), description=text, add_help=True)
        each.add_argument("--job", metavar="JOB.json", help="a JSON file with more options", default="")
        each.add_argument("--json", action="store_true", help="write JSON lines to standard output, for programs")
        each.add_argument("--language", metavar="CODE", help="of messages and reports, such as de", **_UNSET)
        for option in options.names():
            _add(each, name, options, option)
    return parser


_UNSET: Keywords = {"default": argparse.SUPPRESS}
"""Options that are not given are not in the job: their defaults, or those of a preset, are the engine's."""


def _add(parser: argparse.ArgumentParser, stage: str, options: Type[Options], name: str) -> None:
    flag, about = f"--{name.replace('_', '-')}", {**_UNSET, "help": _help(stage, options, name).replace("%", "%%")}
    kind, check = options.kind_of(name), options.option(name).metadata.get("check")
    if kind is bool:
        # Python 3.9 would show any other default in the help.
        parser.add_argument(flag, action=argparse.BooleanOptionalAction, help=about["help"], default=None)
    elif isinstance(check, Choice):
        parser.add_argument(flag, choices=check.choices, **about)
    elif get_origin(kind) is tuple:
        items = get_args(kind)
        many: Any = "*" if items[-1] is Ellipsis else len(items)
        parser.add_argument(flag, nargs=many, type=items[0], metavar=_metavar(items[0]), **about)
    else:
        parser.add_argument(flag, type=kind, metavar=_metavar(kind), **about)


def _metavar(kind: type) -> str:
    return {str: "TEXT", int: "NUMBER", float: "NUMBER"}[kind]


def _help(stage: str, options: Type[Options], name: str) -> str:
    """What options.py says of an option, what it may be, and its default."""
    owner, declared = options.owner_of(name), options.option(name)
    product = next((each for each in PRODUCTS if each.option == name and STAGES[each.stage].options is owner), None)
    parts = [product.title if product is not None else "", _plain(_said(owner, name))]
    check, default = declared.metadata.get("check"), declared.default
    if isinstance(check, Number):
        parts.append(f"{check.low:.10g} to {check.high:.10g} {check.unit}".strip())
    if default not in (dataclasses.MISSING, None, "", ()) and not isinstance(default, bool):
        parts.append(f"default: {' '.join(map(str, default)) if isinstance(default, tuple) else default}")
    elif isinstance(default, bool):
        parts.append(f"default: {'yes' if default else 'no'}")
    return "; ".join(filter(None, parts))


def _said(owner: Type[Options], name: str) -> str:
    """What the docstring of a class says of an option: the words behind its name, or behind the last of several names,
    up to the next option or to the end of the sentence."""
    text, named = _named(owner)
    for index, each in enumerate(named):
        if each[1] == name:
            ends = [*(other.start() for other in named[index + 1 :]), len(text)]
            words = (text[other.end() : end].strip(" ,;") for other, end in zip(named[index:], ends))
            said = next(each for each in words if re.sub(r"^\([^)]*\)|\band$", "", each).strip(" ,;"))
            said = re.split(r"(?<=\.)\s", said)[0]
            elsewhere = re.search(r"as in (?::class:`|``)(\w+)", said)
            if elsewhere:
                return _said(getattr(options_of_stages, elsewhere[1]), name)
            return re.sub(r"^(is|are|names?) |^[:,] *|[.,;]$|[,;]? and$", "", re.sub(r"^\([^)]*\):? ", "", said))
    return ""


@cache
def _named(owner: Type[Options]) -> Tuple[str, List[Match[str]]]:
    """The docstring of a class in one line, and where it says something of an option, by the option's name."""
    text = " ".join((owner.__doc__ or "").split())
    return text, list(re.finditer(rf"(?:(?<=[.;,:] )|(?<=and ))``({'|'.join(owner.names())})``", text))


def _plain(text: str) -> str:
    """A docstring as a terminal shows it."""
    return " ".join(re.sub(r":\w+:`~?([^`]+)`|``([^`]*)``", lambda found: found[1] or found[2], text).split())


class Terminal(JsonLines):
    """Shows what a stage sends to a person: a bar where ``errors`` is a terminal, else a line for each new step."""

    def __init__(self, results: TextIO, errors: TextIO) -> None:
        super().__init__(results)
        self._errors, self._shown, self._last = errors, 0, ""
        self._live = errors.isatty()

    def send(self, **message: Any) -> None:
        with self._lock:
            kind = message["type"]
            self._closed = kind in ("result", "error", "bug")
            if kind == "progress":
                self._step(message["fraction"], message["text"])
            elif kind == "result":
                self._clear()
                self._stream.writelines(f"{line}\n" for line in result_lines(message["result"]))
                self._stream.flush()
            else:
                before = {"info": "", "warning": "warning: "}.get(str(kind), "repm: ")
                self._say(f"{before}{_printable(message['text'])}")

    def last_words(self, **message: object) -> None:
        free = self._lock.acquire(timeout=0.2)
        if not self._closed:
            os.write(self._errors.fileno(), f"\n{'' if free else ' '}repm: {message['text']}\n".encode())

    def _step(self, fraction: float, text: str) -> None:
        if not self._live:
            if text and text != self._last:
                self._say(f"{fraction:4.0%} {_printable(text)}")
            self._last = text
            return
        full = round(_BAR * fraction)
        bar = f"[{'#' * full}{'.' * (_BAR - full)}] {fraction:4.0%} {_printable(text)}"
        room = max(shutil.get_terminal_size().columns, _LEAST_COLUMNS) - 1
        bar = bar[:room]
        self._errors.write(f"\r{bar.ljust(self._shown)}")
        self._errors.flush()
        self._shown = len(bar)

    def _say(self, text: str) -> None:
        self._clear()
        self._errors.write(f"{text}\n")
        self._errors.flush()

    def _clear(self) -> None:
        if self._shown:
            self._errors.write(f"\r{' ' * self._shown}\r")
            self._errors.flush()
            self._shown = 0


def result_lines(result: JsonMapping) -> List[str]:
    """A stage's results for a person, ``name: value``: files and figures; lists and tables stay in reports."""
    shown: List[str] = []
    for name, value in result.items():
        if isinstance(value, (list, tuple)) and all(isinstance(each, str) for each in value):
            shown += [f"{name}: {_printable(each)}" for each in value]
        elif isinstance(value, (str, int, float)) and value != "":
            shown.append(f"{name}: {_printable(str(value))}")
    return shown


def _printable(text: str) -> str:
    """A text whose names of files cannot move the cursor; lines stay lines."""
    return "".join(sign if sign.isprintable() or sign == "\n" else "?" for sign in text)


if __name__ == "__main__":
    sys.exit(main())
