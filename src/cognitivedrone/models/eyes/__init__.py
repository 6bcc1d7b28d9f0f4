"""Finding panels in a frame and reading them."""
