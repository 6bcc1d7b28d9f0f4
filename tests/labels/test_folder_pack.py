"""Folders of images as label packs, tidy ones, odd ones and hostile ones."""

import json
import os
import pickle
import socket
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cognitivedrone.errors import LabelError
from cognitivedrone.labels import load_pack
from cognitivedrone.labels.extended import extended_pack
from cognitivedrone.labels.folder import FolderPack, digest_of_labels

PUBLISHED = Path(__file__).resolve().parents[3] / "shared" / "upstream"
MISSING = {"Elvis_Persley", "Ludwig_Van_Beethoven", "taylor_swift", "leopard", "rat", "sparrow"}
"""Images that the published folder lacks."""


def save(path: Path, color: str | tuple[int, ...] = "red", size: tuple[int, int] = (64, 64), mode: str = "RGB") -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new(mode, size, color).save(path)
    return path


@pytest.fixture
def folder(tmp_path):
    save(tmp_path / "animal" / "cat.png", "red")
    save(tmp_path / "animal" / "dog@photo.jpg", "blue", (600, 300))
    save(tmp_path / "animal" / "dog@sketch.webp", "green")
    save(tmp_path / "Food" / "Healthy" / "healthy_1.png", "yellow")
    save(tmp_path / "Animals" / "cheetahdae.jpg", "orange")
    return tmp_path


def mean_color(pack, reference: str) -> list[int]:
    return [round(value) for value in pack.image(reference).mean(axis=(0, 1))]


def test_images_are_found_by_kind_concept_and_style(folder):
    pack = load_pack(str(folder))
    assert mean_color(pack, "animal/cat") == [255, 0, 0]
    assert mean_color(pack, "animal/dog@sketch") == pytest.approx([0, 128, 0], abs=4)
    assert mean_color(pack, "animal/dog@photo") == pytest.approx([0, 0, 255], abs=4)
    assert mean_color(pack, "Food/Healthy/healthy_1") == [255, 255, 0]
    assert pack.concepts("animal") == ("cat", "dog")
    assert pack.styles("animal") == ("photo", "sketch")


def test_aspect_is_kept_and_large_images_are_scaled_down(folder):
    image = load_pack(str(folder)).image("animal/dog@photo")
    assert image.shape == (128, 256, 3)
    assert not image.flags.writeable


def test_an_image_without_style_stands_for_every_style(folder):
    assert mean_color(load_pack(str(folder)), "animal/cat@noto") == [255, 0, 0]


def test_case_and_the_suffix_of_models_are_overlooked(folder):
    pack = load_pack(str(folder))
    assert (pack.image("animals/Cheetah.dae") == pack.image("Animals/cheetah")).all()


def test_kinds_that_the_folder_lacks_come_from_the_shipped_pack(folder):
    pack, shipped = load_pack(str(folder)), load_pack()
    for reference in ("sum/7*9@lora", "letter/Q", "person/hat=hat@sky", "object/key@noto"):
        assert (pack.image(reference) == shipped.image(reference)).all()
    assert {"animal", "Animals", "Food", "letter", "sum", "person"} <= set(pack.kinds())


def test_panels_of_several_show_the_folders_own_images(folder):
    image = load_pack(str(folder)).image("several/animal/cat=4")
    assert image.shape == (256, 256, 3)
    assert (image == (255, 0, 0)).all(axis=2).mean() > 0.9


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("animal/cot", "no file animal/cot.png (or .jpg, .jpeg, .webp) there; did you mean 'cat'"),
        ("animal/dog@oil", "in style 'oil'; known: photo, sketch"),
        ("anymal/cat", "has no kind 'anymal'; did you mean 'animal'"),
        ("animal/../../secret", "no file"),
        ("sum/1+", "is not a sum"),
    ],
)
def test_what_is_not_there_is_named_with_a_way_out(folder, reference, message):
    with pytest.raises(LabelError) as error:
        load_pack(str(folder)).image(reference)
    assert message in str(error.value)


def test_an_empty_folder_is_refused(tmp_path):
    (tmp_path / "top.png").write_bytes(b"")
    with pytest.raises(LabelError, match=r"holds no images; expected files such as animal/cat\.png"):
        load_pack(str(tmp_path))


