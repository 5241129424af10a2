"""libaravis by ctypes: where it is found, and what its functions take and return.

Aravis (LGPL) speaks GigE Vision and USB3 Vision with cameras of every maker. It is called directly,
without PyGObject, so that any Python of any environment will do. Only what the driver needs is
declared here; `drivers.genicam.aravis` is what the rest of the driver calls.
"""

from __future__ import annotations

import ctypes
import importlib.util
from ctypes import CDLL, POINTER, c_char_p, c_double, c_int, c_int64, c_size_t, c_uint, c_void_p
from dataclasses import dataclass
from functools import cache
from pathlib import Path

SONAME = "libaravis-0.8.so.0"
WHEEL = "aravis-python"
"""The package on PyPI that contains the library."""
_WHEEL_MODULE = "aravis"
_GOBJECT = "libgobject-2.0.so.0"
_GLIB = "libglib-2.0.so.0"

_INT64 = c_int64
_U64 = ctypes.c_uint64
_U32 = ctypes.c_uint32
_P, _S = c_void_p, c_char_p


class GError(ctypes.Structure):
    """GLib's error, as functions return it."""

    _fields_ = (("domain", _U32), ("code", c_int), ("message", c_char_p))


_E = POINTER(POINTER(GError))

_ARAVIS: dict[str, tuple[type | None, tuple[type, ...]]] = {
    "arv_update_device_list": (None, ()),
    "arv_get_n_devices": (c_uint, ()),
    "arv_get_device_id": (_S, (c_uint,)),
    "arv_get_device_vendor": (_S, (c_uint,)),
    "arv_get_device_model": (_S, (c_uint,)),
    "arv_get_device_serial_nbr": (_S, (c_uint,)),
    "arv_get_device_address": (_S, (c_uint,)),
    "arv_get_device_protocol": (_S, (c_uint,)),
    "arv_get_major_version": (c_uint, ()),
    "arv_get_minor_version": (c_uint, ()),
    "arv_get_micro_version": (c_uint, ()),
    "arv_camera_new": (_P, (_S, _E)),
    "arv_camera_get_device": (_P, (_P,)),
    "arv_camera_create_stream": (_P, (_P, _P, _P, _E)),
    "arv_camera_start_acquisition": (None, (_P, _E)),
    "arv_camera_stop_acquisition": (None, (_P, _E)),
    "arv_camera_is_gv_device": (c_int, (_P,)),
    "arv_camera_set_access_check_policy": (None, (_P, c_int)),
    "arv_camera_set_range_check_policy": (None, (_P, c_int)),
    "arv_camera_gv_set_stream_options": (None, (_P, c_int)),
    "arv_camera_gv_auto_packet_size": (c_uint, (_P, _E)),
    "arv_camera_gv_set_packet_size": (None, (_P, c_int, _E)),
    "arv_camera_gv_get_packet_size": (c_uint, (_P, _E)),
    "arv_gv_device_is_controller": (c_int, (_P,)),
    "arv_device_get_feature": (_P, (_P, _S)),
    "arv_device_read_register": (c_int, (_P, _U64, POINTER(_U32), _E)),
    "arv_gc_float_get_unit": (_S, (_P,)),
    "arv_device_is_feature_available": (c_int, (_P, _S, _E)),
    "arv_device_get_string_feature_value": (_S, (_P, _S, _E)),
    "arv_device_set_string_feature_value": (None, (_P, _S, _S, _E)),
    "arv_device_get_integer_feature_value": (_INT64, (_P, _S, _E)),
    "arv_device_set_integer_feature_value": (None, (_P, _S, _INT64, _E)),
    "arv_device_get_integer_feature_bounds": (
        None,
        (_P, _S, POINTER(_INT64), POINTER(_INT64), _E),
    ),
    "arv_device_get_float_feature_value": (c_double, (_P, _S, _E)),
    "arv_device_set_float_feature_value": (None, (_P, _S, c_double, _E)),
    "arv_device_get_float_feature_bounds": (
        None,
        (_P, _S, POINTER(c_double), POINTER(c_double), _E),
    ),
    "arv_device_get_boolean_feature_value": (c_int, (_P, _S, _E)),
    "arv_device_set_boolean_feature_value": (None, (_P, _S, c_int, _E)),
    "arv_device_execute_command": (None, (_P, _S, _E)),
    "arv_device_dup_available_enumeration_feature_values_as_strings": (
        POINTER(_S),
        (_P, _S, POINTER(c_uint), _E),
    ),
    "arv_stream_push_buffer": (None, (_P, _P)),
    "arv_stream_timeout_pop_buffer": (_P, (_P, _U64)),
    "arv_stream_try_pop_buffer": (_P, (_P,)),
    "arv_buffer_new_allocate": (_P, (c_size_t,)),
    "arv_buffer_get_status": (c_int, (_P,)),
    "arv_buffer_has_chunks": (c_int, (_P,)),
    "arv_buffer_get_data": (_P, (_P, POINTER(c_size_t))),
    "arv_buffer_get_frame_id": (_U64, (_P,)),
    "arv_buffer_get_timestamp": (_U64, (_P,)),
    "arv_buffer_get_image_width": (c_int, (_P,)),
    "arv_buffer_get_image_height": (c_int, (_P,)),
    "arv_buffer_get_image_pixel_format": (_U32, (_P,)),
}
"""What each function returns and takes, by the headers of 0.8."""


