"""A function of JAX: a perceptron that learns from demonstrations, and is evaluated.

    labyrinth-datasets size=5 && python examples/jax_function.py

Needs: pip install labyrinth-datasets jax
"""

import jax
import jax.numpy as jnp

from labyrinth_core import evaluate, load_transitions
from labyrinth_core.evaluation.results import Results

Weights = list[tuple[jax.Array, jax.Array]]


def scores_of(weights: Weights, vectors: jax.Array) -> jax.Array:
    """Return the scores of the four actions, shape (B, 4)."""
    positions = jax.nn.one_hot(vectors[:, :3], vectors.shape[1]).reshape(len(vectors), -1)
    values = jnp.concatenate([positions, vectors[:, 3:]], axis=1)
    for place, (matrix, bias) in enumerate(weights):
        values = (jax.nn.relu(values) if place else values) @ matrix + bias
    return values


def loss_of(weights: Weights, vectors: jax.Array, actions: jax.Array) -> jax.Array:
    """Return the mean cross-entropy of the demonstrated actions."""
    chances = jax.nn.log_softmax(scores_of(weights, vectors))
    return -jnp.take_along_axis(chances, actions[:, None], axis=1).mean()


def main(folder: str = "data/labyrinth", config: str = "5x5", steps: int = 500) -> Results:
    """Train on the demonstrations of train, and evaluate on all splits."""
    transitions = load_transitions(folder, config, split="train", observation="vector")
    vectors, actions = jnp.array(transitions.observations), jnp.array(transitions.actions)
    length = vectors.shape[1]
    sizes, keys = (3 * length + length - 3, 256, 4), jax.random.split(jax.random.key(0), 2)
    weights = [
        (jax.random.normal(key, (a, b)) * (2 / a) ** 0.5, jnp.zeros(b))
        for key, a, b in zip(keys, sizes[:-1], sizes[1:], strict=True)
    ]
    gradient = jax.jit(jax.grad(loss_of))
    for _ in range(steps):
        change = gradient(weights, vectors, actions)
        weights = jax.tree.map(lambda weight, slope: weight - 0.3 * slope, weights, change)
    policy = jax.jit(lambda shown: scores_of(weights, shown))
    return evaluate(policy, folder, config, observation="vector")


if __name__ == "__main__":
    print(main())
