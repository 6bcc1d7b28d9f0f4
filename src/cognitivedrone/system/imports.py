"""What is seen to before libraries are imported: files of the user's that hide them, and their reports to their makers.

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


SWITCHES = {
    "ORT_DISABLE_TELEMETRY": "1",  # ONNX Runtime from 1.29 on: a device id, events, its maker's host
    "RAY_USAGE_STATS_ENABLED": "0",
    "HF_HUB_DISABLE_TELEMETRY": "1",  # Transformers and LeRobot, by way of huggingface_hub
}
"""Environment variables with the value that switches a library's reports off. Child processes inherit them."""


def switch_off() -> None:
    """Switch the reports off, in this process and its children; where the user has set a variable, that counts.

    For what is loaded afterwards: libraries read the variables once.
    """
    for name, value in SWITCHES.items():
        os.environ.setdefault(name, value)
