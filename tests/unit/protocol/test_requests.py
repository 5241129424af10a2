"""Requests: the bounds of every field, the first value beyond each, and what is left out."""

from __future__ import annotations

import json
from datetime import datetime, timedelta, timezone
from typing import Any

import msgspec
import pytest

from pdcd.protocol.fields import (
    ARRAY_FIELDS,
    UNTOLD,
    FieldError,
    decode_struct,
    fields_of,
    list_needed_fields,
    list_optional_fields,
    list_request_fields,
)
from pdcd.protocol.request import CalibrateRequest, CaptureRequest, SentArray
from pdcd.protocol.result import (
    Quality,
    format_job_time,
    make_job_id,
    quality_of,
    read_summary_value,
)
from tests import request_page

TINY = 5e-324
NAME = "x" * 4096
BOUNDS: dict[str, tuple[list[Any], list[Any]]] = {
    "goal": (["indirect", "transport"], ["", "Indirect", 1]),
    "codes": ([1, 65536], [0, 65537, 1.5]),
    "p": ([TINY, 0.999], [0.0, 1.0]),
    "shift": ([[-65536, 65536]], [[-65537, 0], [0, 65537], [1], [1, 2, 3]]),
    "radius": ([0, 65536], [-1, 65537]),
    "mix": ([[-1e6, 1e6]], [[-1.1e6, 0.0], [0.0, 1.1e6], [1.0]]),
    "period": ([4, 8, 65536], [0, 3, 6, 65540]),
    "disparity": ([[-65536, 65536]], [[0, 65537]]),
    "plane": ([[1e6] * 9, [-1e6] * 9], [[1.0] * 8, [1.1e6] * 9, [-1.1e6] * 9]),
    "rows": ([[0, 0], [-65536, 65536]], [[0], [65537, 0]]),
    "pilot": ([0, 4096, "auto"], [-1, 4097, "some"]),
    "parts": ([1, 64, "auto"], [0, 65, "some"]),
    "until_error": ([TINY, 0.999], [0.0, 1.0]),
    "repeat": ([1, 1024], [0, 1025]),
    "error": ([TINY, 0.999], [0.0, 1.0]),
    "confidence": ([0.5, 0.999], [0.499, 1.0]),
    "seconds": ([TINY, 86400.0], [0.0, 86401.0]),
    "seed": ([0, 2**53 - 1], [-1, 2**53]),
    "exposure_s": ([TINY, 3600.0], [0.0, 3601.0]),
    "white_patch": ([[0.0, 1.0]], [[-0.001, 0.5], [0.5, 1.001], [0.5]]),
    "prior": ([NAME], [NAME + "x"]),
    "codes_from": ([NAME], [NAME + "x"]),
    "tags": ([["a"] * 16, ["x" * 40]], [["a"] * 17, ["x" * 41], [""], ["a\n"], ["-a"]]),
    "name": (["x" * 80, "a (b), c"], ["x" * 81, "a/b", " a", "a ", "a\n", ""]),
    "note": (
        [NAME, "two\nlines\t", "Bl\u00e4tter \U0001f4f7"],
        [NAME + "x", "\x1b[2J", "\u202e", "\x00", "\x7f"],
    ),
    **{array: ([NAME, [[1.0, -2.0]]], [NAME + "x", [["a"]]]) for array in ARRAY_FIELDS},
}  # fmt: skip
FREE = {"family", "equal_brightness", "keep", "keep_raw", "masked", "method", "smooth",
        "grey_masks", "window", "guards", "black_level", "normalise", "white", "out"}  # fmt: skip
"""Fields of words and switches, whose types say all."""


def asked(**fields: Any) -> CaptureRequest:
    return msgspec.json.decode(
        msgspec.json.encode({"goal": "indirect", **fields}), type=CaptureRequest
    )


def test_every_field_tells_people_what_it_is_and_takes() -> None:
    for kind in (CaptureRequest, CalibrateRequest):
        for field in fields_of(kind).values():
            assert field.text and field.takes and field.about is not UNTOLD, field.name
            assert field.text[0].islower() and not field.text.endswith("."), field.name
    assert set(ARRAY_FIELDS) == {
        name for name in BOUNDS if BOUNDS[name][0] == [NAME, [[1.0, -2.0]]]
    }


@pytest.mark.parametrize(
    ("name", "takes"),
    [
        ("codes", "a whole number from 1 to 65536"),
        ("p", "a number over 0 and below 1"),
        ("confidence", "a number from 0.5 and below 1"),
        ("seconds", "a number over 0 and up to 86400"),
        ("seed", "a whole number from 0 to 9007199254740991"),
        ("period", "a multiple of 4 from 4 to 65536"),
        ("plane", "9 numbers from -1000000 to 1000000"),
        ("parts", "a whole number from 1 to 64 or auto"),
        ("guards", "true, false, none, both, lag, lead, tail, full, wide, dark or auto"),
        ("masked", "true or false"),
        ("keep", "in or out"),
        ("out", "a text"),
    ],
)
def test_what_a_field_takes_is_said_in_words(name: str, takes: str) -> None:
    assert list_request_fields()[name].takes == takes


