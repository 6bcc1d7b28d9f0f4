"""Label packs: a label reference to an RGB image. The shipped pack, and folders of users' own images.

    pack = load_pack()                      # the newest shipped pack
    pack.image("animal/zebra@noto")         # (256, 256, 3) uint8
    load_pack("my/labels").image("Animals/cat")

References are `kind/concept@style`; `docs/labels.md` lists them.
"""

from cognitivedrone.labels.extended import EXTENDED_PACKS, ExtendedPack
from cognitivedrone.labels.folder import FolderPack
from cognitivedrone.labels.pack import load_pack
from cognitivedrone.labels.people import BACKGROUNDS
from cognitivedrone.labels.shipped import PACKS, ShippedPack
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
