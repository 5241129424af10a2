"""What people call a run, and find it by: its name, its tags, a note."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from pdcd.words import NAME_WORDS, NOTE_WORDS, TAG_WORDS

# A `$` alone would let a newline pass behind it. The pattern of a text tells nobody what it may be:
# `takes` does.
Label = Annotated[
    str,
    Meta(
        max_length=80,
        pattern=r"^(?! )[\w .,:;+=()#'&%@-]+(?<! )$(?!\n)",
        description=NAME_WORDS,
        extra={"takes": NAME_WORDS},
    ),
]
"""What a run is called by people. It needs not be unique, and holds no /: it is no path."""
Tag = Annotated[
    str,
    Meta(
        max_length=40,
        pattern=r"^[\w][\w.:+@-]*$(?!\n)",
        description=TAG_WORDS,
        extra={"takes": TAG_WORDS},
    ),
]
"""A word that runs are found by."""
NoteText = Annotated[
    str,
    Meta(
        max_length=4096,
        # Neither orders to a terminal nor marks that turn the direction of writing; nor halves of
        # characters, which are bytes of another encoding that a terminal gave.
        pattern="^[^\\x00-\\x08\\x0b-\\x1f\\x7f-\\x9f\\u2028-\\u202e\\u2066-\\u2069\\ud800-\\udfff]*$",
        description=NOTE_WORDS,
        extra={"takes": NOTE_WORDS},
    ),
]
MOST_TAGS = 16
