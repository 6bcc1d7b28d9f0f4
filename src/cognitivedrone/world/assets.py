"""The MuJoCo model of all stages: meshes and textures, compiled once.

Nothing in it moves or has a position: `scene.py` places its meshes. A stage only adds pictures, which are
written into existing textures, so no stage needs a compilation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from cognitivedrone.frames import rotation_matrix
from cognitivedrone.types import SHAPES, SIZES, FloatArray, Gate, Image, Shape, Size
from cognitivedrone.world import geometry, places
from cognitivedrone.world.appearance import PATTERNS, Pattern, pattern_texture
from cognitivedrone.world.engine import mujoco

TEXTURE_SIZE: Final = 256
"""Labels and boards are stored as square textures with sides of this many pixels."""
BOARD: Final = 3
"""Picture index of the board; 0 to 2 are the labels of gates 1 to 3."""
PICTURES: Final = 4
"""Pictures per slot: three labels and a board."""
OWN_PLACE_SIZE: Final = (1024, 512)
"""Width and height of the texture of a user's own place, px: a frame of 256 pixels shows no more of it."""
MAX_SLOTS: Final = 200
"""Limited because MuJoCo's renderer holds at most 1000 textures."""

ROOM_HALF_SIZE: Final = 40.0
"""Half the side of the room around a stage, m."""
ROOM_HEIGHT: Final = 25.0
"""Height of the room, m."""
_TILE = 3.0  # metres covered by one repetition of a pattern


@dataclass(frozen=True, slots=True)
class Placed:
    """A mesh of the model, and the pose of MuJoCo's copy in the mesh's original frame.

    MuJoCo rotates and shifts the vertices of a mesh into the frame of its inertia; this reverses it.
    """

    mesh: int
    position: FloatArray
    """(3,) m."""
    rotation: FloatArray
    """(3, 3)."""


@dataclass(frozen=True, slots=True)
class Assets:
    """The compiled model and the indices of its parts."""

    model: Any
    """mujoco.MjModel."""
    gates: dict[tuple[Size, Shape], Placed]
    """In the gate frame."""
    panel: Placed
    """Unit panel: x outward, y and z from -0.5 to 0.5; scaled when placed."""
    floor: Placed
    room: Placed
    place: Placed
    """Ground and dome of a place."""
    patterns: dict[Pattern, int]
    """Material of each pattern."""
    places: tuple[int, ...]
    """Textures for shipped places, as many as can be shown at once; each one's material has the same number."""
    own_place: int
    """The same for a user's own place."""
    pictures: NDArray[np.int32]
    """(slots, 4) texture numbers of each slot; each texture's material has the same number."""


def build_assets(slots: int, image_size: int) -> Assets:
    """Compile the model for `slots` stages seen through first-person images of `image_size` pixels a side."""
    spec = mujoco.MjSpec()
    spec.visual.global_.offwidth = image_size
    spec.visual.global_.offheight = image_size
    spec.visual.quality.offsamples = 0
    spec.visual.quality.shadowsize = 0
    gates = [Gate(size, shape, "red") for size in SIZES for shape in SHAPES]
    for gate in gates:
        add_mesh(spec, f"{gate.size} {gate.shape}", *frame_mesh(gate))
    add_mesh(spec, "panel", *panel_mesh())
    add_mesh(spec, "floor", *floor_mesh())
    add_mesh(spec, "room", *_room_mesh())
    add_mesh(spec, "place", *places.mesh())
    for pattern in PATTERNS:
        texture = add_texture(spec, pattern, pattern_texture(pattern).shape[0])
        texture.data = pattern_texture(pattern).tobytes()
    for slot in range(slots):
        for picture in range(PICTURES):
            add_texture(spec, f"picture {slot} {picture}", TEXTURE_SIZE)
    shown = range(min(slots, len(places.names())))
    for index in shown:
        add_texture(spec, f"place {index}", *places.SIZE)
    add_texture(spec, "own place", *OWN_PLACE_SIZE)
    model = spec.compile()
    return Assets(
        model=model,
        gates={(gate.size, gate.shape): _placed(model, f"{gate.size} {gate.shape}") for gate in gates},
        panel=_placed(model, "panel"),
        floor=_placed(model, "floor"),
        room=_placed(model, "room"),
        place=_placed(model, "place"),
        patterns={pattern: model.texture(pattern).id for pattern in PATTERNS},
        places=tuple(model.texture(f"place {index}").id for index in shown),
        own_place=model.texture("own place").id,
        pictures=len(PATTERNS) + np.arange(slots * PICTURES, dtype=np.int32).reshape(slots, PICTURES),
    )


def write_picture(assets: Assets, slot: int, picture: int, image: Image) -> int:
    """Write an RGB image (h, w, 3) of any size into a slot's texture; returns the texture's number, for upload."""
    image = square(image)
    texture = int(assets.pictures[slot, picture])
    start = int(assets.model.tex_adr[texture])
    assets.model.tex_data[start : start + image.size] = image.reshape(-1)
    return texture


def write_place(assets: Assets, texture: int, name: str) -> None:
    """Write a place's panorama into one of the textures for its kind of place."""
    pixels = places.load_place(name).pixels
    size = int(assets.model.tex_width[texture]), int(assets.model.tex_height[texture])
    if pixels.shape[1::-1] != size:
        pixels = np.asarray(PillowImage.fromarray(pixels).resize(size, PillowImage.Resampling.BOX))
    start = int(assets.model.tex_adr[texture])
    assets.model.tex_data[start : start + pixels.size] = pixels.reshape(-1)


