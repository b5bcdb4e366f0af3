"""OpenGL: a context without a display, frame packets, and the client that draws them."""
