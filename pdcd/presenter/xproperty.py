"""Properties of RandR outputs, of any format."""

from __future__ import annotations

from typing import Any

from Xlib import X
from Xlib.ext import randr
from Xlib.protocol import rq


class _GetOutputProperty(randr.GetOutputProperty):  # type: ignore[misc]
    """python-xlib's own takes the number of items for that of bytes."""

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


def read_property(display: Any, output: int, name: str, words: int) -> tuple[int, Any] | None:
    """Bits of an item, and the items, of an output's property; None when it has none.

    `words` is how much is asked for at most, in units of 4 bytes. Raises what python-xlib raises.
    """
    atom = display.intern_atom(name, True)
    if atom == X.NONE:
        return None
    reply = _GetOutputProperty(
        display=display.display,
        opcode=display.display.get_extension_major(randr.extname),
        output=output,
        property=atom,
        type=X.AnyPropertyType,
        long_offset=0,
        long_length=words,
        delete=False,
        pending=False,
    )
    found: tuple[int, Any] | None = reply.value
    return found
