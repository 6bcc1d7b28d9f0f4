"""Libraries that report their use to their makers: this is switched off before they are loaded."""

from __future__ import annotations

import os
from typing import Final

SWITCHES: Final = {
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
