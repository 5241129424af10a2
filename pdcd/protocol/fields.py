"""The fields of a request as values: the name of each, what it takes, and how it refuses a value.

They are read once from `CaptureRequest` (or another struct of parameters). All code that shows
fields to people loops over them: the command line, the page, `pdcd.api.arguments`, docs/request.md.
"""

from __future__ import annotations

import functools
import json
import types
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Literal, TypeVar, Union, cast, get_args, get_origin

import msgspec
from msgspec import UNSET, Meta, UnsetType

from pdcd.protocol.about import FieldDescription
from pdcd.protocol.request import CaptureRequest, SentArray

_KindName = Literal["switch", "choice", "number", "numbers", "words", "text", "array", "file"]
"""The kinds of fields, in this order: a yes or no; one of some words; a number, or one of some
words in its place; a fixed count of numbers; any words; a text; an array; a file of arrays, or a
text in its place."""

_Bounds = Mapping[str, float]
_S = TypeVar("_S", bound=msgspec.Struct)

_MOST_SHOWN_BYTES = 200
"""Longest value in JSON, in bytes, that a refusal shows."""

UNTOLD = FieldDescription(group="run")
"""For a field without a description."""


class FieldError(ValueError):
    """A field does not take a value; the message says what it takes."""


@dataclass(frozen=True)
class Field:
    """One field.

    type : as annotated.
    optional : whether it may be None, which means left out.
    default : None where there is none.
    text : what it is.
    takes : its possible values in words; empty where its type does not give them.
    words : the words that it may be.
    whole : whether its numbers are whole.
    count : how many numbers it has.
    share : whether its number lies between 0 and 1.
    """

    name: str
    type: Any
    optional: bool
    default: Any
    text: str
    takes: str
    kind: _KindName
    words: tuple[str, ...]
    whole: bool
    count: int
    share: bool
    about: FieldDescription

    @property
    def label(self) -> str:
        """Its name for people, without the suffix of the unit."""
        return self.name.removesuffix("_s").replace("_", " ")

    @property
    def goals(self) -> tuple[str, ...]:
        """The goals that it is a parameter of."""
        return (*self.about.needed_by, *self.about.taken_by)

    def is_file(self, value: Any) -> bool:
        """Whether a value is a file or the name of one, and not one of the worded values."""
        words = isinstance(value, str) and value.startswith(self.about.worded)
        return self.kind == "array" or (self.kind == "file" and not words)

    def refusal(self, value: Any, called: str = "") -> str:
        """The message that it does not take that value. `called` is the option with which it was
        given."""
        shown = "" if self.kind in ("text", "words") else _shown(value)
        takes = f"1 or {self.takes}" if called and self.about.one_is_both else self.takes
        told = f"{called} takes" if called else f"{self.name}: it takes"
        percent = ""
        if called and self.share and isinstance(value, float) and 1.0 <= value < 100.0:
            percent = f" (type {called} {value:g}% for {value / 100.0:g})"
        return f"{told} {takes}" + f", not {shown}" * bool(shown) + percent

    @functools.cached_property
    def decoder(self) -> msgspec.json.Decoder[Any]:
        """Decodes its values; made once, because making it takes longer than decoding many of
        them."""
        return msgspec.json.Decoder(self.type)

    def check(self, raw: msgspec.Raw) -> None:
        """Raise FieldError, with `refusal`, where the field does not take a value in JSON."""
        try:
            self.decoder.decode(raw)
        except (ValueError, OverflowError, RecursionError) as err:
            short = len(memoryview(raw)) <= _MOST_SHOWN_BYTES
            raise FieldError(self.refusal(_decode_any(raw) if short else {})) from err

    def convert(self, value: Any, called: str = "") -> Any:
        """The value in the field's own type. Raises FieldError with `refusal`."""
        try:
            return msgspec.convert(value, self.type, strict=True)
        # Besides msgspec's error: what Python raises for huge numbers and for too deep nesting.
        except (ValueError, OverflowError, RecursionError) as err:
            raise FieldError(self.refusal(value, called)) from err


@functools.cache
def fields_of(kind: type[msgspec.Struct]) -> Mapping[str, Field]:
    """The fields of a struct by name, in its order."""
    return {each.name: _field(each) for each in msgspec.structs.fields(kind)}