def square(image: Image) -> Image:
    """An RGB image (h, w, 3) of any size as a texture (256, 256, 3)."""
    if image.dtype != np.uint8 or image.ndim != 3 or image.shape[2] != 3 or 0 in image.shape:
        raise ValueError(f"a picture is uint8 (h, w, 3), not {image.dtype} {image.shape}")
    size = (TEXTURE_SIZE, TEXTURE_SIZE)
    if image.shape[:2] == size:
        return image
    return np.asarray(PillowImage.fromarray(image).resize(size, PillowImage.Resampling.BILINEAR))


def add_texture(spec: Any, name: str, width: int, height: int = 0) -> Any:
    """A white RGB texture, square without a height, and a material of the same name that shows it."""
    height = height or width
    texture = spec.add_texture(
        name=name,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_NONE,
        width=width,
        height=height,
        nchannel=3,
    )
    texture.data = b"\xff" * (width * height * 3)
    material = spec.add_material(name=name)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    return texture


def add_mesh(spec: Any, name: str, vertices: FloatArray, faces: NDArray[np.int64], texture: FloatArray) -> Any:
    """Vertices (n, 3), triangles (k, 3) counter-clockwise from outside, texture coordinates (n, 2), v downwards."""
    mesh = spec.add_mesh(name=name)
    mesh.uservert = vertices.reshape(-1)
    mesh.userface = faces.reshape(-1)
    mesh.usertexcoord = texture.reshape(-1)
    mesh.smoothnormal = False
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    return mesh


def _placed(model: Any, name: str) -> Placed:
    mesh = model.mesh(name).id
    return Placed(mesh, np.array(model.mesh_pos[mesh]), rotation_matrix(np.array(model.mesh_quat[mesh])))


def _quads(corners: FloatArray) -> NDArray[np.int64]:
    """Two triangles for each of the (k, 4, 3) quads with corners counter-clockwise from outside."""
    first = 4 * np.arange(len(corners))[:, None]
    return np.concatenate([first + np.array(half) for half in ([0, 1, 2], [0, 2, 3])])


def frame_mesh(gate: Gate) -> tuple[FloatArray, NDArray[np.int64], FloatArray]:
    """The bar around an opening: a ring of mitred prisms, in the gate frame."""
    inner = geometry.opening_outline(gate)
    outer = geometry.opening_outline(gate, geometry.BAR_WIDTH)
    half = geometry.BAR_DEPTH / 2
    front_in, front_out, back_in, back_out = (
        np.column_stack([np.full(len(ring), x), ring]) for x in (-half, half) for ring in (inner, outer)
    )

    def side(a: FloatArray, b: FloatArray) -> FloatArray:
        """Quads between two rings, facing outwards if b is counter-clockwise to the right of a."""
        return np.stack([a, b, np.roll(b, -1, axis=0), np.roll(a, -1, axis=0)], axis=1)

    quads = np.concatenate(
        [side(front_out, front_in), side(back_in, back_out), side(back_out, front_out), side(front_in, back_in)]
    )
    return quads.reshape(-1, 3), _quads(quads), np.zeros((4 * len(quads), 2))


def panel_mesh() -> tuple[FloatArray, NDArray[np.int64], FloatArray]:
    """A thin box whose front (-x) and back (+x) both show the picture unmirrored to the viewer."""
    half = geometry.PANEL_DEPTH / 2
    y, z = np.array([0.5, -0.5, -0.5, 0.5]), np.array([-0.5, -0.5, 0.5, 0.5])
    front = np.column_stack([np.full(4, -half), y, z])
    back = np.column_stack([np.full(4, half), -y, z])
    sides = [
        np.stack([front[a], front[b], back[c], back[d]]) for a, b, c, d in ((1, 0, 1, 0), (2, 1, 0, 3), (3, 2, 3, 2))
    ]
    sides.append(np.stack([front[0], front[3], back[2], back[1]]))
    quads = np.stack([front, back, *sides])
    picture = np.array([[0.0, 1.0], [1.0, 1.0], [1.0, 0.0], [0.0, 0.0]])
    return quads.reshape(-1, 3), _quads(quads), np.concatenate([picture, picture, np.zeros((16, 2))])


def floor_mesh() -> tuple[FloatArray, NDArray[np.int64], FloatArray]:
    """A square of the room's size at z = 0, minimally thick because MuJoCo requires solid meshes."""
    half = ROOM_HALF_SIZE
    corners = np.array([[-half, -half, 0.0], [half, -half, 0.0], [half, half, 0.0], [-half, half, 0.0]])
    quads = np.stack([corners, (corners - [0.0, 0.0, 0.01])[::-1]])
    return quads.reshape(-1, 3), _quads(quads), quads.reshape(-1, 3)[:, :2] / _TILE


def _room_mesh() -> tuple[FloatArray, NDArray[np.int64], FloatArray]:
    """Four walls and a ceiling, seen from inside."""
    half, top = ROOM_HALF_SIZE, ROOM_HEIGHT
    corner = np.array([[half, half], [-half, half], [-half, -half], [half, -half]])
    quads, texture = [], []
    for a, b in zip(corner, np.roll(corner, -1, axis=0), strict=True):
        quads.append([[*b, 0.0], [*a, 0.0], [*a, top], [*b, top]])
        texture.append([[0.0, 0.0], [2 * half, 0.0], [2 * half, -top], [0.0, -top]])
    quads.append([[*c, top] for c in corner[::-1]])
    texture.append(corner[::-1].tolist())
    array = np.array(quads)
    return array.reshape(-1, 3), _quads(array), np.array(texture).reshape(-1, 2) / _TILE
