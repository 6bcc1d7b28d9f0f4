import numpy as np
import pytest

from cognitivedrone.types import SHAPES, SIZES, Gate
from cognitivedrone.world import geometry
from cognitivedrone.world.assets import BOARD, TEXTURE_SIZE, Assets, Placed, build_assets, write_picture


@pytest.fixture(scope="module")
def assets() -> Assets:
    return build_assets(slots=2, image_size=64)


def triangles(assets: Assets, placed: Placed) -> np.ndarray:
    """(k, 3, 3) corners of a mesh in the frame it was written in."""
    model, mesh = assets.model, placed.mesh
    start, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
    vertices = model.mesh_vert[start : start + count] @ placed.rotation.T + placed.position
    start, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    return vertices[model.mesh_face[start : start + count]]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("size", SIZES)
def test_the_drawn_frame_is_the_frame_that_is_hit(assets: Assets, size: str, shape: str) -> None:
    gate = Gate(size, shape, "red")  # type: ignore[arg-type]
    corners = triangles(assets, assets.gates[gate.size, gate.shape])
    middles = corners.mean(axis=1)
    # A circle drawn as a 64-gon lies up to 1 mm inside the true one.
    assert geometry.frame_distance(gate, *corners.reshape(-1, 3).T).max() < 1e-6
    assert geometry.frame_distance(gate, *middles.T).max() < 2e-3
    x, y, z = corners.reshape(-1, 3).T
    assert np.ptp(x) == pytest.approx(geometry.BAR_DEPTH)
    outline = geometry.opening_outline(gate, geometry.BAR_WIDTH)
    np.testing.assert_allclose([y.min(), y.max()], [outline[:, 0].min(), outline[:, 0].max()], atol=1e-6)
    np.testing.assert_allclose([z.min(), z.max()], [outline[:, 1].min(), outline[:, 1].max()], atol=1e-6)


@pytest.mark.parametrize("shape", SHAPES)
def test_frames_are_closed_and_face_outwards(assets: Assets, shape: str) -> None:
    """The volume under the triangles, which needs every face to be there and to look outwards, is the bar's."""
    gate = Gate("big", shape, "red")  # type: ignore[arg-type]
    a, b, c = np.moveaxis(triangles(assets, assets.gates[gate.size, gate.shape]), 1, 0)
    volume = np.einsum("ij,ij->", a, np.cross(b, c)) / 6

    def area(outline: np.ndarray) -> float:
        x, y = outline.T
        return float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2)

    ring = area(geometry.opening_outline(gate, geometry.BAR_WIDTH)) - area(geometry.opening_outline(gate))
    assert volume == pytest.approx(ring * geometry.BAR_DEPTH, rel=1e-4)


def test_the_panel_is_a_closed_box(assets: Assets) -> None:
    corners = triangles(assets, assets.panel)
    a, b, c = np.moveaxis(corners, 1, 0)
    assert np.einsum("ij,ij->", a, np.cross(b, c)) / 6 == pytest.approx(geometry.PANEL_DEPTH, rel=1e-4)
    np.testing.assert_allclose(np.ptp(corners.reshape(-1, 3), axis=0), [geometry.PANEL_DEPTH, 1, 1], atol=1e-6)


def test_pictures_go_into_textures_of_their_own(assets: Assets) -> None:
    assert len(set(assets.pictures.ravel().tolist())) == assets.pictures.size
    rng = np.random.default_rng(0)
    written = {}
    for slot in range(2):
        for picture in (0, 1, 2, BOARD):
            image = rng.integers(0, 256, (TEXTURE_SIZE, TEXTURE_SIZE, 3), dtype=np.uint8)
            written[write_picture(assets, slot, picture, image)] = image
    for texture, image in written.items():
        start = assets.model.tex_adr[texture]
        np.testing.assert_array_equal(assets.model.tex_data[start : start + image.size], image.ravel())


def test_pictures_of_any_size_fill_the_texture(assets: Assets) -> None:
    image = np.zeros((30, 50, 3), np.uint8)
    image[:, 25:] = 200
    texture = write_picture(assets, 0, 0, image)
    start = assets.model.tex_adr[texture]
    stored = assets.model.tex_data[start : start + TEXTURE_SIZE**2 * 3].reshape(TEXTURE_SIZE, TEXTURE_SIZE, 3)
    assert (stored[:, :120] == 0).all()
    assert (stored[:, 136:] == 200).all()
