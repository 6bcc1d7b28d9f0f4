"""The archives of label packs."""

from __future__ import annotations

import io
import zipfile


def archive(members: dict[str, bytes]) -> bytes:
    """An archive without compression, and with the same date for every file."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_STORED) as packed:
        for name, data in members.items():
            packed.writestr(zipfile.ZipInfo(name), data)
    return content.getvalue()