@dataclass(frozen=True)
class AravisLibrary:
    """The library as loaded, GLib's object system, and GLib beneath it.

    arv : with the functions of `_ARAVIS` declared. path : where it was found.
    """

    arv: CDLL
    gobject: CDLL
    glib: CDLL
    path: str

    @property
    def version(self) -> str:
        """As "0.8.26"."""
        arv = self.arv
        parts = (arv.arv_get_major_version, arv.arv_get_minor_version, arv.arv_get_micro_version)
        return ".".join(str(part()) for part in parts)


def list_libraries() -> tuple[str, ...]:
    """Places of the library, in the order of the search: first the wheel, which was installed into
    this very environment, then the system's places."""
    spec = importlib.util.find_spec(_WHEEL_MODULE)
    folders = () if spec is None else spec.submodule_search_locations or ()
    inside = (Path(folder) / "lib" / SONAME for folder in folders)
    return (*(str(path) for path in inside if path.is_file()), SONAME)


@cache
def load_library(path: str | None = None) -> AravisLibrary:
    """Load libaravis, once for the process.

    path : only this library; None: the first of `list_libraries` that loads. Raises
    ModuleNotFoundError for `WHEEL`, which the registry of drivers turns into words for the user.
    """
    reasons = []
    for candidate in list_libraries() if path is None else (path,):
        try:
            return _declare(candidate)
        except (OSError, AttributeError) as err:
            reasons.append(f"{candidate}: {err}")
    raise ModuleNotFoundError(
        "Aravis 0.8 is not installed: apt install libaravis-0.8-0, or the Python package "
        f"{WHEEL} ({'; '.join(reasons)})",
        name=WHEEL,
    )


def _declare(path: str) -> AravisLibrary:
    """Load one library. Raises OSError if it does not load, AttributeError if it lacks functions
    that are declared here."""
    arv, gobject, glib = CDLL(path), CDLL(_GOBJECT), CDLL(_GLIB)
    for name, (returned, taken) in _ARAVIS.items():
        function = getattr(arv, name)
        function.restype, function.argtypes = returned, taken
    glib.g_error_free.argtypes, glib.g_error_free.restype = (POINTER(GError),), None
    glib.g_free.argtypes, glib.g_free.restype = (_P,), None
    glib.g_quark_to_string.argtypes, glib.g_quark_to_string.restype = (_U32,), _S
    gobject.g_object_unref.argtypes, gobject.g_object_unref.restype = (_P,), None
    return AravisLibrary(arv, gobject, glib, path)
