"""The fields of a request as the page draws them: values of JSON, made in a loop.

The page knows none of them by name; what is wrong with a value is told by `pdcd.web.app`, in the
words of `pdcd.protocol.fields`.
"""

from __future__ import annotations

from typing import Any

from pdcd.protocol.about import GROUPS
from pdcd.protocol.fields import Field, request_fields


def form_groups() -> list[dict[str, Any]]:
    """All fields but the goal, group by group: `title` and `fields`; parameters of goals first."""
    groups = []
    for name in sorted(GROUPS, key=lambda name: name != "goal"):
        fields = [
            _described(field)
            for field in request_fields().values()
            if field.about.group == name and field.name != "goal"
        ]
        if fields:
            groups.append({"title": GROUPS[name][0], "fields": fields})
    return groups


def _described(field: Field) -> dict[str, Any]:
    """One field.

    `values` are those that it may be, or words that it may be in the place of a number; `common`
    fields are shown at once.
    """
    values: list[bool | str] = list(field.words)
    if field.kind == "switch" or "true" in field.takes:
        values = [True, False, *values]
    return {
        "name": field.name,
        "label": field.label,
        "text": field.text,
        "takes": field.takes,
        "kind": field.kind,
        "values": values,
        "count": field.count,
        "optional": field.optional,
        "default": field.default or None if field.kind == "text" else field.default,
        "common": field.about.common,
        "of_goals": bool(field.goals),
    }
