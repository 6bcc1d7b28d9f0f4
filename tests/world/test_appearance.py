import colorsys
import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cognitivedrone.world.appearance import PATTERNS, PLAIN, Pattern, expose, pattern_texture, varied_appearance

seeds = st.integers(0, 2**32 - 1)


@given(seed=seeds)
def test_varied_gates_keep_their_names(seed: int) -> None:
    appearance = varied_appearance(np.random.default_rng(seed))
    for color, hue in zip(appearance.gate_colors, (0.0, 1 / 3, 2 / 3), strict=True):
        seen, saturation, value = colorsys.rgb_to_hsv(*color)
        assert abs((seen - hue + 0.5) % 1 - 0.5) < 1 / 12
        assert saturation >= 0.75
        assert value >= 0.65
    for color in (appearance.floor, appearance.surroundings):
        assert colorsys.rgb_to_hsv(*color)[1] <= 0.4, "no wall passes for a gate"
    assert appearance.light_direction[2] < 0


@given(seed=seeds)
def test_looks_are_drawn_from_the_generator_alone(seed: int) -> None:
    assert varied_appearance(np.random.default_rng(seed)) == varied_appearance(np.random.default_rng(seed))
    assert varied_appearance(np.random.default_rng(seed)) != varied_appearance(np.random.default_rng(seed + 1))


def test_looks_reach_every_pattern() -> None:
    rng = np.random.default_rng(0)
    looks = [varied_appearance(rng) for _ in range(200)]
    assert {appearance.floor_pattern for appearance in looks} == set(PATTERNS)
    assert {appearance.surroundings_pattern for appearance in looks} == set(PATTERNS)


def test_the_perfect_camera_changes_nothing() -> None:
    image = np.random.default_rng(0).integers(0, 256, (64, 48, 3), dtype=np.uint8)
    before = image.copy()
    expose(image, PLAIN, 7)
    np.testing.assert_array_equal(image, before)


@pytest.mark.parametrize("noise", [0.3, 4.0, 60.0])
def test_noise_is_added_as_whole_numbers_and_cut_at_0_and_255(noise: float) -> None:
    """In plain arithmetic, from the table that is the same for all pictures."""
    image = np.random.default_rng(1).integers(0, 256, (256, 200, 3), dtype=np.uint8)
    table = np.random.default_rng(0).standard_normal((512, 512, 3), dtype=np.float32) * noise
    grain = np.clip(np.round(table), -128, 127).astype(int)
    for key in range(3):
        top, left = np.random.default_rng((9, key)).integers(0, 512, 2)
        wanted = np.clip(image + np.roll(grain, (-top, -left), axis=(0, 1))[:256, :200], 0, 255)
        seen = image.copy()
        expose(seen, dataclasses.replace(PLAIN, noise=noise, seed=9), key)
        np.testing.assert_array_equal(seen, wanted)


def test_blur_is_the_mean_of_neighbours_in_a_row() -> None:
    image = np.random.default_rng(1).integers(0, 256, (20, 64, 3), dtype=np.uint8)
    for pixels, width in ((0.6, 2), (2.0, 4), (20.0, 8)):
        seen = image.copy()
        expose(seen, PLAIN, 0, pixels)
        wanted = np.mean([image[:, 8 - step : 64 - step] for step in range(width)], axis=0)
        assert np.abs(seen[:, 8:] - wanted).max() <= 3  # each of up to three means is rounded down
    seen = image.copy()
    expose(seen, PLAIN, 0, 0.4)
    np.testing.assert_array_equal(seen, image)


def test_a_lens_moves_whole_pixels_towards_the_middle_or_away() -> None:
    image = np.random.default_rng(1).integers(0, 256, (64, 64, 3), dtype=np.uint8)
    for distortion in (0.06, -0.06):
        seen = image.copy()
        expose(seen, dataclasses.replace(PLAIN, distortion=distortion), 0)
        assert (seen != image).any()
        np.testing.assert_array_equal(seen[30:34, 30:34], image[30:34, 30:34])
        assert {*map(tuple, seen.reshape(-1, 3))} <= {*map(tuple, image.reshape(-1, 3))}


def test_a_lens_dims_what_is_far_from_the_middle() -> None:
    image = np.full((64, 64, 3), 200, np.uint8)
    expose(image, dataclasses.replace(PLAIN, vignetting=0.3), 0)
    assert image[32, 32, 0] == 200
    assert image[0, 0, 0] < 180


def test_exposure() -> None:
    image = np.array([[[0, 100, 255]]], np.uint8)
    expose(image, dataclasses.replace(PLAIN, gain=0.9, gamma=1.2), 0)
    np.testing.assert_array_equal(image, [[[0, round(0.9 * 255 * (100 / 255) ** 1.2), round(0.9 * 255)]]])


@pytest.mark.parametrize("pattern", PATTERNS)
def test_patterns_repeat_without_a_seam_of_their_own(pattern: Pattern) -> None:
    texture = pattern_texture(pattern)[..., 0].astype(int)
    assert texture.max() > 180, "colours keep their brightness"
    if pattern == "plain":
        assert (texture == 255).all()
        return
    assert texture.std() > 5
    for axis in (0, 1):
        steps = np.abs(np.diff(texture, axis=axis, append=np.take(texture, [0], axis=axis))).mean(axis=1 - axis)
        assert steps[-1] <= steps[:-1].max() + 8


def test_patterns_differ() -> None:
    assert len({pattern_texture(pattern).tobytes() for pattern in PATTERNS}) == len(PATTERNS)
