"""PPO of Stable-Baselines3, trained on `Labyrinth-v0` and evaluated on labyrinths it has not seen.

    labyrinth-datasets size=3 && python examples/stable_baselines3_ppo.py

Needs: pip install labyrinth-datasets stable-baselines3
"""

from stable_baselines3 import PPO

from labyrinth_core import LabyrinthEnv, evaluate
from labyrinth_core.evaluation.results import Results


def main(
    folder: str = "data/labyrinth",
    size: str = "3x3",
    steps: int = 200_000,
    archive: str = "ppo.zip",
) -> Results:
    """Train in labyrinths drawn at random, save and load the archive, and evaluate it."""
    model = PPO("MlpPolicy", LabyrinthEnv(size, observation="vector"), seed=0, device="cpu")
    model.learn(steps)
    model.save(archive)
    model = PPO.load(archive, device="cpu")  # An archive from elsewhere is evaluated likewise.
    return evaluate(model, folder, size, observation="vector")


if __name__ == "__main__":
    print(main())
