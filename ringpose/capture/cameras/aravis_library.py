"""libaravis through ctypes: the functions that the driver needs, with errors as exceptions.

Two binary interfaces are supported, 0.8 (Debian 12, Ubuntu 22.04 and later) and 0.10 (0.9 and later); in the functions
used here, they differ in one argument of `arv_camera_create_stream`.
"""

import ctypes
import functools
from ctypes import POINTER, byref, c_char_p, c_double, c_int, c_int64, c_size_t, c_uint, c_uint32, c_uint64, c_void_p
from typing import Any

SONAMES = ("libaravis-0.8.so.0", "libaravis-0.10.so.0")

PACKAGE = "libaravis-0.8-0"
"""The package of Debian and Ubuntu."""

_G_TYPE_INT = 6 << 2


class AravisError(Exception):
    """An error reported by the library."""

    def __init__(self, message: str) -> None:
        self.message = " ".join(message.split())
        super().__init__(self.message)


class _GError(ctypes.Structure):
    _fields_ = (("domain", ctypes.c_uint32), ("code", c_int), ("message", c_char_p))


class _GValue(ctypes.Structure):
    _fields_ = (("type", c_size_t), ("data", c_uint64 * 2))


_SIGNATURES: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "arv_update_device_list": (None, ()),
    "arv_get_n_devices": (c_uint, ()),
    "arv_get_device_id": (c_char_p, (c_uint,)),
    "arv_get_device_address": (c_char_p, (c_uint,)),
    "arv_get_device_vendor": (c_char_p, (c_uint,)),
    "arv_get_device_model": (c_char_p, (c_uint,)),
    "arv_get_device_serial_nbr": (c_char_p, (c_uint,)),
    "arv_get_device_protocol": (c_char_p, (c_uint,)),
    "arv_camera_get_device": (c_void_p, (c_void_p,)),
    "arv_camera_is_gv_device": (c_int, (c_void_p,)),
    "arv_camera_gv_set_stream_options": (None, (c_void_p, c_int)),
    "arv_device_set_range_check_policy": (None, (c_void_p, c_int)),
    "arv_device_get_feature": (c_void_p, (c_void_p, c_char_p)),
    "arv_gc_float_get_type": (c_size_t, ()),
    "arv_gc_boolean_get_type": (c_size_t, ()),
    "arv_gv_device_is_controller": (c_int, (c_void_p,)),
    "arv_buffer_new_allocate": (c_void_p, (c_size_t,)),
    "arv_buffer_get_status": (c_int, (c_void_p,)),
    "arv_buffer_get_data": (c_void_p, (c_void_p, POINTER(c_size_t))),
    "arv_buffer_get_frame_id": (c_uint64, (c_void_p,)),
    "arv_buffer_get_timestamp": (c_uint64, (c_void_p,)),
    "arv_buffer_get_image_width": (c_int, (c_void_p,)),
    "arv_buffer_get_image_height": (c_int, (c_void_p,)),
    "arv_buffer_get_image_pixel_format": (c_uint32, (c_void_p,)),
    "arv_stream_push_buffer": (None, (c_void_p, c_void_p)),
    "arv_stream_try_pop_buffer": (c_void_p, (c_void_p,)),
    "arv_stream_timeout_pop_buffer": (c_void_p, (c_void_p, c_uint64)),
}
"""Functions that cannot fail: result type, argument types."""

_FALLIBLE: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "arv_camera_new": (c_void_p, (c_char_p,)),
    "arv_camera_get_payload": (c_uint, (c_void_p,)),
    "arv_camera_start_acquisition": (None, (c_void_p,)),
    "arv_camera_stop_acquisition": (None, (c_void_p,)),
    "arv_device_execute_command": (None, (c_void_p, c_char_p)),
    "arv_device_set_string_feature_value": (None, (c_void_p, c_char_p, c_char_p)),
    "arv_device_get_string_feature_value": (c_char_p, (c_void_p, c_char_p)),
    "arv_device_get_boolean_feature_value": (c_int, (c_void_p, c_char_p)),
    "arv_device_dup_available_enumeration_feature_values_as_strings": (
        POINTER(c_char_p),
        (c_void_p, c_char_p, POINTER(c_uint)),
    ),
    "arv_device_set_boolean_feature_value": (None, (c_void_p, c_char_p, c_int)),
    "arv_device_set_integer_feature_value": (None, (c_void_p, c_char_p, c_int64)),
    "arv_device_get_integer_feature_value": (c_int64, (c_void_p, c_char_p)),
    "arv_device_get_integer_feature_bounds": (None, (c_void_p, c_char_p, POINTER(c_int64), POINTER(c_int64))),
    "arv_device_set_float_feature_value": (None, (c_void_p, c_char_p, c_double)),
    "arv_device_get_float_feature_value": (c_double, (c_void_p, c_char_p)),
    "arv_device_get_float_feature_bounds": (None, (c_void_p, c_char_p, POINTER(c_double), POINTER(c_double))),
}
"""Functions that can fail; `call` appends the argument for the error."""


