"""Record the levels of an environment that cannot be in the process of `certify`.

Numpy alone, Python 3.8 or later, gym from 0.21, Gymnasium, gym3. `record` twice, in two processes,
checks that seeds repeat. Then, anywhere: `labyrinth_core.certify("records.jsonl")`.
"""

import hashlib
import json
from pathlib import Path

import numpy as np


def content(value):
    """Return an observation, reward or state as bytes, whatever its type."""
    if isinstance(value, dict):
        return b"{%s}" % b",".join(sorted(content(k) + content(value[k]) for k in value))
    if isinstance(value, (str, bytes)):
        return repr(value).encode()
    array = np.asarray(value) if not isinstance(value, (list, tuple)) else None
    if array is None or array.dtype == object:
        return b"(%s)" % b",".join(map(content, value if array is None else array.tolist()))
    return repr((array.dtype.str, array.shape)).encode() + array.tobytes()


def episode(env, seed, actions):
    """Yield the first observation, and what each action leads to until the episode ends."""
    old = hasattr(env, "observe")  # gym3, whose environment was made for this seed.
    try:
        first = env.observe()[1] if old else env.reset(seed=seed)
    except TypeError:  # gym 0.21
        env.seed(seed)
        first = env.reset()
    yield first[0] if type(first) is tuple and isinstance(first[-1], dict) else first
    for action in actions:
        seen = env.act(np.array([action])) or env.observe() if old else env.step(action)[:-1]
        yield seen
        if np.any(seen[2:]):
            return


def record(path, make, splits, actions, state=None):
    """Append a row for each seed to a file.

    `make(seed)` returns the environment, which may be the same for all seeds; `splits` has the
    seeds of train and test; `actions` are some sequences; `state(env)` is called after a reset.
    """
    with Path(path).open("a") as file:
        for split, seed in [(name, each) for name, seeds in splits.items() for each in seeds]:
            row = {"split": split, "seed": seed, "probes": []}
            for sequence in actions:
                env = make(seed)
                seen = episode(env, seed, sequence)
                parts = [content(next(seen))]
                row["first"] = hashlib.sha256(parts[0]).hexdigest()
                row["state"] = state and hashlib.sha256(content(state(env))).hexdigest()
                parts += map(content, seen)
                row["probes"].append(hashlib.sha256(b";".join(parts)).hexdigest())
            file.write(json.dumps(row) + "\n")
