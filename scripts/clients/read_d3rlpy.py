"""d3rlpy: its own data sets from Minari's episodes, and a few steps of its discrete BC.

`d3rlpy.datasets.get_minari` joins the T + 1 observations of each episode with its T actions, so
that from the second episode on they do not belong together. So the episodes are given one by one.
"""

from __future__ import annotations

import d3rlpy
import minari
import numpy as np
from comparing import IDS, Episode, compare, fall, report

found, _ = d3rlpy.datasets.get_minari(IDS["train"])
dataset = minari.load_dataset(IDS["train"])
shifted = [
    not np.array_equal(theirs.observations, ours.observations[:-1])
    for theirs, ours in zip(found.episodes, dataset, strict=True)
]
buffer = d3rlpy.dataset.create_infinite_replay_buffer(
    [
        d3rlpy.dataset.Episode(
            observations=episode.observations[:-1].transpose(0, 3, 1, 2),
            actions=episode.actions[:, None],
            rewards=episode.rewards[:, None],
            terminated=bool(episode.terminations[-1]),
        )
        for episode in dataset
    ]
)
episodes = (
    Episode(
        np.concatenate([theirs.observations.transpose(0, 2, 3, 1), ours.observations[-1:]]),
        theirs.actions[:, 0],
        theirs.rewards[:, 0],
        theirs.terminated,
    )
    for theirs, ours in zip(buffer.episodes, dataset, strict=True)
)
steps = compare(episodes, "train")
algorithm = d3rlpy.algos.DiscreteBCConfig(
    observation_scaler=d3rlpy.preprocessing.PixelObservationScaler(), batch_size=64
).create()
algorithm.build_with_dataset(buffer)
losses = [algorithm.update(buffer.sample_transition_batch(64))["loss"] for _ in range(30)]
report(
    ["d3rlpy", "minari", "gymnasium", "torch"],
    f"{steps:,} steps, given episode by episode; `get_minari` shifts {sum(shifted)} of "
    f"{len(shifted)} episodes",
    fall(losses).replace("steps", "steps of its DiscreteBC"),
)