@pytest.mark.parametrize(
    ("name", "value", "shown"),
    [
        ("codes", 0, ", not 0"),
        ("codes", "many", ', not "many"'),
        ("codes", True, ", not true"),
        ("codes", 10**400, ""),
        ("codes", [[1]] * 9, ""),
        ("shift", [1, 2, 3], ", not [1, 2, 3]"),
        ("name", "a/b", ""),
    ],
)
def test_a_refusal_names_what_is_taken_and_a_short_value(name: str, value: Any, shown: str) -> None:
    field = list_request_fields()[name]
    with pytest.raises(FieldError) as caught:
        field.convert(value, "--x")
    assert str(caught.value) == f"--x takes {field.takes}{shown}"


def test_a_message_is_refused_by_its_wrong_field() -> None:
    assert decode_struct(b'{"goal": "white"}', CaptureRequest) == CaptureRequest(goal="white")
    for wrong, why in (
        ({"goal": "whit"}, r'^goal: it takes white, indirect.* not "whit"'),
        ({"goal": "white", "codes": 1e9}, r"^codes: it takes .*, not 1000000000.0$"),
        ({"goal": "white", "kernel": [["x"] * 200]}, r"^kernel: it takes [^x]*$"),
    ):
        with pytest.raises(FieldError, match=why):
            decode_struct(json.dumps(wrong).encode(), CaptureRequest)
    for other in (b"{}", b"[]", b'{"goal": "white", "gaol": 1}'):
        with pytest.raises(msgspec.ValidationError, match=r"required field|object|`gaol`"):
            decode_struct(other, CaptureRequest)


def test_goals_take_what_the_fields_say() -> None:
    assert list_needed_fields("two-samples") == ("mix", "warp", "warp_b")
    assert list_optional_fields("keyed") == (
        "disparity",
        "plane",
        "illumination",
        "disparities",
        "warp",
    )
    assert list_needed_fields("white") == () and list_optional_fields("transport") == (
        "rows",
        "masked",
    )


def test_docs_request_is_the_page_that_the_fields_make() -> None:
    assert request_page.PATH.read_text() == request_page.page(), "python -m tests.request_page"


def test_no_field_is_without_a_bound() -> None:
    assert set(BOUNDS) | FREE == set(CaptureRequest.__struct_fields__)


@pytest.mark.parametrize("field", BOUNDS)
def test_values_are_taken_up_to_the_bound_and_refused_beyond(field: str) -> None:
    good, bad = BOUNDS[field]
    for value in good:
        found = getattr(asked(**{field: value}), field)
        assert msgspec.json.decode(msgspec.json.encode(found)) == value
    for value in bad:
        with pytest.raises(msgspec.ValidationError, match=field):
            asked(**{field: value})


def test_what_is_left_out_is_left_to_the_rig() -> None:
    named = {"goal": "indirect", "method": "coded", "repeat": 1, "seed": 0, "white": True,
             "equal_brightness": False, "tags": (), "note": ""}  # fmt: skip
    found = asked()
    for field in CaptureRequest.__struct_fields__:
        assert getattr(found, field) == named.get(field), field
    assert CalibrateRequest() == CalibrateRequest(steps=(), attended=False)


@pytest.mark.parametrize("kind", [CaptureRequest, CalibrateRequest, SentArray])
def test_unknown_fields_are_refused(kind: type) -> None:
    with pytest.raises(msgspec.ValidationError, match="unknown field"):
        msgspec.json.decode(b'{"goal": "indirect", "gaol": 1}', type=kind)


@pytest.mark.parametrize(
    ("fields", "good"),
    [
        ({"fd": 0}, True), ({"fd": 63, "file": "a.npy"}, True), ({"fd": 64}, False),
        ({"fd": -1}, False), ({"npy": ""}, True), ({"file": "x" * 255}, True),
        ({"file": "x" * 256}, False),
    ],
)  # fmt: skip
def test_arrays_come_by_few_descriptors_and_short_names(fields: Any, good: bool) -> None:
    line = msgspec.json.encode(fields)
    if good:
        # What was not given is not written again.
        assert msgspec.json.encode(msgspec.json.decode(line, type=SentArray)) == line
    else:
        with pytest.raises(msgspec.ValidationError):
            msgspec.json.decode(line, type=SentArray)


def test_priors_in_words_are_no_files() -> None:
    prior, own = (list_request_fields()[name] for name in ("prior", "codes_from"))
    assert not prior.is_file("scene:corner") and not prior.is_file("decay:4")
    assert all(map(prior.is_file, ("corner.npz", " scene:corner", SentArray(fd=0))))
    assert own.is_file("scene:corner")


def test_figures_of_a_summary() -> None:
    verdict = Quality(verdict="good")
    summary: dict[str, Any] = {"quality": verdict, "codes": 128, "rms_error_quads": None}
    assert quality_of(summary) == verdict
    assert quality_of({"quality": "good"}) is quality_of({}) is None
    assert read_summary_value(summary, "codes") == 128
    assert (
        read_summary_value(summary, "quality")
        is read_summary_value(summary, "rms_error_quads")
        is None
    )


def test_jobs_are_named_by_their_time_everywhere_the_same() -> None:
    moment = datetime(2024, 2, 29, 23, 30, 5, tzinfo=timezone(timedelta(hours=-2)))
    assert format_job_time(moment) == "20240301T013005Z"
    first, second = make_job_id(), make_job_id()
    assert first != second and len(first) == len("20240301T013005Z-12ab")
    int(first.rpartition("-")[2], 16)
