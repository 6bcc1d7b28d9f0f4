"""Stage geometry: the positions of gates and panels, and the MuJoCo scene that shows them."""
