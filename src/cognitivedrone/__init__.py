"""CognitiveDrone: language-driven drones, from benchmark to flight.

Importing the package is light: it loads no simulator and no learning framework. The parts are reached by their rooms,
for example `cognitivedrone.tasks` or `cognitivedrone.benchmark`.
"""

__version__ = "0.1.0"
