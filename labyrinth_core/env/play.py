"""Play labyrinths by hand, in a window."""

from __future__ import annotations

from labyrinth_core.env import LabyrinthEnv
from labyrinth_core.pictures import render


def play(env: LabyrinthEnv) -> None:
    """Let a person play until they quit, then close the environment.

    The arrow keys move the agent and R begins a new episode; Q, Escape or closing the window
    quit. After the end of an episode the arrow keys have no effect.

    Args:
        env: The environment; `env.unwrapped` if it is wrapped.

    Raises:
        DependencyNotInstalled: A window needs pygame.
    """
    window = env.window()
    total, outcome = 0.0, ""

    def show() -> None:
        caption = f"return {total:.3f} {outcome} (arrows move, R resets, Q quits)"
        window.show(render(env.labyrinth, env.state), caption)

    env.reset()
    show()
    for action in window.pressed():
        if action is None:
            env.reset()
            total, outcome = 0.0, ""
        elif not outcome:
            _, reward, terminated, truncated, _ = env.step(action)
            total += reward
            if terminated or truncated:
                outcome = "solved" if env.state.agent == env.labyrinth.goal else "lost"
        show()
    env.close()
