"""A stage in space: where its gates and panels stand, and the MuJoCo scene that shows them."""
