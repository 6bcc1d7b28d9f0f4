"""Drawing the world: OpenGL, its contexts, cameras and the view from behind."""
