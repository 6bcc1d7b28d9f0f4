"""Label packs: a label reference to an RGB image. The shipped pack, and folders of users' own images.

    pack = load_pack()                      # the newest shipped pack
    pack.image("animal/zebra@noto")         # (256, 256, 3) uint8
    load_pack("my/labels").image("Animals/cat")

References are `kind/concept@style`; `docs/labels.md` lists them.

How a label pack is found, by name or path.
"""

from __future__ import annotations

import multiprocessing
import warnings
from pathlib import Path

from cognitivedrone.errors import LabelError
from cognitivedrone.labels.extended import EXTENDED_PACKS, ExtendedPack, extended_pack
from cognitivedrone.labels.folder import FolderPack
from cognitivedrone.labels.people import BACKGROUNDS
from cognitivedrone.labels.shipped import PACKS, ShippedPack, shipped_pack
from cognitivedrone.references import PERSON_ATTRIBUTES, Reference, parse_reference

__all__ = [
    "BACKGROUNDS",
    "EXTENDED_PACKS",
    "PACKS",
    "PERSON_ATTRIBUTES",
    "ExtendedPack",
    "FolderPack",
    "Reference",
    "ShippedPack",
    "load_pack",
    "parse_reference",
]


def load_pack(name_or_path: str | Path | None = None) -> ShippedPack | ExtendedPack | FolderPack:
    """The label pack of that name, or a folder of images `<kind>/<concept>.png`.

    Where none is named, the newest shipped one, which draws what the earlier ones draw just as they do. A warning names
    pictures of a folder that are not shown: of two files with one name, and of formats that are not read.

    Raises `LabelError` where there is neither.
    """
    name = EXTENDED_PACKS[-1] if name_or_path is None else str(name_or_path)
    if name in PACKS:
        return shipped_pack(name)
    if name in EXTENDED_PACKS:
        return extended_pack(name)
    folder = Path(name)
    if not folder.is_dir():
        shipped = ", ".join((*PACKS, *EXTENDED_PACKS))
        raise LabelError(f"no label pack {name!r}: neither a folder of images nor a shipped pack ({shipped})")
    pack = FolderPack(folder, extended_pack(EXTENDED_PACKS[-1]))
    if multiprocessing.parent_process() is None:  # once, not by every worker
        for remark in pack.remarks:
            warnings.warn(remark, stacklevel=1)  # of this line, so that each is shown once
    return pack
