"""Print our step responses beside ArduCopter's: python benchmarks/step_responses.py [--traces FOLDER] [--plot SVG].

With a folder of recorded traces (CSV with t, bvx, bvy, bvz, yaw_rate_flu, yaw) also the RMS distance of whole curves.
Where ARDUCOPTER names a binary, it is flown as well, on our physics; the plot lays its curves over those of our Iris.
"""

from __future__ import annotations

import argparse
import csv
import math
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.sim.airframe import AIRFRAMES
from cognitivedrone.sim.responses import ARDUCOPTER, STEPS, Figures, OwnMotion, ResponseTrace, fly, measure
from cognitivedrone.types import FloatArray
from cognitivedrone.vehicles.sitl.arducopter import BINARY_VARIABLE
from cognitivedrone.vehicles.sitl.flight import SitlFlight

COLORS = ("#1f77b4", "#d62728")
WHO = {"iris": "our autopilot", "ArduCopter, flown now": "ArduCopter"}
"""Names in the plot."""
WIDTH, HEIGHT, GAP = 300, 170, 34
"""Of the plot's panels, px."""
YAW = 3
"""Place of the yaw rate in an action."""

FILES = {
    "forward 1 m/s": "a_forward_1.csv",
    "forward 2 m/s": "b_forward_2.csv",
    "left 1 m/s": "c_left_1.csv",
    "climb 0.5 m/s": "d_climb_0p5.csv",
    "yaw 0.5 rad/s": "e_yaw_0p5.csv",
    "forward 1.5 m/s, yaw 0.4 rad/s": "f_forward_1p5_yaw_0p4.csv",
}


def row(name: str, who: str, f: Figures) -> dict[str, Any]:
    """A row, printed."""
    print(
        f"| {name} | {who} | {f.t10:.2f} | {f.t50:.2f} | {f.t90:.2f} | {100 * f.overshoot:.1f} % |"
        f" {f.stop:.2f} | {math.degrees(f.max_tilt):.1f} |"
    )
    times = {"t10_s": f.t10, "t50_s": f.t50, "t90_s": f.t90}
    others = {"overshoot": f.overshoot, "stop": f.stop, "max_tilt_deg": math.degrees(f.max_tilt)}
    return {"step": name, "who": who, **times, **others}


def distance(trace: ResponseTrace, path: Path) -> str:
    with path.open() as file:
        rows = [r for r in csv.DictReader(file) if 0 <= float(r["t"]) <= trace.time[-1]]
    time = np.array([float(r["t"]) for r in rows])
    columns = ("bvx", "bvy", "bvz", "yaw_rate_flu")
    record = np.array([[float(r[c]) for c in columns] for r in rows])
    ours = np.stack([np.interp(time, trace.time, trace.response[:, i]) for i in range(4)], axis=1)
    rms = np.sqrt(((ours - record) ** 2).mean(axis=0))
    heading = -np.unwrap([float(r["yaw"]) for r in rows])
    lag = np.abs(np.interp(time, trace.time, trace.heading - trace.heading[0]) - (heading - heading[0])).max()
    return " ".join(f"{c} {v:.3f}" for c, v in zip(columns, rms, strict=True)) + f" heading max {lag:.3f} rad"


def plot(curves: dict[str, dict[str, ResponseTrace]]) -> str:
    """An SVG with a panel a step: the measured component of each response over time."""
    parts = []
    for place, (name, traces) in enumerate(curves.items()):
        left, top = corner(place)
        step = STEPS[name]
        wanted, seconds = step.action[step.axis], next(iter(traces.values())).time[-1]

        def points(x: FloatArray, y: FloatArray) -> str:
            across, down = left + x / seconds * WIDTH, height_of(y / wanted, top)  # noqa: B023
            return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(across, down, strict=True))

        asked = points(np.array([0, 0, step.duration, step.duration, seconds]), np.array([0, wanted, wanted, 0, 0]))
        parts += axes(place, name, wanted, "rad/s" if step.axis == YAW else "m/s", seconds)
        parts.append(f'<polyline points="{asked}" fill="none" stroke="#bbb"/>')
        for color, trace in zip(COLORS, traces.values(), strict=False):
            line = points(trace.time, trace.response[:, step.axis])
            parts.append(f'<polyline points="{line}" fill="none" stroke="{color}" stroke-width="1.5"/>')
    parts += legend(next(iter(curves.values())))
    size = f"{3 * (WIDTH + GAP) + GAP} {2 * (HEIGHT + GAP) + 2 * GAP}"
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size}" font-family="sans-serif" font-size="12">'
    return "\n".join([head, '<rect width="100%" height="100%" fill="white"/>', *parts, "</svg>\n"])


