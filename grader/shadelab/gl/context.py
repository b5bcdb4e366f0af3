"""An OpenGL 3.3 context without a display: OSMesa where the system has it, EGL surfaceless elsewhere.

OSMesa was removed from Mesa in 25.1, so newer systems lack it; both ways reach the same driver (llvmpipe).
SHADELAB_GL=osmesa or =egl forces one of them.

    python -m shadelab.gl.context

tries both and prints what came of it as JSON: for `doctor`, which must survive a driver that ends its process.
"""

import ctypes
import ctypes.util
import json
import os

import moderngl

from shadelab.errors import InfrastructureError

# Values of GL/osmesa.h.
OSMESA_FORMAT, OSMESA_DEPTH_BITS, OSMESA_STENCIL_BITS, OSMESA_PROFILE = 0x22, 0x30, 0x31, 0x33
OSMESA_CORE_PROFILE, OSMESA_CONTEXT_MAJOR_VERSION, OSMESA_CONTEXT_MINOR_VERSION = 0x34, 0x36, 0x37
GL_RGBA, GL_UNSIGNED_BYTE = 0x1908, 0x1401


GL_INFO_LOG_LENGTH = 0x8B84


class OSMesaContext:
    """What moderngl asks of a context object (load, __enter__, __exit__, release), over libOSMesa through ctypes."""

    def __init__(self) -> None:
        name = ctypes.util.find_library("OSMesa") or "libOSMesa.so.8"
        self.osmesa = ctypes.CDLL(name, mode=ctypes.RTLD_GLOBAL)  # OSError when the system has none
        self.osmesa.OSMesaCreateContextAttribs.restype = ctypes.c_void_p
        self.osmesa.OSMesaCreateContextAttribs.argtypes = [ctypes.POINTER(ctypes.c_int), ctypes.c_void_p]
        self.osmesa.OSMesaMakeCurrent.restype = ctypes.c_ubyte
        self.osmesa.OSMesaMakeCurrent.argtypes = [
            ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint, ctypes.c_int, ctypes.c_int,
        ]  # fmt: skip
        self.osmesa.OSMesaGetProcAddress.restype = ctypes.c_void_p
        self.osmesa.OSMesaGetProcAddress.argtypes = [ctypes.c_char_p]
        self.osmesa.OSMesaDestroyContext.argtypes = [ctypes.c_void_p]
        attributes = [
            OSMESA_FORMAT, GL_RGBA, OSMESA_DEPTH_BITS, 24, OSMESA_STENCIL_BITS, 8, OSMESA_PROFILE, OSMESA_CORE_PROFILE,
            OSMESA_CONTEXT_MAJOR_VERSION, 3, OSMESA_CONTEXT_MINOR_VERSION, 3, 0,
        ]  # fmt: skip
        self.handle = self.osmesa.OSMesaCreateContextAttribs((ctypes.c_int * len(attributes))(*attributes), None)
        if not self.handle:
            raise OSError("OSMesa gives no OpenGL 3.3 core context")
        # OSMesa insists on a window-system buffer; everything is drawn into framebuffer objects instead.
        self.buffer = (ctypes.c_ubyte * (16 * 16 * 4))()
        self.make_current()

    def make_current(self) -> None:
        if not self.osmesa.OSMesaMakeCurrent(self.handle, self.buffer, GL_UNSIGNED_BYTE, 16, 16):
            raise OSError("OSMesa's context cannot be made current")

    def load(self, name: str) -> int:
        return self.osmesa.OSMesaGetProcAddress(name.encode()) or 0

    def __enter__(self) -> "OSMesaContext":
        self.make_current()
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def release(self) -> None:
        if self.handle:
            self.osmesa.OSMesaDestroyContext(self.handle)
            self.handle = None


def _osmesa() -> moderngl.Context:
    return moderngl.create_context(require=330, context=OSMesaContext())


def _egl() -> moderngl.Context:
    # The names with versions are what run-time packages install; the plain ones come with development packages.
    return moderngl.create_context(
        require=330, standalone=True, backend="egl", libgl="libGL.so.1", libegl="libEGL.so.1"
    )


_ways = {"osmesa": _osmesa, "egl": _egl}


def create_context() -> moderngl.Context:
    """The first way that works. Raises InfrastructureError that says why none does."""
    forced = os.environ.get("SHADELAB_GL")
    if forced and forced not in _ways:
        raise InfrastructureError(f"SHADELAB_GL={forced}: must be {' or '.join(_ways)}")
    failures = []
    for name in [forced] if forced else _ways:
        try:
            context = _ways[name]()
            context.extra = name
            return context
        except Exception as error:
            failures.append(f"{name}: {error}")
    raise InfrastructureError(
        "no OpenGL 3.3 without a display (" + "; ".join(failures) + "); ./shadelab doctor says more"
    )


def compiler_log(context: moderngl.Context, program: moderngl.Program) -> str:
    """What the driver's compiler said of shaders that compile. moderngl keeps what it says of others alone."""
    if context.extra == "osmesa":
        load = ctypes.CDLL(ctypes.util.find_library("OSMesa") or "libOSMesa.so.8").OSMesaGetProcAddress
    else:
        load = ctypes.CDLL("libEGL.so.1").eglGetProcAddress
    load.restype, load.argtypes = ctypes.c_void_p, [ctypes.c_char_p]
    u, i, p = ctypes.c_uint, ctypes.c_int, ctypes.c_void_p

    def function(name: str, *arguments: type):
        return ctypes.CFUNCTYPE(None, *arguments)(load(name.encode()))

    count, shaders, length, parts = i(), (u * 8)(), i(), []
    function("glGetAttachedShaders", u, i, p, p)(program.glo, len(shaders), ctypes.byref(count), shaders)
    for shader in shaders[: count.value]:
        function("glGetShaderiv", u, u, p)(shader, GL_INFO_LOG_LENGTH, ctypes.byref(length))
        text = ctypes.create_string_buffer(length.value + 1)
        function("glGetShaderInfoLog", u, i, p, p)(shader, len(text), None, text)
        parts.append(text.value.decode(errors="replace"))
    return "\n".join(parts)


def describe(context: moderngl.Context) -> str:
    """ "llvmpipe (LLVM 15.0.6, 256 bits), 3.3 (Core Profile) Mesa 22.3.6 through osmesa"."""
    return f"{context.info['GL_RENDERER']}, {context.info['GL_VERSION']} through {context.extra}"


def main() -> None:
    told: dict[str, dict[str, str]] = {}
    for name, create in _ways.items():
        try:
            info = create().info
            told[name] = {"driver": f"{info['GL_RENDERER']}, {info['GL_VERSION']}"}
        except Exception as error:  # each library fails in a way of its own
            told[name] = {"error": str(error).splitlines()[0] if str(error) else type(error).__name__}
    used = {}
    if any("driver" in way for way in told.values()):
        context = create_context()
        used = {"way": context.extra, "driver": describe(context)}
    print(json.dumps({"ways": told, "used": used}))


if __name__ == "__main__":
    main()
