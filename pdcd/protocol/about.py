"""The description of a request's field for people, written beside its type.

`pdcd.protocol.fields` reads it. From there it reaches the options of the command line, the keywords
from Python, the form of the page, refusals in words, and docs/request.md.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from msgspec import Meta

from pdcd.words import GoalName

_GroupName = Literal["goal", "codes", "planning", "photo", "run", "calibration"]

GROUPS: Mapping[_GroupName, tuple[str, str]] = {
    "codes": ("codes", "how many, how they are made, and how they are spent"),
    "planning": ("planning", "codes and exposures by a wanted error or a time"),
    "photo": ("exposure and panels", "what you leave out comes from the configuration"),
    "goal": (
        "parameters of goals",
        "each goal takes its own; arrays have one value for each cell, except the last two",
    ),
    "run": ("the run", "where it goes, and labels to find it by"),
    "calibration": ("calibration", "what a bench measures of itself, by steps"),
}
"""Title of each group of fields, and the line below it."""


@dataclass(frozen=True, kw_only=True)
class FieldDescription:
    """What people are told about a field besides its text; `describe_field` makes it.

    group : where the field is shown.
    option : its name on the command line, where that is not the field's own.
    metavar : stands for its value on the command line, or for each of its values.
    needed_by, taken_by : goals that it is a parameter of; both empty: it is no parameter of goals.
    common : whether the form of the page shows it at once.
    one_is_both : whether one number may be typed for a pair of equal ones.
    switched : help of the two switches of a field that takes true, false or a word.
    worded : for a field that takes files, the prefixes of values that are not files.
    """

    group: _GroupName
    option: str = ""
    metavar: str | tuple[str, ...] = ""
    needed_by: Collection[GoalName] = ()
    taken_by: Collection[GoalName] = ()
    common: bool = False
    one_is_both: bool = False
    switched: tuple[str, str] = ("", "")
    worded: tuple[str, ...] = ()


def describe_field(
    text: str,
    group: _GroupName,
    metavar: str | tuple[str, ...] = "",
    *,
    takes: str = "",
    **more: Any,
) -> Meta:
    """Annotate a field with its description for people.

    text : what it is, without a capital or a full stop; also `description` of the JSON Schema.
    takes : its possible values in words, where its type does not say it well.
    All else : fields of `FieldDescription`.
    """
    extra: dict[str, object] = {"about": FieldDescription(group=group, metavar=metavar, **more)}
    if takes:
        extra["takes"] = takes
    return Meta(description=text, extra=extra)


def describe_array(
    text: str, *, needed_by: Collection[GoalName] = (), taken_by: Collection[GoalName] = ()
) -> Meta:
    """Annotate a parameter of goals that is an array, as `describe_field` does other fields."""
    takes = "rows of numbers, or a file (.npy, .npz or grey PNG)"
    return describe_field(text, "goal", "FILE", takes=takes, needed_by=needed_by, taken_by=taken_by)
