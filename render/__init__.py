"""Pictures of captured materials: headless OpenGL, and a NumPy reference that each shader is held equal to."""
