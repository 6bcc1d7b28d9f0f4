"""The meshes of our world as OBJ files, read from the compiled MuJoCo model, the single source of meshes.

Metres, z up. Flat shading: every corner has the normal of its face. Texture v runs downwards in our world, upwards in
OBJ.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.types import SHAPES, SIZES, FloatArray, Shape, Size
from cognitivedrone.world.assets import Assets, Placed, build_assets

PANEL: Final = "panel"
PILLAR: Final = "pillar"
FLOOR: Final = "floor"
ROOM: Final = "room"
MATERIALS_FILE: Final = "white.mtl"
MATERIALS: Final = "newmtl white\nKd 1 1 1\n"
"""What every mesh is made of, until the SDF file says otherwise: Gazebo warns of a mesh without a material."""
_MATERIAL: Final = "white"
_SIDES: Final = 24  # of a pillar


@dataclass(frozen=True, slots=True)
class Mesh:
    """Triangles in their original frame: the gate frame for gates, the stage frame for others."""

    vertices: FloatArray
    """(n, 3) m."""
    faces: NDArray[np.int64]
    """(k, 3) indices of vertices, counter-clockwise from outside."""
    texture: FloatArray
    """(t, 2) coordinates, v downwards, 0 to 1 across a picture."""
    texture_faces: NDArray[np.int64]
    """(k, 3) indices of texture coordinates."""


def gate_mesh(size: Size, shape: Shape) -> str:
    """The name of a gate's mesh."""
    return f"gate_{size}_{shape}"


def world_meshes() -> dict[str, Mesh]:
    """Every mesh of our world by file name: six gates, the unit panel, a pillar, floor and room."""
    assets = build_assets(slots=1, image_size=16)  # the model is only read, not rendered
    placed = {gate_mesh(size, shape): assets.gates[size, shape] for size in SIZES for shape in SHAPES}
    placed |= {PANEL: assets.panel, FLOOR: assets.floor, ROOM: assets.room}
    return {name: _read(assets, where) for name, where in placed.items()} | {PILLAR: _pillar()}


def _pillar() -> Mesh:
    """An upright prism of diameter and height 1, in place of a cylinder."""
    turn = np.linspace(0.0, 2 * np.pi, _SIDES, endpoint=False)
    ring = np.column_stack([np.cos(turn), np.sin(turn)]) / 2
    rings = [np.column_stack([ring, np.full(_SIDES, z)]) for z in (-0.5, 0.5)]
    low = np.arange(_SIDES)
    high, after = low + _SIDES, (low + 1) % _SIDES
    caps = [np.column_stack([np.full(_SIDES - 2, k), low[1:-1] + k, low[2:] + k]) for k in (0, _SIDES)]
    faces = np.concatenate(
        [np.column_stack([low, after, high]), np.column_stack([after, after + _SIDES, high]), caps[0][:, ::-1], caps[1]]
    )
    return Mesh(np.concatenate(rings), faces, np.zeros((1, 2)), np.zeros_like(faces))


def obj_text(name: str, mesh: Mesh) -> str:
    """A mesh as the text of a Wavefront OBJ file."""
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    lines = [f"mtllib {MATERIALS_FILE}", f"o {name}", f"usemtl {_MATERIAL}"]
    lines += [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in mesh.vertices]
    lines += [f"vt {u:.6f} {1.0 - v:.6f}" for u, v in mesh.texture]
    lines += [f"vn {x:.6f} {y:.6f} {z:.6f}" for x, y, z in normals]
    for number, (face, texture) in enumerate(zip(mesh.faces + 1, mesh.texture_faces + 1, strict=True), start=1):
        corner_texts = (f"{v}/{t}/{number}" for v, t in zip(face, texture, strict=True))
        lines.append(f"f {' '.join(corner_texts)}")
    return "\n".join(lines) + "\n"


def _read(assets: Assets, placed: Placed) -> Mesh:
    """A mesh of the compiled model, transformed back to its original frame."""
    model, mesh = assets.model, placed.mesh

    def part(values: FloatArray, first: NDArray[np.int32], count: NDArray[np.int32]) -> FloatArray:
        return np.asarray(values[first[mesh] : first[mesh] + count[mesh]])

    vertices = part(model.mesh_vert, model.mesh_vertadr, model.mesh_vertnum).astype(np.float64)
    return Mesh(
        vertices=vertices @ placed.rotation.T + placed.position,
        faces=part(model.mesh_face, model.mesh_faceadr, model.mesh_facenum).astype(np.int64),
        texture=part(model.mesh_texcoord, model.mesh_texcoordadr, model.mesh_texcoordnum).astype(np.float64),
        texture_faces=part(model.mesh_facetexcoord, model.mesh_faceadr, model.mesh_facenum).astype(np.int64),
    )
