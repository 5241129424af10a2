"""Texts from outside, made fit for messages: names on a disk and words of devices may be any bytes.

Python keeps bytes that are not UTF-8 as surrogates, which JSON cannot hold.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import msgspec

from pdcd.printable import to_one_line


def encode_json(value: object, enc_hook: Callable[[Any], Any] | None = None) -> bytes:
    """Any message, record or result as JSON, whatever bytes its texts came from.

    Everything that leaves the program as JSON is written by this function. Bytes that are not text
    are escaped as in `to_one_line`. enc_hook : turns other values into plain ones, as for msgspec.
    Raises TypeError for values that JSON cannot express.
    """
    try:
        return msgspec.json.encode(value, enc_hook=enc_hook)
    except UnicodeEncodeError:
        return msgspec.json.encode(_as_text(msgspec.to_builtins(value, enc_hook=enc_hook)))


def _as_text(value: object) -> object:
    if isinstance(value, str):
        return value if _is_text(value) else "".join(map(_escape_half, value))
    if isinstance(value, dict):
        return {_as_text(key): _as_text(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_as_text(entry) for entry in value]
    return value


def _is_text(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def _escape_half(letter: str) -> str:
    return to_one_line(letter) if "\ud800" <= letter <= "\udfff" else letter
