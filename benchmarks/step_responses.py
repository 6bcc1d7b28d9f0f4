"""Print our step responses beside ArduCopter's: python benchmarks/step_responses.py [--traces FOLDER].

With a folder of recorded traces (CSV with t, bvx, bvy, bvz, yaw_rate_flu, yaw) also the RMS distance of whole curves.
"""

from __future__ import annotations

import argparse
import csv
import math
from pathlib import Path

import numpy as np

from cognitivedrone.sim.airframe import AIRFRAMES
from cognitivedrone.sim.responses import ARDUCOPTER, STEPS, Figures, Trace, fly, measure

FILES = {
    "forward 1 m/s": "a_forward_1.csv",
    "forward 2 m/s": "b_forward_2.csv",
    "left 1 m/s": "c_left_1.csv",
    "climb 0.5 m/s": "d_climb_0p5.csv",
    "yaw 0.5 rad/s": "e_yaw_0p5.csv",
    "forward 1.5 m/s, yaw 0.4 rad/s": "f_forward_1p5_yaw_0p4.csv",
}


def row(name: str, who: str, f: Figures) -> str:
    return (
        f"| {name} | {who} | {f.t10:.2f} | {f.t50:.2f} | {f.t90:.2f} | {100 * f.overshoot:.1f} % |"
        f" {f.stop:.2f} | {math.degrees(f.max_tilt):.1f} |"
    )


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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--traces", type=Path, help="folder of recorded responses")
    folder = parser.parse_args().traces
    print("| step | who | t10 s | t50 s | t90 s | overshoot | stop m (yaw: rad) | max tilt deg |")
    print("|---|---|---|---|---|---|---|---|")
    curves = []
    for name, step in STEPS.items():
        print(row(name, "ArduCopter 4.6.3", ARDUCOPTER[name]))
        for frame, airframe in AIRFRAMES.items():
            trace = fly(step, airframe)
            print(row(name, frame, measure(step, trace)))
            if folder:
                curves.append(f"{name}, {frame}: {distance(trace, folder / FILES[name])}")
    if curves:
        print("\nRMS distance to the recorded curves (m/s, rad/s), and the largest distance of headings:")
        print("\n".join(curves))


if __name__ == "__main__":
    main()
