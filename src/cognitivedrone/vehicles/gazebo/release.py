"""The supported releases of Gazebo, and the names of their parts.

Sources: the release notes of Gazebo Harmonic, Ionic and Jetty (https://gazebosim.org/docs/latest/releases). From
Jetty on, the modules of the Python bindings have no number in their names; the packages keep theirs.
"""

from __future__ import annotations

from dataclasses import dataclass

from cognitivedrone.errors import GazeboError, did_you_mean


@dataclass(frozen=True, slots=True)
class Release:
    """One release of Gazebo."""

    name: str
    sim: int
    """Major version of gz-sim, as `gz sim --versions` prints it."""
    package: str
    """Debian package of the complete release."""
    bindings: str
    """Debian packages of the Python bindings."""
    transport: str
    """Module of gz-transport."""
    messages: str
    """Package of the modules of gz-msgs."""


RELEASES: dict[str, Release] = {
    release.name: release
    for release in (
        Release("jetty", 10, "gz-jetty", "python3-gz-transport15 python3-gz-msgs12", "gz.transport", "gz.msgs"),
        Release("ionic", 9, "gz-ionic", "python3-gz-transport14 python3-gz-msgs11", "gz.transport14", "gz.msgs11"),
        Release(
            "harmonic", 8, "gz-harmonic", "python3-gz-transport13 python3-gz-msgs10", "gz.transport13", "gz.msgs10"
        ),
    )
}
"""By name, newest first. The same worlds work with all of them; Harmonic and Jetty have long-term support."""


def release_named(name: str) -> Release:
    """The release with this name; raises `GazeboError` with similar names."""
    if name not in RELEASES:
        raise GazeboError(f"unknown Gazebo release {name!r}; {did_you_mean(name, RELEASES)}")
    return RELEASES[name]
