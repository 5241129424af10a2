"""How the command line refuses wrong input: two lines, with the option and what to type instead.

argparse finds what is wrong; this module says it in terms of what the user typed. All overrides of
argparse are in this file.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Container, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

from pdcd.meant import suggest_number, suggest_pair, suggest_word
from pdcd.printable import to_one_line, write_stderr

_PLAIN = {
    "int": "a whole number",
    "float": "a number",
    "parse_share": "a share, such as 0.01 or 1%",
}
"""What values of a type are, in words, for types without words of their own."""


class CommandParser(argparse.ArgumentParser):
    """The parser of the program or of a command."""

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As argparse does, but unknown words are refused by the command they were typed for."""
        found, left = self.parse_known_args(args, namespace)
        if left:
            _find_command(self, found)._refuse_words(left)  # noqa: SLF001
        return found

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """As argparse does, but an unknown option is refused first: the words after it would be
        taken for something else."""
        for word in _list_options(args or (), self._list_commands()):
            if word not in self._option_string_actions:
                self._refuse_words([word])
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """Print the usage and below it what is wrong, and exit with code 2."""
        text = re.sub(r"^(\S+): it takes", r"\1 takes", message.removeprefix("argument "))
        missing = re.fullmatch(r"the following arguments are required: (.*)", text)
        if missing is not None:
            text = self._describe_missing(missing[1])
        elif "(" not in text:
            text += f" (type {self.prog} --help)"
        # argparse's own printing fails in Debian 12 when nobody reads.
        write_stderr(f"{self._shorten_usage()}\n{self.prog}: {to_one_line(text)}\n")
        self.exit(2)

    def _get_values(self, action: argparse.Action, arg_strings: list[str]) -> Any:
        """Values of an option, in their type. argparse removes "--" as if it stood by itself, so
        `--out=--` would leave an empty list, whatever the option's type: it is refused."""
        if action.option_strings and "--" in arg_strings:
            raise argparse.ArgumentError(
                action, f"it takes a value, not -- (type {_say_form(action)})"
            )
        return super()._get_values(action, arg_strings)

    def _get_value(self, action: argparse.Action, arg_string: str) -> Any:
        """One value, or an error that says what to type in its place."""
        try:
            return super()._get_value(action, arg_string)
        except argparse.ArgumentError as err:
            name = getattr(action.type, "__name__", "a value")
            takes = _PLAIN.get(name, name)
            pair = suggest_pair(arg_string) if action.nargs is not None else None
            better = " ".join(pair) if pair else suggest_number(arg_string, whole="whole" in takes)
            form = f"{_call(action)} {better}" if better else _say_form(action)
            raise argparse.ArgumentError(
                action, f"it takes {takes}, not {arg_string!r} (type {form})"
            ) from err

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Refuse a word that is not among the choices, and suggest the nearest one."""
        if action.choices is not None and value not in action.choices:
            words = list(map(str, action.choices))
            listed = suggest_word(str(value), words) or f"one of {', '.join(words)}"
            if value == "help":
                listed = f"{self.prog} --help"
            elif isinstance(action, argparse._SubParsersAction) and Path(value).is_dir():  # noqa: SLF001
                option = "--state-dir"
                listed = f"{self.prog} {option} {value}" * (option in self._option_string_actions)
            raise argparse.ArgumentError(action, f"there is no {str(value)!r} (type {listed})")

    def _match_argument(self, action: argparse.Action, arg_strings_pattern: str) -> int:
        """The number of following words that an option takes."""
        try:
            return super()._match_argument(action, arg_strings_pattern)
        except argparse.ArgumentError as err:
            if not action.option_strings:
                raise
            count = action.nargs if isinstance(action.nargs, int) else 1
            what = "it takes a value" if count == 1 else f"it takes {count} values, with spaces"
            raise argparse.ArgumentError(action, f"{what} (type {_say_form(action)})") from err

    def _refuse_words(self, words: Sequence[str]) -> NoReturn:
        """Refuse words that belong nowhere; for an option, suggest the nearest one."""
        word = words[0].partition("=")[0]
        if word == "%":
            self.error("'%' stands alone (type it behind its number without a space, such as 5%)")
        if not word.startswith("-"):
            config = word.endswith(".toml") and "--config" in self._option_string_actions
            better = f"--config {word}" if config else f"{self.prog} --help"
            self.error(f"{words[0]!r} is one word too many (type {better})")
        bare = word.lstrip("-")
        near = suggest_word(bare, (name.lstrip("-") for name in self._option_string_actions))
        places = [_say_form(a) for a in self._actions if a.dest == bare and not a.option_strings]
        listed = f"--{near}" if near else f"{self.prog} --help"
        if places:
            listed = f"{self.prog} {places[0]}, without {word}"
        self.error(f"there is no {word} (type {listed})")

    def _list_commands(self) -> set[str]:
        """The names of this parser's own commands."""
        return {
            name
            for action in self._actions
            if isinstance(action, argparse._SubParsersAction)  # noqa: SLF001
            for name in action.choices
        }

    def _describe_missing(self, names: str) -> str:
        """A sentence on what was left out, and how to type it."""
        for action in self._actions:
            called = argparse._get_action_name(action)  # noqa: SLF001
            if called and called in names.split(", "):
                if action.choices is not None and not action.option_strings:
                    form = f"one of {', '.join(map(str, action.choices))}"
                else:
                    form = _say_form(action)
                    form = form if action.option_strings else f"{self.prog} {form}"
                return f"{called} is missing (type {form})"
        return f"{names} is missing (type {self.prog} --help)"

    def _shorten_usage(self) -> str:
        """The usage of the command, in one line."""
        whole = self.format_usage().strip().splitlines()
        if len(whole) == 1 or self.usage is not None:
            return whole[0]
        places = [_say_form(a) for a in self._actions if not a.option_strings]
        return " ".join(["usage:", self.prog, "[OPTIONS]", *places])


def _list_options(words: Iterable[str], ends: Container[str]) -> Iterator[str]:
    """Names of the long options among the words, before the first word that is in `ends`."""
    for word in words:
        if word == "--" or word in ends:
            return
        if re.match(r"--[A-Za-z]", word):
            yield word.partition("=")[0]


def _find_command(parser: CommandParser, found: argparse.Namespace) -> CommandParser:
    """The parser of the command that was typed."""
    for action in parser._actions:  # noqa: SLF001
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            name = getattr(found, action.dest, None)
            if name is not None:
                return _find_command(action.choices[name], found)
    return parser


def _call(action: argparse.Action) -> str:
    """The word to type before the values of an option."""
    return action.option_strings[-1] if action.option_strings else ""


def _say_form(action: argparse.Action) -> str:
    """How an option or an argument is typed, with words that stand for its values."""
    if isinstance(action.metavar, tuple):
        values = " ".join(action.metavar)
    elif action.choices is not None and not isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
        values = action.metavar or "{" + ",".join(map(str, action.choices)) + "}"
    else:
        values = action.metavar or action.dest.upper()
    return f"{_call(action)} {values}".strip()
