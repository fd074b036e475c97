"""Embree's C interface for compiled loops, which cast rays one by one.

The package embreex contains Embree; its own interface takes arrays of rays. Loops that draw, cast and shade single rays
take half the time, because rays never pass through memory.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from importlib import metadata
from typing import Any, cast
from weakref import finalize

import llvmlite.binding
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from rfpp.errors import MissingDependencyError
from rfpp.raycast.compiled import compiled, float64, int64
from rfpp.raycast.vectors import Vector

#: Constants of `RTCGeometryType`, `RTCBufferType`, `RTCFormat` and `RTCSceneFlags` (embree4/rtcore_*.h).
_TRIANGLES, _INDEX, _VERTEX, _UINT3, _FLOAT3, _ROBUST = 0, 0, 1, 0x5003, 0x9003, 1 << 2

_POINTER, _INT, _UINT, _SIZE = ctypes.c_void_p, ctypes.c_int, ctypes.c_uint, ctypes.c_size_t
_FUNCTIONS = {  # name → result, arguments
    "rtcNewDevice": (_POINTER, [ctypes.c_char_p]),
    "rtcReleaseDevice": (None, [_POINTER]),
    "rtcGetDeviceError": (_INT, [_POINTER]),
    "rtcNewScene": (_POINTER, [_POINTER]),
    "rtcSetSceneFlags": (None, [_POINTER, _INT]),
    "rtcCommitScene": (None, [_POINTER]),
    "rtcReleaseScene": (None, [_POINTER]),
    "rtcNewGeometry": (_POINTER, [_POINTER, _INT]),
    "rtcSetSharedGeometryBuffer": (None, [_POINTER, _INT, _UINT, _INT, _POINTER, _SIZE, _SIZE, _SIZE]),
    "rtcCommitGeometry": (None, [_POINTER]),
    "rtcAttachGeometry": (_UINT, [_POINTER, _POINTER]),
    "rtcReleaseGeometry": (None, [_POINTER]),
}


@cache
def embree() -> ctypes.CDLL:
    """Return the library, loading it at the first call.

    Raises:
        MissingDependencyError: If it is not installed.
    """
    try:
        import embreex  # noqa: F401  (on Windows it says where its libraries are)

        files = metadata.files("embreex") or []
        path = next(str(f.locate()) for f in files if "embree4" in f.name and {".so", ".dylib", ".dll"} & {*f.suffixes})
    except (ImportError, StopIteration) as error:
        raise MissingDependencyError(f"G-buffers need Embree ({error}): pip install embreex") from error
    llvmlite.binding.load_library_permanently(path)  # compiled code finds its functions by name
    library = ctypes.CDLL(path)
    for name, (result, arguments) in _FUNCTIONS.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, arguments
    return library


# Numba's stubs do not declare that compiled code can call these.
_pointer_to = cast(Callable[[object], Any], types.CPointer)
_RAY = _pointer_to(types.float32)
_Query = Callable[[int, np.ndarray, int], None]
_intersect = cast(_Query, types.ExternalFunction("rtcIntersect1", types.void(types.uintp, _RAY, types.uintp)))
_occluded = cast(_Query, types.ExternalFunction("rtcOccluded1", types.void(types.uintp, _RAY, types.uintp)))


class Structure:
    """Acceleration structure over M > 0 triangles.

    Args:
        corners: Corners [M, 3, 3]; copied, because Embree reads them during the structure's lifetime.

    Attributes:
        address: Address of Embree's scene, for `closest` and `blocked`; valid during the structure's lifetime.
    """

    def __init__(self, corners: np.ndarray) -> None:
        self._index = np.arange(3 * len(corners), dtype=np.uint32)
        # Embree reads 16 bytes at each corner, so behind the last one as well
        self._corners = np.append(corners.reshape(-1).astype(np.float32), np.float32(0))
        library = embree()
        self._device = library.rtcNewDevice(None)
        self.address = library.rtcNewScene(self._device)
        finalize(self, _release, library, self.address, self._device).atexit = False
        library.rtcSetSceneFlags(self.address, _ROBUST)
        geometry = library.rtcNewGeometry(self._device, _TRIANGLES)
        shared = library.rtcSetSharedGeometryBuffer
        shared(geometry, _VERTEX, 0, _FLOAT3, self._corners.ctypes.data, 0, 12, 3 * len(corners))
        shared(geometry, _INDEX, 0, _UINT3, self._index.ctypes.data, 0, 12, len(corners))
        library.rtcCommitGeometry(geometry)
        library.rtcAttachGeometry(self.address, geometry)
        library.rtcReleaseGeometry(geometry)
        library.rtcCommitScene(self.address)
        if error := library.rtcGetDeviceError(self._device):
            raise MemoryError(f"Embree could not build its structure over {len(corners)} triangles (error {error})")


def _release(library: ctypes.CDLL, scene: int, device: int) -> None:
    library.rtcReleaseScene(scene)
    library.rtcReleaseDevice(device)


#: Numbers of a ray and its hit (`RTCRayHit`), padded.
_RAY_NUMBERS = 32


def _on_stack(typing: Any) -> tuple[Any, Callable[..., Any]]:
    """Allocate a ray on the caller's stack: private to the thread, freed on return."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        memory = cast(Any, cgutils).alloca_once(builder, ir.ArrayType(ir.FloatType(), _RAY_NUMBERS))
        memory.align = 16  # as Embree asks for
        return builder.bitcast(memory, ir.FloatType().as_pointer())

    return _RAY(), generate


def _as_integers(typing: Any, ray: Any) -> tuple[Any, Callable[..., Any]]:
    """Return the same memory as 32-bit integers."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.IntType(32).as_pointer())

    return _pointer_to(types.int32)(_RAY), generate


#: For compiled code: a new ray, and its memory as integers.
_new_ray = cast(Callable[[], np.ndarray], intrinsic(_on_stack))
_integers = cast(Callable[[np.ndarray], np.ndarray], intrinsic(_as_integers))


@compiled
def closest(address: int, origin: Vector, direction: Vector) -> tuple[int, float, float, float]:
    """Return the closest triangle hit by a ray (-1 for none), the weights of its corners 1 and 2, and the distance.

    Args:
        address: Address of a `Structure`; 0 if there is none.
    """
    if address == 0:
        return -1, 0.0, 0.0, np.inf
    ray = _new_ray()
    _set(ray, origin, direction, np.inf)
    numbers = _integers(ray)
    numbers[17], numbers[18], numbers[19] = -1, -1, -1
    _intersect(address, ray, 0)
    if numbers[18] == -1:
        return -1, 0.0, 0.0, np.inf
    return int64(numbers[17]), float64(ray[15]), float64(ray[16]), float64(ray[8])


@compiled
def blocked(address: int, origin: Vector, direction: Vector, reach: float) -> bool:
    """Return whether a ray hits anything closer than `reach`."""
    if address == 0:
        return False
    ray = _new_ray()
    _set(ray, origin, direction, reach)
    _occluded(address, ray, 0)
    found: bool = ray[8] < 0
    return found


@compiled
def _set(ray: np.ndarray, origin: Vector, direction: Vector, reach: float) -> None:
    numbers = _integers(ray)
    ray[0], ray[1], ray[2], ray[3] = origin[0], origin[1], origin[2], 0.0
    ray[4], ray[5], ray[6], ray[7] = direction[0], direction[1], direction[2], 0.0
    ray[8], numbers[9], numbers[10], numbers[11] = reach, -1, 0, 0
