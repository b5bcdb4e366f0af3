"""For whoever starts a process that draws with OpenGL: without loading OpenGL itself."""

# What a process that makes a context is to be started with: EGL reads it when it is loaded.
ENVIRONMENT = {"EGL_PLATFORM": "surfaceless", "LIBGL_ALWAYS_SOFTWARE": "1"}