class Aravis:
    """The library; functions are attributes with their C names, and those that can fail are called by `call`."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._library = library
        for name, (result, arguments) in _SIGNATURES.items():
            self._declare(name, result, arguments)
        for name, (result, arguments) in _FALLIBLE.items():
            self._declare(name, result, (*arguments, POINTER(POINTER(_GError))))
        version = tuple(getattr(library, f"arv_get_{part}_version")() for part in ("major", "minor", "micro"))
        destroy = () if version < (0, 9, 1) else (c_void_p,)
        arguments = (c_void_p, c_void_p, c_void_p, *destroy, POINTER(POINTER(_GError)))
        self._declare("arv_camera_create_stream", c_void_p, arguments)
        self._declare("g_object_unref", None, (c_void_p,))
        self._declare("g_object_set_property", None, (c_void_p, c_char_p, POINTER(_GValue)))
        self._declare("g_value_init", c_void_p, (POINTER(_GValue), c_size_t))
        self._declare("g_value_set_int", None, (POINTER(_GValue), c_int))
        self._declare("g_type_check_instance_is_a", c_int, (c_void_p, c_size_t))
        self._declare("g_error_free", None, (POINTER(_GError),))
        self._declare("g_free", None, (c_void_p,))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._library, name)

    def call(self, name: str, *arguments: Any) -> Any:
        """The result of a function that can fail; raises `AravisError` if it does."""
        error = POINTER(_GError)()
        result = getattr(self._library, name)(*arguments, byref(error))
        if error:
            failed = AravisError((error.contents.message or b"").decode(errors="replace"))
            self._library.g_error_free(error)
            raise failed
        return result

    def new_stream(self, camera: int) -> int:
        """A stream of a camera, without a callback."""
        extra = (None,) * (len(self._library.arv_camera_create_stream.argtypes or ()) - 2)
        return int(self.call("arv_camera_create_stream", camera, *extra) or 0)

    def set_int_property(self, instance: int, name: str, value: int) -> None:
        """Set an int or enum property of a GObject; ctypes cannot pass the variable arguments of `g_object_set`."""
        wrapped = _GValue()
        self._library.g_value_init(byref(wrapped), _G_TYPE_INT)
        self._library.g_value_set_int(byref(wrapped), value)
        self._library.g_object_set_property(instance, name.encode(), byref(wrapped))

    def kind(self, device: int, feature: str) -> str:
        """Type of a feature, as in the names of the functions that get or set it: `float`, `boolean` or `integer`."""
        node = self._library.arv_device_get_feature(device, feature.encode())
        for kind in ("float", "boolean"):
            if self._library.g_type_check_instance_is_a(node, getattr(self._library, f"arv_gc_{kind}_get_type")()):
                return kind
        return "integer"

    def choices(self, device: int, feature: str) -> tuple[str, ...]:
        """The values of an enumeration; empty if the feature is not one, or if the camera does not answer."""
        count = c_uint()
        name = "arv_device_dup_available_enumeration_feature_values_as_strings"
        try:
            names = self.call(name, device, feature.encode(), byref(count))
        except AravisError:
            return ()
        texts = tuple(sorted(names[k].decode() for k in range(count.value)))
        self._library.g_free(names)
        return texts

    def _declare(self, name: str, result: Any, arguments: tuple[Any, ...]) -> None:
        function = getattr(self._library, name)
        function.restype, function.argtypes = result, arguments


@functools.cache
def library() -> Aravis | None:
    """The installed library; None if it is not installed."""
    for soname in SONAMES:
        try:
            return Aravis(ctypes.CDLL(soname))
        except OSError:
            continue
    return None