def list_request_fields() -> Mapping[str, Field]:
    """The fields of a request for a photo."""
    return fields_of(CaptureRequest)


def list_needed_fields(goal: str) -> tuple[str, ...]:
    """Parameters that a goal needs."""
    return tuple(
        field.name for field in list_request_fields().values() if goal in field.about.needed_by
    )


def list_optional_fields(goal: str) -> tuple[str, ...]:
    """Further parameters that a goal may be given."""
    return tuple(
        field.name for field in list_request_fields().values() if goal in field.about.taken_by
    )


def convert_fields(kind: type[msgspec.Struct], values: Mapping[str, Any]) -> dict[str, Any]:
    """Values of some fields of a struct, each in the field's own type; None values are left out.
    Raises FieldError."""
    fields = fields_of(kind)
    return {n: fields[n].convert(value) for n, value in values.items() if value is not None}


def decode_struct(data: bytes | msgspec.Raw, kind: type[_S]) -> _S:
    """A message in JSON as its struct.

    Fields that the struct does not have are not decoded, so that a line costs no more than its
    length. Raises FieldError where one of its fields is wrong; for everything else the errors of
    msgspec and Python: ValueError, OverflowError, RecursionError.
    """
    whole, loose = _decoders(kind)
    try:
        return cast(_S, whole.decode(data))
    except (msgspec.ValidationError, OverflowError, RecursionError):
        try:
            given = loose.decode(data)
        except (ValueError, RecursionError):
            given = None
        for name, field in fields_of(kind).items():
            raw = getattr(given, name, UNSET)
            if raw is not UNSET and field.takes:
                field.check(raw)
        raise


@functools.cache
def _decoders(
    kind: type[msgspec.Struct],
) -> tuple[msgspec.json.Decoder[Any], msgspec.json.Decoder[Any]]:
    """The decoder of a struct, and that of a struct with the same names whose fields take
    anything."""
    names = [(name, msgspec.Raw | UnsetType, UNSET) for name in kind.__struct_fields__]
    loose = msgspec.defstruct(f"Loose{kind.__name__}", names)
    return msgspec.json.Decoder(kind), msgspec.json.Decoder(loose)


def _decode_any(raw: msgspec.Raw) -> Any:
    """A value in JSON types; where Python cannot decode it, a value that no refusal shows."""
    try:
        return msgspec.json.decode(raw)
    except (ValueError, RecursionError):
        return {}


def _field(told: msgspec.structs.FieldInfo) -> Field:
    bare, metas = _bare(told.type)
    options = [option for option in _options(bare) if option is not type(None)]
    extra: dict[str, Any] = {}
    text = ""
    for meta in metas:
        extra |= meta.extra or {}
        text = meta.description or text
    words = tuple(word for each in options for word in _words(each))
    numbers = [each for each in options if _bare(each)[0] in (int, float)]
    tuples = [each for each in options if _is_row(each)]
    items = get_args(_bare(tuples[0])[0]) if tuples else ()
    number = (items or numbers or [None])[0]
    bounds = _bounds(number)
    return Field(
        name=told.name,
        type=told.type,
        optional=len(options) < len(_options(bare)),
        default=None if told.required else told.default,
        text=text,
        takes=extra.get("takes") or _takes(told.type),
        kind=_kind(options, words),
        words=words,
        whole=_bare(number)[0] is int,
        count=len(items),
        share=bool(numbers) and _bare(number)[0] is float and bounds.get("lt") == 1.0,
        about=extra.get("about", UNTOLD),
    )


def _kind(options: list[Any], words: tuple[str, ...]) -> _KindName:
    bare = [_bare(option)[0] for option in options]
    if SentArray in bare:
        return "array" if any(get_origin(each) is tuple for each in bare) else "file"
    if int in bare or float in bare:
        return "number"
    if words:
        return "choice"
    if bare == [bool]:
        return "switch"
    if any(map(_is_row, options)):
        return "numbers"
    return "words" if get_origin(bare[0]) is tuple else "text"


def _bare(kind: Any) -> tuple[Any, list[Meta]]:
    """A type without its annotations, and the annotations."""
    if get_origin(kind) is Annotated:
        inner, *metas = get_args(kind)
        return inner, [meta for meta in metas if isinstance(meta, Meta)]
    return kind, []


