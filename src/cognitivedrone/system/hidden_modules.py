"""A file of the user's that has the name of a module of Python or of this package's libraries, and is imported for it.

Python looks in PYTHONPATH and beside a script before it looks for its own modules. Nothing that could be hidden is
imported here.
"""

from __future__ import annotations

import os
import sys

_LIBRARIES = frozenset(
    ("av", "gymnasium", "httpx", "huggingface_hub", "lark", "mujoco", "numpy", "onnxruntime", "PIL", "pyarrow", "rich",
     "scipy", "starlette", "torch", "tyro", "uvicorn", "websockets")
)  # fmt: skip


def hidden_module() -> str:
    """Which file hides which module, and the way out; empty if none does."""
    ours = {os.path.realpath(each) for each in (os.__file__.rpartition(os.sep)[0], sys.prefix, sys.base_prefix)}
    for name, module in [*sys.modules.items()]:
        file = getattr(module, "__file__", None)
        if "." in name or not file or not (name in sys.stdlib_module_names or name in _LIBRARIES):
            continue
        place = os.path.realpath(file)
        installed = "site-packages" in place or "dist-packages" in place
        if not installed and not any(place.startswith(folder + os.sep) for folder in ours):
            return f"{file} hides the module {name!r} that this package needs; give it another name"
    return ""
