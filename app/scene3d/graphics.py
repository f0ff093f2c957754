"""Whether VTK can draw without a window here, asked before VTK is: it ends the process where it cannot.

On Linux an off-screen picture needs EGL with a driver that starts, or OSMesa. Both are asked through `ctypes`; nothing
is left open. On Windows and macOS the system brings what is needed.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import os
import sys

from skincal.model.errors import InputError

EGL_DEVICE = 0x313F
"""EGL_PLATFORM_DEVICE_EXT, of the extension EGL_EXT_platform_device: a display without a window system."""
MOST_DEVICES = 16
OSMESA_NAMES = ("libOSMesa.so.8", "libOSMesa.so.6", "libOSMesa.so")
VARIABLE = "VTK_DEFAULT_OPENGL_WINDOW"
"""VTK's own switch: the class that it makes for a window it is not given."""
MISSING = (
    "No picture can be drawn: neither EGL with a driver nor OSMesa was found. "
    "Install them, on Debian or Ubuntu with: apt-get install --no-install-recommends libegl1 libgl1-mesa-dri"
)


def choose_offscreen() -> None:
    """Make VTK draw off-screen by what this machine has.

    Call before VTK's first window. A choice that the user made by the environment is kept.

    Raises
    ------
    InputError
        There is nothing to draw with; names the packages.
    """
    if not sys.platform.startswith("linux") or os.environ.get(VARIABLE):
        return
    if egl_starts():
        os.environ[VARIABLE] = "vtkEGLRenderWindow"
    elif _load(*OSMESA_NAMES) is not None:
        os.environ[VARIABLE] = "vtkOSOpenGLRenderWindow"
    else:
        raise InputError(MISSING)


def egl_starts() -> bool:
    """Return whether one of EGL's devices starts with a driver; the library alone does not say so."""
    library = _load("libEGL.so.1")
    if library is None:
        return False
    library.eglGetProcAddress.restype = ctypes.c_void_p
    query_at = library.eglGetProcAddress(b"eglQueryDevicesEXT")
    display_at = library.eglGetProcAddress(b"eglGetPlatformDisplayEXT")
    if not query_at or not display_at:
        return False
    query = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_int, ctypes.c_void_p, ctypes.c_void_p)(query_at)
    display_of = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_uint, ctypes.c_void_p, ctypes.c_void_p)(display_at)
    devices, count = (ctypes.c_void_p * MOST_DEVICES)(), ctypes.c_int(0)
    if not query(MOST_DEVICES, ctypes.addressof(devices), ctypes.addressof(count)):
        return False
    return any(_starts(library, display_of(EGL_DEVICE, devices[at], None)) for at in range(count.value))


def _starts(library: ctypes.CDLL, display: int | None) -> bool:
    library.eglInitialize.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p]
    library.eglTerminate.argtypes = [ctypes.c_void_p]
    if not display or not library.eglInitialize(display, None, None):
        return False
    library.eglTerminate(display)
    return True


def _load(*names: str) -> ctypes.CDLL | None:
    for name in names:
        try:
            return ctypes.CDLL(name)
        except OSError:
            continue
    return None