def _options(kind: Any) -> tuple[Any, ...]:
    """The types of a union, or the single type."""
    return get_args(kind) if get_origin(kind) in (Union, types.UnionType) else (kind,)


def _words(kind: Any) -> tuple[str, ...]:
    bare = _bare(kind)[0]
    return get_args(bare) if get_origin(bare) is Literal else ()


def _is_row(kind: Any) -> bool:
    """Whether it is a tuple of a fixed count of numbers."""
    bare = _bare(kind)[0]
    return get_origin(bare) is tuple and Ellipsis not in get_args(bare)


def _bounds(kind: Any) -> _Bounds:
    """Bounds of a number by their names in msgspec."""
    names = ("gt", "ge", "lt", "le", "multiple_of")
    told = ((name, getattr(meta, name)) for meta in _bare(kind)[1] for name in names)
    return {name: value for name, value in told if value is not None}


def _takes(kind: Any) -> str:
    """The values of a type in words; the words of its annotation where it has some."""
    bare, metas = _bare(kind)
    for meta in metas:
        if meta.extra and "takes" in meta.extra:
            return str(meta.extra["takes"])
    if get_origin(bare) in (Union, types.UnionType):
        options = [option for option in get_args(bare) if option is not type(None)]
        words = [word for each in options for word in _words(each) or _switched(each)]
        other = [_takes(each) for each in options if not (_words(each) or _switched(each))]
        return _either([*other, *words])
    if bare in (int, float):
        return f"{_noun(kind, 'a ')} {_range(kind)}".rstrip()
    if _words(bare) or bare is bool:
        return _either(_words(bare) or _switched(bare))
    most = [meta.max_length for meta in metas if meta.max_length is not None]
    if get_origin(bare) is tuple:
        items = get_args(bare)
        if Ellipsis not in items:
            return f"{len(items)} {_noun(items[0])}s {_range(items[0])}".rstrip()
        of = f"up to {most[0]}" if most else "any number of"
        return f"{of} words, each {_takes(items[0])}"
    if bare is str:
        return f"a text of up to {most[0]} characters" if most else "a text"
    return ""


def _switched(kind: Any) -> tuple[str, ...]:
    return ("true", "false") if kind is bool else ()


def _either(words: Sequence[str]) -> str:
    *most, last = words
    return f"{', '.join(most)} or {last}" if most else last


def _noun(kind: Any, article: str = "") -> str:
    """The noun for a number: "a multiple of 4", "whole number"."""
    several = _bounds(kind).get("multiple_of")
    if several is not None:
        return f"{article}multiple of {several:g}"
    return article + ("whole number" if _bare(kind)[0] is int else "number")


def _range(kind: Any) -> str:
    """The bounds of a number in words: "from 1 to 64", "over 0 and below 1"."""
    bounds = dict(_bounds(kind))
    if _bare(kind)[0] is int and "lt" in bounds:
        bounds["le"] = bounds.pop("lt") - 1
    said = {"ge": "from", "gt": "over", "le": "to" if "ge" in bounds else "up to", "lt": "below"}
    parts = [f"{said[name]} {_figure(bounds[name])}" for name in said if name in bounds]
    return (" " if "ge" in bounds and "le" in bounds else " and ").join(parts)


def _shown(value: Any) -> str:
    """A value in a few printable characters; "" where that is not possible."""
    row = isinstance(value, list | tuple)
    parts = value if row and len(value) <= 9 else [value]
    if not all(isinstance(part, str | bool | float) or _is_short(part) for part in parts):
        return ""
    text = ", ".join(map(json.dumps, parts))
    text = f"[{text}]" if row else text
    return text if len(text) <= 40 else ""


def _is_short(value: Any) -> bool:
    return isinstance(value, int) and abs(value) < 10**15


def _figure(number: float) -> str:
    return f"{number:d}" if isinstance(number, int) else f"{number:.12g}"


ARRAY_FIELDS = tuple(
    field.name for field in list_request_fields().values() if field.kind == "array"
)
"""Fields of a photo that are arrays. Other fields may be files with several arrays."""
