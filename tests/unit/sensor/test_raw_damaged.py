"""Files of eleven forms, cut, with a tail of zeros and with holes, at twenty places each."""

from __future__ import annotations

import zlib
from pathlib import Path

import numpy as np
import pytest

from pdcd.errors import DecodeError
from pdcd.sensor.raw import read_raw
from pdcd.sensor.tiff import read_tags
from tests.form_dng import DngFile, write_dng_form
from tests.hostile.photos import list_damage, make_formats, read_samples


@pytest.mark.parametrize("seed", [1, 2])
def test_what_is_damaged_is_refused_or_nothing_of_it_was_lost(tmp_path: Path, seed: int) -> None:
    counted = 0
    for name, data in make_formats(tmp_path, seed).items():
        path = tmp_path / name
        path.write_bytes(data)
        whole = read_samples(path)
        for kind, damaged in list_damage(data):
            path.write_bytes(damaged)
            counted += 1
            try:
                found = read_samples(path)
            except DecodeError:
                continue
            assert np.array_equal(found, whole), (name, kind, counted)
    assert counted == 11 * 20 * 3


@pytest.mark.parametrize("harm", ["flipped", "longer"])
def test_deflated_samples_carry_a_check_sum(tmp_path: Path, harm: str) -> None:
    """What is inflated of a damaged part may be as long as what was written."""
    path = tmp_path / "a.dng"
    real = np.random.default_rng(0).uniform(0.1, 0.9, (32, 32))
    file = DngFile(bits=32, floating=True, packing=8, white=1, black=((0.0,),))
    data = bytearray(write_dng_form(path, real, file))
    tags = read_tags(bytes(data))
    assert tags is not None
    (at,), (size,) = tags.numbers(273), tags.numbers(279)
    if harm == "flipped":
        data[at + size - 1] ^= 1
    else:
        more = zlib.compress(zlib.decompress(data[at : at + size]) + bytes(128), 1)
        assert len(more) >= size
        data[at:] = more
        place = data.index(size.to_bytes(4, "little"), 8)
        data[place : place + 4] = len(more).to_bytes(4, "little")
    assert read_raw(path).frame == (16, 16)
    path.write_bytes(bytes(data))
    with pytest.raises(DecodeError, match="not all samples are in it"):
        read_raw(path)
