"""Listens to every event of a test and holds it against the schema, by a validator not of ours.

Heard is the JSON itself: what a daemon in this process puts on the wire, what `pdcd.client` takes
from any daemon, and what an engine in this process tells. The schema is that of `rig.describe`;
beyond it, no event may have a field that it does not name.
"""

from __future__ import annotations

import json
from collections import Counter
from functools import cache
from typing import Any

import msgspec
import pytest
from jsonschema import Draft202012Validator

from pdcd.capture.engine import Engine
from pdcd.client import Client
from pdcd.protocol import messages
from pdcd.protocol.events import Emit, Event
from pdcd.protocol.request import CaptureRequest
from pdcd.protocol.result import CaptureResult
from pdcd.recipes.arrays import Given
from pdcd.server import connections, protocol

SEVERAL = 16
"""Of so many events alike that an engine tells of, one is looked at; of the wire every line is."""


@cache
def validators() -> dict[str, Draft202012Validator]:
    """One for each type of event, by what the schema's own `discriminator` says."""
    schema = json.loads(msgspec.json.encode(messages.build_message_schema()))
    Draft202012Validator.check_schema(schema["notifications"]["event"])
    made = {}
    for kind, place in schema["notifications"]["event"]["discriminator"]["mapping"].items():
        named = schema["$defs"][place.removeprefix("#/$defs/")]
        Draft202012Validator.check_schema(named)
        whole = {**named, "additionalProperties": False, "$defs": schema["$defs"]}
        made[kind] = Draft202012Validator(whole)
    return made


class Heard:
    """What a test has heard: how many events of each type, and what was wrong with any."""

    def __init__(self) -> None:
        self.types: Counter[str] = Counter()
        self.faults: list[str] = []

    def take(self, event: dict[str, Any]) -> None:
        """One event as JSON has it."""
        kind = str(event.get("type"))
        self.types[kind] += 1
        validator = validators().get(kind)
        if validator is None:
            self.faults.append(f"{kind} is not in the schema: {event}")
            return
        for error in validator.iter_errors(event):
            self.faults.append(f"{kind}: {error.json_path}: {error.message} in {event}")

    def message(self, message: dict[str, Any]) -> None:
        """One message of the socket, which may be an event."""
        if message.get("method") == "event":
            self.take(message["params"])

    def listen(self, patch: pytest.MonkeyPatch) -> None:
        """Listen at all three places until the patch is undone."""
        encode, receive, capture = (
            protocol.encode_notification,
            Client._receive,
            Engine.capture,
        )

        def encode_notification(method: str, params: Any) -> bytes:
            line = encode(method, params)
            self.message(json.loads(line))
            return line

        def received(client: Client, timeout_s: float | None) -> dict[str, Any]:
            message = receive(client, timeout_s)
            self.message(message)
            return message

        def captured(
            engine: Engine, request: CaptureRequest, *arrays: Given, emit: Emit, **given: Any
        ) -> CaptureResult:
            counted: Counter[tuple[str, tuple[type, ...]]] = Counter()

            def told(event: Event) -> None:
                # Alike are those of one type whose fields have values of the same types.
                values = [getattr(event, name) for name in event.__struct_fields__]
                alike = event.type, tuple(type(value) for value in values)
                if counted[alike] % SEVERAL == 0:
                    self.take(json.loads(msgspec.json.encode(event)))
                counted[alike] += 1
                emit(event)

            return capture(engine, request, *arrays, emit=told, **given)

        patch.setattr(connections, "encode_notification", encode_notification)
        patch.setattr(Client, "_receive", received)
        patch.setattr(Engine, "capture", captured)