def test_files_that_are_no_images_are_named(tmp_path):
    (tmp_path / "animal").mkdir()
    (tmp_path / "animal" / "cat.png").write_text("print('hello')")
    with pytest.raises(LabelError, match=r"cat\.png cannot be read as PNG, JPEG or WebP: it is text that begins"):
        load_pack(str(tmp_path)).image("animal/cat")


def test_an_image_that_is_too_large_is_refused_before_its_content_is_read(tmp_path):
    save(tmp_path / "animal" / "cat.png")
    whole = digest_of_labels(tmp_path)
    huge = tmp_path / "animal" / "dog.png"
    with huge.open("wb") as file:
        file.truncate(5 * 10**12)  # without content: reading it would take a day
    for digest in (lambda: digest_of_labels(tmp_path), lambda: load_pack(str(tmp_path)).digest):
        with pytest.raises(LabelError, match=r"dog\.png has 5,000,000,000,000 bytes, and at most 20,000,000 are read"):
            digest()
    huge.rename(tmp_path / "animal" / "films.tar")
    other = digest_of_labels(tmp_path)
    assert other != whole
    with (tmp_path / "animal" / "films.tar").open("r+b") as file:
        file.truncate(5 * 10**12 + 1)
    assert digest_of_labels(tmp_path) != other


def test_links_out_of_the_folder_are_not_followed(tmp_path):
    outside = save(tmp_path / "outside" / "secret.png")
    save(tmp_path / "labels" / "animal" / "cat.png", "red")
    (tmp_path / "labels" / "animal" / "dog.png").symlink_to(outside)
    (tmp_path / "labels" / "more").symlink_to(tmp_path / "outside")
    pack = load_pack(str(tmp_path / "labels"))
    assert pack.concepts("animal") == ("cat",)
    assert "more" not in pack.kinds()


def test_the_digest_follows_the_content(folder):
    before = load_pack(str(folder)).digest
    assert load_pack(str(folder)).digest == before
    save(folder / "animal" / "cat.png", "pink")
    assert load_pack(str(folder)).digest != before


def test_a_folder_pack_travels_to_worker_processes(folder):
    pack = load_pack(str(folder))
    copy = pickle.loads(pickle.dumps(pack))  # noqa: S301
    assert (copy.image("animal/cat") == pack.image("animal/cat")).all()


@pytest.mark.skipif(not PUBLISHED.is_dir(), reason="the published labels are not here")
def test_published_folder_shows_every_option_but_the_six_missing_images():
    pack = load_pack(str(PUBLISHED / "labels"))
    options = {
        f"{file.stem}/{option.removesuffix('.dae')}"
        for file in (PUBLISHED / "tasks").glob("*.json")
        for task in json.loads(file.read_text())
        for option in task["options"]
    }
    assert len(options) > 250
    for reference in options:
        if reference.partition("/")[2] in MISSING:
            with pytest.raises(LabelError, match=f"no file {reference}\\.png"):
                pack.image(reference)
        else:
            image = pack.image(reference)
            assert max(image.shape) <= 256
            assert np.ptp(image) > 0


@pytest.mark.parametrize("kind", ["pipe", "socket", "device", "folder", "link", "loop"])
def test_what_is_named_like_an_image_and_is_none_is_refused_at_once(tmp_path, kind):
    save(tmp_path / "labels" / "animal" / "cat.png")
    odd = tmp_path / "labels" / "animal" / "dog.png"
    if kind == "pipe":
        os.mkfifo(odd)
    elif kind == "socket":
        with socket.socket(socket.AF_UNIX) as listener:
            listener.bind(str(odd))
    elif kind == "folder":
        odd.mkdir()
    else:
        odd.symlink_to({"device": Path("/dev/zero"), "link": tmp_path / "nowhere", "loop": odd}[kind])
    says = "it is a link to nothing" if kind in ("link", "loop") else f"it is a {kind}, not a file"
    with pytest.raises(LabelError) as reported:
        load_pack(str(tmp_path / "labels"))
    assert str(reported.value) == f"label image {odd} cannot be read: {says}; remove it from the folder"


