"""The virtual camera's GenApi description (XML), and the addresses of its features.

All registers are big-endian words of 32 bits in the memory of Aravis' simulator, below 0x10000.
Those below 0x400 are the simulator's own, and it uses some of them: picture size, format and
acquisition are shared; trigger and exposure are not, as the simulator models neither time nor
light.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from xml.etree.ElementTree import Element, SubElement, tostring

from ..genicam.pixels import PixelFormat


class Register(IntEnum):
    """Addresses: first the simulator's own, then ours. Units are in the names: us, ms, hundredths
    of a dB, of a DN, of a degree Celsius."""

    VENDOR = 0x48
    MODEL = 0x68
    SERIAL = 0xD8
    WIDTH = 0x100
    HEIGHT = 0x104
    SENSOR_HEIGHT = 0x118
    SENSOR_WIDTH = 0x11C
    ACQUISITION = 0x124
    PIXEL_FORMAT = 0x128
    ACQUISITION_MODE = 0x12C
    SENDS_BY_TRIGGER = 0x300
    SENDS_BY_COMMAND = 0x304
    SEND = 0x30C
    HEARTBEAT_MS = 0x938
    CONTROL = 0xA00
    EXPOSURE_US = 0x8000
    EXPOSURE_MODE = 0x8004
    EXPOSURE_AUTO = 0x8008
    TRIGGER_MODE = 0x8010
    TRIGGER_SOURCE = 0x8014
    TRIGGER_ACTIVATION = 0x8018
    TRIGGER = 0x801C
    WAITS = 0x8020
    GAIN_CDB = 0x8030
    GAIN_AUTO = 0x8034
    BLACK_CDN = 0x8038
    WHITE = 0x8040
    TEMPERATURE_CC = 0x8044
    OFFSET_X = 0x8050
    OFFSET_Y = 0x8054
    COUNTER = 0x8060
    COUNTER_SOURCES = 0x8070
    COUNTER_VALUES = 0x8080


STARTED_ANEW, STARTED = 2, 1
"""The value that a client writes to start the acquisition, and the value that replaces it once seen
here. So a stop just before a start is noticed too, however short."""
EXPOSURE_MODES = {"Timed": 0, "TriggerWidth": 1}
TRIGGER_SOURCES = {"Software": 0, "Line1": 1}
TRIGGER_ACTIVATIONS = {"RisingEdge": 0, "FallingEdge": 1}
COUNTERS = ("Counter0", "Counter1")
COUNTER_SOURCES = {"Off": 0, "Line2": 2, "Line3": 3}
_OFF = {"Off": 0, "Continuous": 1}

_SCHEMA = "http://www.genicam.org/GenApi/Version_1_1"


@dataclass(frozen=True)
class CameraDescription:
    """What a virtual camera is.

    width, height : of its sensor, pixels. formats : that it offers. white : the white level that it
    reports; None: it reports none. longest_s : its longest exposure. gain_db : its largest gain.
    """

    width: int
    height: int
    formats: tuple[PixelFormat, ...]
    white: int | None = None
    longest_s: float = 60.0
    gain_db: float = 24.0
    serial: str = "V1"


class _Writer:
    """Nodes of one description."""

    def __init__(self) -> None:
        self.root = Element(
            "RegisterDescription",
            {
                "ModelName": "Virtual",
                "VendorName": "pdcd",
                "StandardNameSpace": "GEV",
                "SchemaMajorVersion": "1",
                "SchemaMinorVersion": "1",
                "SchemaSubMinorVersion": "0",
                "MajorVersion": "1",
                "MinorVersion": "0",
                "SubMinorVersion": "0",
                "ToolTip": "a camera that is not there",
                "ProductGuid": "7f9c6f4e-3d0f-4c57-9f0e-2f1f6a1b7c01",
                "VersionGuid": "7f9c6f4e-3d0f-4c57-9f0e-2f1f6a1b7c02",
                "xmlns": _SCHEMA,
            },
        )
        self._features: dict[str, list[str]] = {}

    def node(self, kind: str, name: str, category: str = "", **parts: object) -> Element:
        """Add one node; with a category, as a feature of that category."""
        node = SubElement(
            self.root, kind, {"Name": name, "NameSpace": "Standard" if category else "Custom"}
        )
        for tag, value in parts.items():
            SubElement(node, tag).text = str(value)
        if category:
            self._features.setdefault(category, []).append(name)
        return node

    def register(self, name: str, address: int, mode: str = "RW", index: str = "") -> str:
        """Add a word, or one word for each value of the register `index`; returns its name."""
        name = f"{name}Register"
        # An order of parts that the schema asks for. The simulator is written to from within, too.
        node = self.node("IntReg", name, Address=f"0x{address:X}")
        if index:
            SubElement(node, "pIndex", {"Offset": "4"}).text = index
        for tag, text in (
            ("Length", "4"),
            ("AccessMode", mode),
            ("pPort", "Device"),
            ("Cachable", "NoCache"),
            ("Sign", "Unsigned"),
            ("Endianess", "BigEndian"),
        ):
            SubElement(node, tag).text = text
        return name

    def text(self, name: str, category: str, address: int, length: int) -> None:
        """A read-only string."""
        self.node(
            "StringReg",
            name,
            category,
            Address=f"0x{address:X}",
            Length=length,
            AccessMode="RO",
            pPort="Device",
        )

    def integer(
        self, name: str, category: str, address: int, low: int, high: int | str, mode: str = "RW"
    ) -> None:
        """A whole number; `high` may be another feature."""
        node = self.node("Integer", name, category, pValue=self.register(name, address, mode))
        SubElement(node, "Min").text = str(low)
        SubElement(node, "Max" if isinstance(high, int) else "pMax").text = str(high)
        SubElement(node, "Inc").text = "1"

    def choice(self, name: str, category: str, address: int, entries: dict[str, int]) -> None:
        """An enumeration."""
        node = self.node("Enumeration", name, category)
        for entry, value in entries.items():
            inside = SubElement(node, "EnumEntry", {"Name": entry, "NameSpace": "Standard"})
            SubElement(inside, "Value").text = str(value)
        SubElement(node, "pValue").text = self.register(name, address)

    def number(
        self,
        name: str,
        category: str,
        address: int,
        per_unit: int,
        low: float,
        high: float,
        mode: str = "RW",
    ) -> None:
        """A float that is stored in a word, in `per_unit` steps to one unit."""
        self.node(
            "Converter",
            f"{name}Converter",
            FormulaTo=f"FROM*{per_unit}",
            FormulaFrom=f"TO/{per_unit}.0",
            pValue=self.register(name, address, mode),
            Slope="Increasing",
        )
        self.node("Float", name, category, pValue=f"{name}Converter", Min=low, Max=high)

    def command(self, name: str, category: str, register: str, value: int) -> None:
        """A command that writes a value."""
        self.node("Command", name, category, pValue=register, CommandValue=value)

    def finish(self) -> bytes:
        """The whole file, with its categories."""
        self.node("Port", "Device")
        for category, features in self._features.items():
            node = SubElement(self.root, "Category", {"Name": category, "NameSpace": "Standard"})
            for feature in features:
                SubElement(node, "pFeature").text = feature
        root = SubElement(self.root, "Category", {"Name": "Root", "NameSpace": "Standard"})
        for category in self._features:
            SubElement(root, "pFeature").text = category
        return b'<?xml version="1.0" encoding="UTF-8"?>\n' + tostring(self.root)


def write_description(camera: CameraDescription) -> bytes:
    """The GenApi description of the camera, XML."""
    xml = _Writer()
    device, image, acquisition = "DeviceControl", "ImageFormatControl", "AcquisitionControl"
    xml.text("DeviceVendorName", device, Register.VENDOR, 32)
    xml.text("DeviceModelName", device, Register.MODEL, 32)
    xml.text("DeviceSerialNumber", device, Register.SERIAL, 16)
    xml.number("DeviceTemperature", device, Register.TEMPERATURE_CC, 100, 0.0, 100.0, "RO")
    xml.integer("SensorWidth", image, Register.SENSOR_WIDTH, 1, 65535, "RO")
    xml.integer("SensorHeight", image, Register.SENSOR_HEIGHT, 1, 65535, "RO")
    xml.integer("Width", image, Register.WIDTH, 1, "SensorWidth")
    xml.integer("Height", image, Register.HEIGHT, 1, "SensorHeight")
    xml.integer("OffsetX", image, Register.OFFSET_X, 0, 65535)
    xml.integer("OffsetY", image, Register.OFFSET_Y, 0, 65535)
    xml.choice(
        "PixelFormat", image, Register.PIXEL_FORMAT, {f.name: f.code for f in camera.formats}
    )
    if camera.white is not None:
        xml.integer("PixelDynamicRangeMax", image, Register.WHITE, 0, 65535, "RO")
    xml.choice("AcquisitionMode", acquisition, Register.ACQUISITION_MODE, {"Continuous": 1})
    started = xml.register("AcquisitionCommand", Register.ACQUISITION)
    xml.command("AcquisitionStart", acquisition, started, STARTED_ANEW)
    xml.command("AcquisitionStop", acquisition, started, 0)
    xml.choice("ExposureMode", acquisition, Register.EXPOSURE_MODE, EXPOSURE_MODES)
    xml.number("ExposureTime", acquisition, Register.EXPOSURE_US, 1, 10.0, 1e6 * camera.longest_s)
    xml.choice("ExposureAuto", acquisition, Register.EXPOSURE_AUTO, _OFF)
    _write_trigger(xml, acquisition)
    _write_counters(xml, "CounterAndTimerControl")
    analog = "AnalogControl"
    xml.number("Gain", analog, Register.GAIN_CDB, 100, 0.0, camera.gain_db)
    xml.choice("GainAuto", analog, Register.GAIN_AUTO, _OFF)
    xml.number("BlackLevel", analog, Register.BLACK_CDN, 100, 0.0, 4095.0)
    transport = "TransportLayerControl"
    knife = xml.node("IntSwissKnife", "PayloadSize", transport)
    for variable, feature in (("W", "Width"), ("H", "Height"), ("F", "PixelFormatRegister")):
        SubElement(knife, "pVariable", {"Name": variable}).text = feature
    SubElement(knife, "Formula").text = "(W * H * ((F >> 16) & 255) + 7) / 8"
    xml.node("Integer", "TLParamsLocked", transport, Value=0, Min=0, Max=1)
    return xml.finish()


def _write_trigger(xml: _Writer, category: str) -> None:
    """Features for starting exposures, and for whether one may be started."""
    xml.node("Integer", "TriggerSelectorValue", Value=0)
    selector = xml.node("Enumeration", "TriggerSelector", category)
    _add_entries(selector, {"FrameStart": 0}, "TriggerSelectorValue")
    xml.choice("TriggerMode", category, Register.TRIGGER_MODE, {"Off": 0, "On": 1})
    xml.choice("TriggerSource", category, Register.TRIGGER_SOURCE, TRIGGER_SOURCES)
    xml.choice("TriggerActivation", category, Register.TRIGGER_ACTIVATION, TRIGGER_ACTIVATIONS)
    xml.command("TriggerSoftware", category, xml.register("TriggerSoftware", Register.TRIGGER), 1)
    xml.node("Integer", "AcquisitionStatusSelectorValue", Value=0)
    status = xml.node("Enumeration", "AcquisitionStatusSelector", category)
    _add_entries(status, {"FrameTriggerWait": 0}, "AcquisitionStatusSelectorValue")
    xml.node(
        "Boolean",
        "AcquisitionStatus",
        category,
        pValue=xml.register("AcquisitionStatus", Register.WAITS, "RO"),
        OnValue=1,
        OffValue=0,
    )


def _write_counters(xml: _Writer, category: str) -> None:
    """Counters of pulses at its inputs."""
    numbers = {name: number for number, name in enumerate(COUNTERS)}
    xml.choice("CounterSelector", category, Register.COUNTER, numbers)
    index = "CounterSelectorRegister"
    source = xml.node("Enumeration", "CounterEventSource", category)
    sources = xml.register("CounterEventSource", Register.COUNTER_SOURCES, index=index)
    _add_entries(source, COUNTER_SOURCES, sources)
    values = xml.register("CounterValue", Register.COUNTER_VALUES, index=index)
    xml.command("CounterReset", category, values, 0)
    xml.node("Integer", "CounterValue", category, pValue=values, Min=0, Max=2**31 - 1)


def _add_entries(node: Element, entries: dict[str, int], value: str) -> None:
    for entry, number in entries.items():
        inside = SubElement(node, "EnumEntry", {"Name": entry, "NameSpace": "Standard"})
        SubElement(inside, "Value").text = str(number)
    SubElement(node, "pValue").text = value
