"""Properties of RandR outputs, read by name.

Source of the protocol: X Resize, Rotate and Reflect extension 1.6 (randrproto).
"""

from __future__ import annotations

from typing import Any

from Xlib import X, Xatom, error
from Xlib.ext import randr
from Xlib.protocol import rq

PropertyValue = int | str
"""An item of a property: a number without a sign, or the name of an atom."""

_WORDS = 1 << 14
"""Longest property that is read, in units of 4 bytes: tables of 4096 colours have 8192."""


def read_property(display: Any, output: int, name: str) -> tuple[int, Any] | None:
    """The value of a property of an output: bits of an item and the items, (8, bytes) or
    (16 or 32, array); None where the output has no property of that name.

    Raises what python-xlib raises.
    """
    reply = _ask(display, output, name)
    return None if reply is None else reply.value


def read_property_values(display: Any, output: int, name: str) -> tuple[PropertyValue, ...]:
    """The same as numbers or names; empty where there is no such property."""
    reply = _ask(display, output, name)
    if reply is None or reply.value is None:
        return ()
    items = [int(item) for item in reply.value[1]]
    if reply.property_type == Xatom.ATOM:
        return tuple(_name_atom(display, item) for item in items)
    return tuple(items)


def _name_atom(display: Any, atom: int) -> str:
    """The atom's name; "?" for an unknown atom, as any program may have written the property."""
    try:
        return str(display.get_atom_name(atom))
    except error.BadAtom:
        return "?"


def _ask(display: Any, output: int, name: str) -> Any | None:
    atom = display.intern_atom(name, True)
    if atom == X.NONE:
        return None
    return _GetOutputProperty(
        display=display.display,
        opcode=display.display.get_extension_major(randr.extname),
        output=output,
        property=atom,
        type=X.AnyPropertyType,
        long_offset=0,
        long_length=_WORDS,
        delete=False,
        pending=False,
    )


class _GetOutputProperty(randr.GetOutputProperty):  # type: ignore[misc]
    """Replaces python-xlib's own, which takes the number of items for that of bytes."""

    _reply = rq.Struct(
        rq.ReplyCode(),
        rq.Format("value", 1),
        rq.Card16("sequence_number"),
        rq.ReplyLength(),
        rq.Card32("property_type"),
        rq.Card32("bytes_after"),
        rq.LengthOf("value", 4),
        rq.Pad(12),
        rq.PropertyData("value"),
    )
