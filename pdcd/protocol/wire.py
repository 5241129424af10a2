"""JSON that cannot fail for the sake of a text.

A name that came from a disk, a camera or another user's file may hold what is no character: halves
of pairs, which Python has for bytes that are no UTF-8 (PEP 383). JSON has no place for them.
"""

from __future__ import annotations

import msgspec


def encode_json(value: object) -> bytes:
    """The value as JSON; what is no character in its texts stands there as ``\\udce9``, in words.

    Who writes to a socket, a browser or stdout calls this. Raises TypeError for what has no form in
    JSON.
    """
    try:
        return msgspec.json.encode(value)
    except UnicodeEncodeError:
        return msgspec.json.encode(_spell_out(msgspec.to_builtins(value)))


def _spell_out(value: object) -> object:
    if isinstance(value, str):
        return value.encode(errors="backslashreplace").decode()
    if isinstance(value, dict):
        return {_spell_out(key): _spell_out(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_spell_out(each) for each in value]
    return value
