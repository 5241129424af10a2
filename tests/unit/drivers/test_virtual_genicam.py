"""The virtual machine-vision camera, as programs of others see it: the committee's GenApi reads its
description, and a client that is not Aravis takes its frames."""

from __future__ import annotations

import pytest

pytest.importorskip("drivers.virtual_genicam.bench", reason="Aravis IS MISSING (libaravis-0.8-0)")

import struct
import time
from typing import Any

import numpy as np

from drivers.genicam.pixels import BY_NAME, unpack_samples
from drivers.virtual_genicam.bench import order_mosaic
from drivers.virtual_genicam.description import (
    STARTED_ANEW,
    CameraDescription,
    Register,
    write_description,
)
from drivers.virtual_genicam.simulator import VIRTUAL_ADDRESS
from pdcd.bench.clock import RealClock
from pdcd.driver import DeviceLost
from tests.genicam_rig import Sheets, hosted, needs_aravis

FORMATS = ("BayerRG12p", "Mono16")


def test_the_committees_own_software_reads_the_description() -> None:
    genapi: Any = pytest.importorskip("genicam.genapi", exc_type=ImportError)
    memory = bytearray(0x10000)

    class Port(genapi.AbstractPort):  # type: ignore[misc]
        def is_open(self) -> bool:
            return True

        def get_access_mode(self) -> Any:
            return genapi.EAccessMode.RW

        def get_principal_interface_type(self) -> Any:
            return genapi.EInterfaceType.intfIPort

        def read(self, address: int, length: int) -> bytes:
            return bytes(memory[address : address + length])

        def write(self, address: int, data: bytes) -> None:
            memory[address : address + len(data)] = data

    def word(register: Register) -> int:
        return int(struct.unpack_from(">I", memory, register)[0])

    values = {
        Register.WIDTH: 64, Register.HEIGHT: 48, Register.SENSOR_WIDTH: 64,
        Register.SENSOR_HEIGHT: 48, Register.PIXEL_FORMAT: BY_NAME["BayerRG12p"].code,
        Register.WHITE: 4095, Register.TEMPERATURE_CC: 4150, Register.WAITS: 1,
    }  # fmt: skip
    for register, value in values.items():
        struct.pack_into(">I", memory, register, value)
    formats = tuple(BY_NAME[name] for name in FORMATS)
    nodes = genapi.NodeMap()
    nodes.load_xml_from_string(write_description(CameraDescription(64, 48, formats, 4095)).decode())
    port = Port()
    nodes.connect(port, "Device")
    assert nodes.PixelFormat.symbolics == FORMATS and nodes.PixelFormat.value == "BayerRG12p"
    assert (nodes.Width.value, nodes.Height.max, nodes.PixelDynamicRangeMax.value) == (64, 48, 4095)
    assert nodes.PayloadSize.value == 64 * 48 * 3 // 2
    assert nodes.DeviceTemperature.value == 41.5 and nodes.AcquisitionStatus.value
    nodes.ExposureTime.value = 12345.0
    nodes.Gain.value = 6.02
    nodes.PixelFormat.value = "Mono16"
    nodes.ExposureMode.value = "TriggerWidth"
    nodes.TriggerSoftware.execute()
    nodes.AcquisitionStart.execute()
    assert word(Register.EXPOSURE_US) == 12345 and word(Register.GAIN_CDB) == 602
    assert word(Register.PIXEL_FORMAT) == BY_NAME["Mono16"].code
    assert word(Register.EXPOSURE_MODE) == 1 and word(Register.TRIGGER) == 1
    assert word(Register.ACQUISITION) == STARTED_ANEW and nodes.PayloadSize.value == 64 * 48 * 2
    with pytest.raises(Exception, match="24"):
        nodes.Gain.value = 25.0


@needs_aravis
def test_a_client_that_is_not_aravis_takes_its_frames() -> None:
    gige: Any = pytest.importorskip("pyGigEVision")
    film, clock = Sheets(), RealClock()
    with hosted("Mono16", film=film, clock=clock) as virtual:
        client, xml = gige.bootstrap(VIRTUAL_ADDRESS)
        receiver = gige.GVSPReceiver(VIRTUAL_ADDRESS, camera_ip=VIRTUAL_ADDRESS, packet_size=1400)
        receiver.resend_enabled = False
        try:
            text = xml if isinstance(xml, str) else xml.decode()
            assert 'Name="ExposureTime"' in text
            receiver.start()
            for register, value in (
                (0x0D18, struct.unpack(">I", bytes((127, 0, 0, 1)))[0]),
                (0x0D00, receiver.port),
                (0x0D04, 1400),
                (Register.TRIGGER_MODE, 1),
                (Register.EXPOSURE_US, 2000),
                (Register.ACQUISITION, STARTED_ANEW),
            ):
                client.write_reg(int(register), value)
            for number in range(1, 11):
                client.write_reg(int(Register.TRIGGER), 1)
                found = receiver.get_frame_with_info(timeout=10.0)
                assert found is not None
                samples, told = found
                assert told["complete"] and np.array_equal(samples, film.last)
                while virtual.exposures < number or not client.read_reg(int(Register.WAITS)):
                    time.sleep(0.001)
        finally:
            receiver.stop()
            receiver.close()
            client.disconnect()


@needs_aravis
def test_there_is_one_at_a_time() -> None:
    film = Sheets()
    with hosted("Mono8", film=film) as first:
        first.start()  # it is there already
        with pytest.raises(DeviceLost, match="listen"):
            type(first)(first.description, first.film, first.clock).start()
        first.stop()
        first.stop()
        first.start()


@pytest.mark.parametrize("cfa", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_quads_are_turned_and_not_mixed(cfa: str) -> None:
    samples = np.arange(48, dtype=np.uint16).reshape(6, 8)
    turned = order_mosaic(samples, cfa)
    greens = []
    for place, colour in enumerate(cfa):
        found = turned[place // 2 :: 2, place % 2 :: 2]
        if colour == "G":
            greens.append(found)
        else:
            at = 0 if colour == "R" else 1
            assert np.array_equal(found, samples[at::2, at::2])
    assert np.array_equal(greens[0], samples[0::2, 1::2])
    assert np.array_equal(greens[1], samples[1::2, 0::2])


def test_frames_are_packed_as_they_are_unpacked() -> None:
    known = BY_NAME["BayerRG12p"]
    assert unpack_samples(b"\x21\x43\x65", known, 1, 2).tolist() == [[0x321, 0x654]]