def corner(place: int) -> tuple[int, int]:
    """The upper left corner of a panel."""
    return GAP + place % 3 * (WIDTH + GAP), GAP + place // 3 * (HEIGHT + GAP)


def height_of(share: Any, top: int) -> Any:
    """Where a share of the commanded value is in a panel."""
    return top + HEIGHT * (1.55 - share) / 2.1


def axes(place: int, name: str, wanted: float, unit: str, seconds: float) -> list[str]:
    """A panel's title, its zero line with a mark each second, and its commanded value."""
    left, top = corner(place)
    zero, bottom = height_of(0, top), top + HEIGHT
    parts = [
        f'<text x="{left}" y="{top - 6}" font-weight="bold">{name}</text>',
        f'<line x1="{left}" x2="{left + WIDTH}" y1="{zero:.1f}" y2="{zero:.1f}" stroke="#ddd"/>',
        f'<text x="{left - 4}" y="{zero + 4:.1f}" text-anchor="end">0</text>',
        f'<text x="{left - 4}" y="{height_of(1, top) + 4:.1f}" text-anchor="end">{wanted:g}</text>',
        f'<text x="{left - 4}" y="{height_of(1, top) + 18:.1f}" text-anchor="end" font-size="9">{unit}</text>',
    ]
    for second in range(int(seconds) + 1):
        x = left + second / seconds * WIDTH
        parts.append(f'<line x1="{x:.1f}" x2="{x:.1f}" y1="{bottom - 14}" y2="{bottom - 10}" stroke="#888"/>')
        unit_of_time = " s" if second == int(seconds) else ""
        parts.append(
            f'<text x="{x:.1f}" y="{bottom}" font-size="10" text-anchor="middle">{second}{unit_of_time}</text>'
        )
    return parts


def legend(names: Iterable[str]) -> list[str]:
    """Whose curves these are."""
    shown = [("#888", "command"), *((color, WHO.get(who, who)) for color, who in zip(COLORS, names, strict=False))]
    y = 2 * (HEIGHT + GAP) + GAP + 16
    return [
        f'<text x="{GAP + 160 * place}" y="{y}" fill="{color}">{who}</text>' for place, (color, who) in enumerate(shown)
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--traces", type=Path, help="folder of recorded responses")
    parser.add_argument("--plot", type=Path, help="SVG to write")
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    options = parser.parse_args()
    binary = os.environ.get(BINARY_VARIABLE)
    arducopter = SitlFlight(Path(binary)) if binary else None
    print("| step | who | t10 s | t50 s | t90 s | overshoot | stop m (yaw: rad) | max tilt deg |")
    print("|---|---|---|---|---|---|---|---|")
    distances: list[str] = []
    rows = []
    curves: dict[str, dict[str, ResponseTrace]] = {}
    try:
        for name, step in STEPS.items():
            rows.append(row(name, "ArduCopter 4.6.3", ARDUCOPTER[name]))
            traces = {frame: fly(step, OwnMotion(airframe)) for frame, airframe in AIRFRAMES.items()}
            if arducopter is not None:
                traces["ArduCopter, flown now"] = fly(step, arducopter)
            for who, trace in traces.items():
                rows.append(row(name, who, measure(step, trace)))
                if options.traces:
                    distances.append(f"{name}, {who}: {distance(trace, options.traces / FILES[name])}")
            curves[name] = {who: trace for who, trace in traces.items() if who != "racer"}
    finally:
        if arducopter is not None:
            arducopter.close()
    keep(
        options.out,
        "Step responses of our airframes beside ArduCopter's recorded ones",
        rows,
        variables=(BINARY_VARIABLE,),
    )
    if distances:
        print("\nRMS distance to the recorded curves (m/s, rad/s), and the largest distance of headings:")
        print("\n".join(distances))
    if options.plot:
        options.plot.write_text(plot(curves))


if __name__ == "__main__":
    main()
