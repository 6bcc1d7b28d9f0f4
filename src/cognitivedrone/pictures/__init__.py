"""Picture files of other people: the one way in which labels, lessons, camera folders and the live page read them.

    read_picture(Path("my-labels/animal/cat.png"), "label image", LabelError, longest=256)

`reading.py` makes of any depth, transparency, orientation and colour space the RGB that people see in a viewer;
`kinds.py` says what a file is whose name promises another; `limits.py` has the limits of photographs, and of the frames
of data sets.
"""

from cognitivedrone.pictures.reading import (
    MAX_FILE_BYTES,
    MAX_FRAME_BYTES,
    MAX_PICTURE_BYTES,
    MAX_PIXELS,
    MAX_SIDE,
    OTHER_SUFFIXES,
    decode_picture,
    open_picture,
    read_picture,
)

__all__ = [
    "MAX_FILE_BYTES",
    "MAX_FRAME_BYTES",
    "MAX_PICTURE_BYTES",
    "MAX_PIXELS",
    "MAX_SIDE",
    "OTHER_SUFFIXES",
    "decode_picture",
    "open_picture",
    "read_picture",
]
