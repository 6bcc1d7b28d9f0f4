"""Label packs: a label reference to an RGB image. The shipped pack, and folders of users' own images.

    pack = load_pack()                      # the shipped pack, "open-v1"
    pack.image("animal/zebra@noto")         # (256, 256, 3) uint8
    load_pack("my/labels").image("Animals/cat")

References are `kind/concept@style`; `docs/labels.md` lists them.
"""

from cognitivedrone.labels.folder import FolderPack
from cognitivedrone.labels.pack import PACKS, ShippedPack, load_pack
from cognitivedrone.labels.people import ATTRIBUTES, BACKGROUNDS
from cognitivedrone.labels.reference import Reference, parse_reference

__all__ = [
    "ATTRIBUTES",
    "BACKGROUNDS",
    "PACKS",
    "FolderPack",
    "Reference",
    "ShippedPack",
    "load_pack",
    "parse_reference",
]
