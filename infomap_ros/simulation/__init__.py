"""Simulated worlds, the rover in them, its stereo camera, and the recorder of bags.

Importing this package chooses how MuJoCo draws on a machine without a screen: EGL where it works,
OSMesa otherwise. MuJoCo reads the environment variable ``MUJOCO_GL`` once, when it is imported. So
nothing here imports MuJoCo.
"""

from __future__ import annotations

import ctypes
import os
import sys

ADVICE = (
    "MuJoCo cannot draw images on this machine: neither EGL nor OSMesa works. On Debian or Ubuntu "
    "run 'apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri libopengl0', or 'apt-get install "
    "libosmesa6'."
)

_VARIABLE = "MUJOCO_GL"
_EGL_PLATFORM_DEVICE = 0x313F
_MAX_DEVICES = 16


def select_backend() -> str:
    """Choose MuJoCo's way to draw and set ``MUJOCO_GL``, unless it is already set.

    Returns:
        The value of ``MUJOCO_GL``: ``egl``, ``osmesa``, what the user chose, or an empty string
        where neither library works (or on systems other than Linux, which need none). Only
        drawing needs one of them; physics and ground truth do not.
    """
    chosen = os.environ.get(_VARIABLE, "")
    if chosen or not sys.platform.startswith("linux") or "mujoco" in sys.modules:
        return chosen
    chosen = "egl" if egl_works() else "osmesa" if osmesa_works() else ""
    if chosen:
        os.environ[_VARIABLE] = chosen
    return chosen


def osmesa_works() -> bool:
    """Whether the OSMesa library can be loaded."""
    return any(_load(name) for name in ("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so"))


def egl_works() -> bool:
    """Whether EGL has a device (graphics card or Mesa's software renderer) that initializes."""
    library = _load("libEGL.so.1")
    if library is None:
        return False
    library.eglGetProcAddress.restype = ctypes.c_void_p
    library.eglGetProcAddress.argtypes = [ctypes.c_char_p]
    query = library.eglGetProcAddress(b"eglQueryDevicesEXT")
    display = library.eglGetProcAddress(b"eglGetPlatformDisplayEXT")
    if not query or not display:
        return False
    handle = ctypes.c_void_p
    query_devices = ctypes.CFUNCTYPE(
        ctypes.c_uint, ctypes.c_int, ctypes.POINTER(handle), ctypes.POINTER(ctypes.c_int)
    )(query)
    get_display = ctypes.CFUNCTYPE(handle, ctypes.c_uint, handle, handle)(display)
    library.eglInitialize.argtypes = [handle, handle, handle]
    devices, count = (handle * _MAX_DEVICES)(), ctypes.c_int(0)
    if not query_devices(_MAX_DEVICES, devices, ctypes.byref(count)):
        return False
    return any(
        library.eglInitialize(get_display(_EGL_PLATFORM_DEVICE, device, None), None, None)
        for device in devices[: count.value]
    )


def _load(name: str) -> ctypes.CDLL | None:
    try:
        return ctypes.CDLL(name)
    except OSError:
        return None


select_backend()
