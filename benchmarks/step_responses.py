"""Print our step responses beside ArduCopter's: python benchmarks/step_responses.py [--traces FOLDER] [--plot SVG].

With a folder of recorded traces (CSV with t, bvx, bvy, bvz, yaw_rate_flu, yaw) also the RMS distance of whole curves.
Where ARDUCOPTER names a binary, it is flown as well, on our physics; the plot lays its curves over those of our Iris.
"""

from __future__ import annotations

import argparse
import csv
import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.sim.airframe import AIRFRAMES
from cognitivedrone.sim.responses import ARDUCOPTER, STEPS, Figures, OwnMotion, Trace, fly, measure
from cognitivedrone.types import FloatArray
from cognitivedrone.vehicles.sitl.arducopter import BINARY_VARIABLE
from cognitivedrone.vehicles.sitl.flight import SitlFlight

COLORS = ("#1f77b4", "#d62728")

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


def distance(trace: Trace, path: Path) -> str:
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


def plot(curves: dict[str, dict[str, Trace]]) -> str:
    """An SVG with a panel a step: the measured component of each response over time."""
    width, height, gap = 300, 170, 34
    parts = []
    for place, (name, traces) in enumerate(curves.items()):
        left, top = gap + place % 3 * (width + gap), gap + place // 3 * (height + gap)
        step = STEPS[name]
        wanted, seconds = step.action[step.axis], next(iter(traces.values())).time[-1]

        def points(x: FloatArray, y: FloatArray) -> str:
            across, down = left + x / seconds * width, top + height * (1.55 - y / wanted) / 2.1  # noqa: B023
            return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(across, down, strict=True))

        asked = points(np.array([0, 0, step.duration, step.duration, seconds]), np.array([0, wanted, wanted, 0, 0]))
        parts.append(f'<text x="{left}" y="{top - 6}">{name}, {seconds:g} s</text>')
        parts.append(f'<polyline points="{asked}" fill="none" stroke="#bbb"/>')
        for color, trace in zip(COLORS, traces.values(), strict=False):
            line = points(trace.time, trace.response[:, step.axis])
            parts.append(f'<polyline points="{line}" fill="none" stroke="{color}" stroke-width="1.5"/>')
    for place, (color, who) in enumerate(zip(COLORS, next(iter(curves.values())), strict=False)):
        parts.append(f'<text x="{gap + 200 * place}" y="{2 * (height + gap) + gap}" fill="{color}">{who}</text>')
    size = f"{3 * (width + gap) + gap} {2 * (height + gap) + 2 * gap}"
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size}" font-family="sans-serif" font-size="12">'
    return "\n".join([head, '<rect width="100%" height="100%" fill="white"/>', *parts, "</svg>\n"])


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
    curves: dict[str, dict[str, Trace]] = {}
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
