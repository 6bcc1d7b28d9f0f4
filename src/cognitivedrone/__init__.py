"""CognitiveDrone: language-driven drones, from benchmark to flight.

    from cognitivedrone import evaluate

    print(evaluate(MyPolicy(), suite="open-v1:smoke"))

Importing the package is fast: it loads no simulator and no learning framework until `evaluate` is used. Other parts
have their own packages, for example `cognitivedrone.tasks` or `cognitivedrone.benchmark`.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cognitivedrone.benchmark.evaluate import evaluate

__all__ = ["__version__", "evaluate"]
__version__ = "0.3.0"


def __getattr__(name: str) -> Any:
    if name == "evaluate":
        from cognitivedrone.benchmark.evaluate import evaluate

        return evaluate
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
