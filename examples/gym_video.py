"""Record the expert's flight through one task as a video.

Run: python examples/gym_video.py    (writes flight.mp4)
"""

import av
import gymnasium

from cognitivedrone.policies.expert import Expert
from cognitivedrone.types import EpisodeContext


def main(path: str) -> None:
    env = gymnasium.make("cognitivedrone.envs:CognitiveDrone-v1", suite="open-v1:smoke", render_mode="rgb_array")
    env.reset(seed=0)
    truth, expert, ended = env.unwrapped.truth(), Expert(), False  # type: ignore[attr-defined]
    expert.reset(EpisodeContext(truth.task.instruction, ground_truth=truth))
    with av.open(path, "w") as file:
        video = file.add_stream("libx264", rate=10, width=256, height=256, pix_fmt="yuv420p")
        while not ended:
            file.mux(video.encode(av.VideoFrame.from_ndarray(env.render())))
            ended = any(env.step(expert.command())[2:4])  # terminated, truncated
        file.mux(video.encode())
    env.close()


if __name__ == "__main__":
    main("flight.mp4")
