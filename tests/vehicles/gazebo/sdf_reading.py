"""Reads exported worlds back without the code that wrote them: SDF by its elements, OBJ by its lines."""

import math
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

LARGEST = 1_000_000


def parse(text: str) -> ET.Element:
    """The root of an SDF text; no document type, no entities, and not too long."""
    assert len(text) < LARGEST
    assert "<!" not in text
    return ET.fromstring(text)  # noqa: S314 - limited above, and our own


def read_world(path: Path) -> ET.Element:
    return parse(path.read_text(encoding="utf-8")).find("world")


def values(element: ET.Element, path: str) -> list[float]:
    return [float(part) for part in element.findtext(path).split()]


def pose_matrix(numbers: list[float]) -> np.ndarray:
    """(4, 4) of x, y, z, roll, pitch, yaw, as SDF composes them: about fixed x, then y, then z."""
    x, y, z, roll, pitch, yaw = numbers
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    about_z = np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
    matrix = np.eye(4)
    matrix[:3, :3] = about_z @ about_y @ about_x
    matrix[:3, 3] = x, y, z
    return matrix


def element_pose(element: ET.Element) -> np.ndarray:
    return pose_matrix(values(element, "pose")) if element.find("pose") is not None else np.eye(4)


@dataclass(frozen=True)
class Obj:
    vertices: np.ndarray
    """(n, 3)."""
    faces: np.ndarray
    """(k, 3)."""
    texture: np.ndarray
    """(k, 3, 2) of each face's corners, v upwards."""
    normals: np.ndarray
    """(k, 3, 3) of each face's corners."""


def read_obj(path: Path) -> Obj:
    rows: dict[str, list[list[float]]] = {"v": [], "vt": [], "vn": []}
    corners = []
    for line in path.read_text(encoding="ascii").splitlines():
        kind, *rest = line.split()
        if kind == "f":
            corners.append([[int(number) - 1 for number in corner.split("/")] for corner in rest])
        elif kind in rows:
            rows[kind].append([float(number) for number in rest])
    index = np.array(corners)
    texture, normals = np.array(rows["vt"])[index[..., 1]], np.array(rows["vn"])[index[..., 2]]
    return Obj(np.array(rows["v"]), index[..., 0], texture, normals)


def model_mesh(folder: Path, model: ET.Element) -> tuple[np.ndarray, Obj]:
    """World positions (n, 3) of the vertices of a model with one mesh, and the mesh."""
    visual = model.find("link/visual")
    obj = read_obj(folder / visual.findtext("geometry/mesh/uri"))
    matrix = element_pose(model) @ element_pose(model.find("link")) @ element_pose(visual)
    scaled = obj.vertices * values(visual, "geometry/mesh/scale")
    return scaled @ matrix[:3, :3].T + matrix[:3, 3], obj


def models(world: ET.Element) -> dict[str, ET.Element]:
    return {model.get("name"): model for model in world.findall("model")}