@pytest.mark.parametrize(
    "evil", ["../../secret", "/etc/passwd", "..", "a\x00b", "secret.png", "x" * 1000, "../outside/secret", "..@.."]
)
@pytest.mark.parametrize("kind", ["animal", "letter", "person", "logo", "sum", "several", "..", "", "\x00"])
def test_no_reference_leads_out_of_a_pack(tmp_path, kind, evil):
    save(tmp_path / "outside" / "secret.png")
    save(tmp_path / "labels" / "animal" / "cat.png")
    for pack in (load_pack(str(tmp_path / "labels")), load_pack()):
        for reference in (f"{kind}/{evil}", f"{kind}/{evil}@noto", f"{kind}/zebra@{evil}"):
            with pytest.raises(LabelError):
                pack.image(reference)


def test_names_that_are_no_utf_8_have_a_digest(tmp_path):
    save(tmp_path / "animal" / os.fsdecode(b"c\xffat.png"))
    assert len(load_pack(str(tmp_path)).digest) == 64


@pytest.mark.parametrize("asked", ["boissons/café", "Boissons/CAFE\u0301", "BOISSONS/cafe\u0301", "boissons/ café "])
@pytest.mark.parametrize("stored", ["café.png", "cafe\u0301.png", "Café .png"])
def test_names_match_however_accents_are_stored(tmp_path, stored, asked):
    save(tmp_path / "Boissons" / stored, "red")
    pack = load_pack(str(tmp_path))
    assert mean_color(pack, asked) == [255, 0, 0]
    assert pack.concepts("boissons") == ("café",)


def test_folders_that_differ_in_case_or_accents_alone_are_one_kind(tmp_path):
    for folder, name in (("thé", "a"), ("the\u0301", "b"), ("Thé", "c")):
        save(tmp_path / folder / f"{name}.png")
    pack = load_pack(str(tmp_path))
    assert sorted(pack.concepts("thé")) == ["a", "b", "c"]
    assert sum(kind.casefold().startswith("th") for kind in pack.kinds()) == 1
    with pytest.raises(LabelError, match=r"no file .*/cafe\.png .* there; known: a, b, c"):
        pack.image("the\u0301/cafe")


@pytest.mark.parametrize(
    "name", ["._cat.png", "animal/.cat.png.swp.png", "__MACOSX/animal/cat.png", "lost+found/x.png"]
)
def test_what_systems_leave_in_a_folder_is_no_label(folder, name):
    before = FolderPack(folder, extended_pack("open-v3"))
    files, kinds = [*before.files()], before.kinds()
    digests = load_pack(str(folder)).digest, digest_of_labels(folder)
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes((folder / "animal" / "cat.png").read_bytes())
    pack = FolderPack(folder, extended_pack("open-v3"))
    assert ([*pack.files()], pack.kinds()) == (files, kinds)
    assert (pack.digest, digest_of_labels(folder)) == digests


def test_a_folder_below_a_hidden_one_can_be_given(tmp_path):
    save(tmp_path / ".cache" / "labels" / "animal" / "cat.png")
    assert load_pack(str(tmp_path / ".cache" / "labels")).concepts("animal") == ("cat",)


@pytest.mark.parametrize("other", ["animal/cat.jpg", "animal/Cat.png", "Animal/cat.png", "animal/cat.webp"])
def test_two_files_of_one_name_are_named(tmp_path, other):
    save(tmp_path / "animal" / "cat.png")
    save(tmp_path / other)
    with pytest.warns(UserWarning, match="two files have one name, and the first is not shown: ") as told:
        load_pack(str(tmp_path))
    assert "animal/cat.png" in str(told[0].message)
    assert other in str(told[0].message)
    assert len(told) == 1


def test_pictures_that_are_not_read_are_named(folder, tmp_path):
    for name in ("cow.heic", "hen.TIFF", "owl.svg"):
        (folder / "animal" / name).write_bytes(b"x")
    with pytest.warns(UserWarning, match=r"animal/cow\.heic, animal/hen\.TIFF, animal/owl\.svg cannot be read: save"):
        load_pack(str(folder))
    alone = tmp_path / "alone" / "animal"
    alone.mkdir(parents=True)
    (alone / "cow.heic").write_bytes(b"x")
    with pytest.raises(LabelError, match=r"holds no images; .*; animal/cow\.heic cannot be read: save them as PNG"):
        load_pack(str(alone.parent))
