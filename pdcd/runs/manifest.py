"""The manifest as bytes: how it is written, read within limits, and vouched for by a digest.

``capture.json.sha256`` lies beside it, one line as ``sha256sum`` writes it. Any change of either
file is noticed, down to white space. It protects against accidents: somebody who changes a run on
purpose can write a new digest. Against that only a digest kept elsewhere helps (`manifest_sha256`
of the job's result).
"""

from __future__ import annotations

import json
from typing import Any

import msgspec

from pdcd.errors import ConfigError, DecodeError, PdcdError
from pdcd.files.text import encode_json
from pdcd.runs.provenance import list_versions
from pdcd.runs.record import SCHEMA_VERSION, Manifest

MANIFEST = "capture.json"
MANIFEST_DIGEST = "capture.json.sha256"

MAX_MANIFEST_BYTES = 2**26
"""Longest manifest; each exposure takes one to two thousand bytes."""


def encode_manifest(manifest: Manifest) -> bytes:
    """The bytes of capture.json. Raises PdcdError when the manifest could not be read again."""
    data = msgspec.json.format(encode_json(manifest), indent=1)
    if len(data) > MAX_MANIFEST_BYTES:
        raise PdcdError(
            f"the manifest would have {len(data)} bytes, more than {MAX_MANIFEST_BYTES}",
            hint="take fewer exposures in one run",
        )
    return data


class OtherSchemaError(DecodeError):
    """The manifest of a run that another version of pdcd has written; the run may be sound."""


def parse_manifest(data: bytes) -> Manifest:
    """The manifest from the bytes of capture.json. Raises DecodeError, whatever the bytes are; for
    a manifest of another schema OtherSchemaError, which names both schemas."""
    try:
        told = msgspec.json.decode(data, type=dict[str, Any])
        # Of two equal keys a parser may take either; a manifest has none.
        json.loads(data, object_pairs_hook=_once)
        check_schema(told.get("schema"))
        _check_goal(told)
        return msgspec.convert(told, Manifest)
    except ConfigError as err:  # of a sensor profile
        raise _damaged(err.message) from err
    except (msgspec.MsgspecError, ValueError, TypeError, RecursionError, OverflowError) as err:
        raise _damaged(str(err)) from err


def check_schema(schema: object) -> None:
    """Raise OtherSchemaError for any schema but the one that is read here."""
    if type(schema) is not int or schema != SCHEMA_VERSION:
        raise _other_schema(f"{schema!r:.60}")


def _check_goal(told: dict[str, Any]) -> None:
    """Raise OtherSchemaError for the first of all schemas, in which the goal is a word: it was
    numbered 1, too, before the numbers were started again."""
    run = told.get("run")
    if isinstance(run, dict) and isinstance(run.get("goal"), str):
        raise _other_schema(f"{SCHEMA_VERSION} of before schemas were counted anew")


def _other_schema(schema: str) -> OtherSchemaError:
    return OtherSchemaError(
        f"the manifest has schema {schema}; pdcd {list_versions()['pdcd']} reads schema "
        f"{SCHEMA_VERSION}",
        hint="read the run with the pdcd that wrote it: its manifest has versions and git_commit",
    )


def _once(pairs: list[tuple[str, Any]]) -> None:
    names = [name for name, _ in pairs]
    if len(set(names)) != len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"{twice!r} is there twice")


def _damaged(why: str) -> DecodeError:
    return DecodeError(f"{MANIFEST} is damaged: {why}", hint="restore it from a copy")
